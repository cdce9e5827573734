//! `SampleService`: each stream renders on a thread of its own, one sample ahead of the client at most.

use std::pin::Pin;
use std::sync::Arc;

use backlot_engine::Error as EngineError;
use backlot_engine::backend::Backend;
use backlot_proto::v1;
use backlot_proto::v1::sample_service_server::SampleService;
use futures::Stream;
use prost::Message;
use tokio::sync::{Semaphore, mpsc, oneshot};
use tokio_stream::wrappers::ReceiverStream;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

use super::blocking::blocking;
use super::convert_recipe::{recipe_from_wire, scene_from_wire};
use super::convert_sample::{Origins, plan_to_wire, sample_to_wire};
use super::limits::{MAX_PLANS, MAX_RENDERINGS, MAX_REPLY_BYTES, MAX_SAMPLES, SAMPLES_AHEAD};
use super::status::{invalid_field, status, to_status, violations_status};
use crate::error::ErrorKind;
use crate::samples::{self, AssetCache, RecipeRequest, RecipeSamples, render_scene};
use crate::store::Store;

/// Samples from the library of one store.
#[derive(Clone, Debug)]
pub(crate) struct SampleApi {
    cache: Arc<AssetCache>,
    renderings: Arc<Semaphore>,
    /// Cancelled when the server begins to stop.
    stopping: CancellationToken,
}

impl SampleApi {
    pub(crate) fn new(
        store: Store,
        backend: Arc<dyn Backend>,
        stopping: CancellationToken,
    ) -> Self {
        Self {
            cache: Arc::new(AssetCache::new(store, backend)),
            renderings: Arc::new(Semaphore::new(MAX_RENDERINGS)),
            stopping,
        }
    }

    fn permit(&self) -> Result<tokio::sync::OwnedSemaphorePermit, Status> {
        self.renderings.clone().try_acquire_owned().map_err(|_| {
            let what = format!("{MAX_RENDERINGS} sample calls are running already");
            status(ErrorKind::Overloaded, what)
        })
    }
}

type SampleStream =
    Pin<Box<dyn Stream<Item = Result<v1::StreamSamplesResponse, Status>> + Send + 'static>>;

#[tonic::async_trait]
impl SampleService for SampleApi {
    type StreamSamplesStream = SampleStream;

    async fn stream_samples(
        &self,
        request: Request<v1::StreamSamplesRequest>,
    ) -> Result<Response<SampleStream>, Status> {
        let request = request.into_inner();
        let indices = indices(request.start_index, request.count, MAX_SAMPLES)?;
        let wire = request
            .recipe
            .ok_or_else(|| invalid_field("recipe", "is missing"))?;
        let recipe = recipe_from_wire(wire, request.seed).map_err(|e| violations_status(&e))?;
        let permit = self.permit()?;
        let background = recipe.background.to_string();
        let cache = self.cache.clone();
        let samples = blocking(move || RecipeSamples::prepare(cache, recipe)).await?;
        let origins = Origins {
            snapshot: samples.snapshot(),
            background,
            seed: request.seed,
        };
        let (sender, receiver) = mpsc::channel(SAMPLES_AHEAD);
        let stopping = self.stopping.clone();
        let work = move || {
            let _permit = permit;
            for index in indices {
                let reply = next(&samples, index, &origins, &sender, &stopping);
                let ends = reply.is_err();
                if sender.blocking_send(reply).is_err() || ends {
                    return;
                }
            }
        };
        spawn(work)?;
        Ok(Response::new(Box::pin(ReceiverStream::new(receiver))))
    }

    async fn plan_samples(
        &self,
        request: Request<v1::PlanSamplesRequest>,
    ) -> Result<Response<v1::PlanSamplesResponse>, Status> {
        let request = request.into_inner();
        let indices = indices(request.start_index, request.count, MAX_PLANS)?;
        let wire = request
            .recipe
            .ok_or_else(|| invalid_field("recipe", "is missing"))?;
        let recipe = recipe_from_wire(wire, request.seed).map_err(|e| violations_status(&e))?;
        let permit = self.permit()?;
        let (cache, stopping) = (self.cache.clone(), self.stopping.clone());
        let (sender, receiver) = oneshot::channel();
        let work = move || {
            let _permit = permit;
            let cancelled = || sender.is_closed() || stopping.is_cancelled();
            let planned = plans(cache, recipe, indices, &cancelled);
            let _ = sender.send(planned.map_err(|e| to_status(&e)));
        };
        spawn(work)?;
        let panicked = |_| status(ErrorKind::Internal, "planning panicked");
        let reply = receiver.await.map_err(panicked)??;
        Ok(Response::new(reply))
    }

    async fn render_scene(
        &self,
        request: Request<v1::RenderSceneRequest>,
    ) -> Result<Response<v1::RenderSceneResponse>, Status> {
        let wire = request.into_inner();
        let background = wire.background.clone();
        let scene = scene_from_wire(wire).map_err(|e| violations_status(&e))?;
        let permit = self.permit()?;
        let (sender, receiver) = oneshot::channel();
        let (cache, stopping) = (self.cache.clone(), self.stopping.clone());
        let work = move || {
            let _permit = permit;
            let cancelled = || sender.is_closed() || stopping.is_cancelled();
            let rendered = render_scene(&cache, &scene, &cancelled);
            let _ = sender.send(rendered.map_err(|e| to_status(&e)));
        };
        spawn(work)?;
        let panicked = |_| status(ErrorKind::Internal, "rendering panicked");
        let (snapshot, sample) = receiver.await.map_err(panicked)??;
        let origins = Origins {
            snapshot,
            background,
            seed: 0,
        };
        Ok(Response::new(v1::RenderSceneResponse {
            sample: Some(sample_to_wire(sample, 0, &origins)),
        }))
    }
}

fn indices(start: u64, count: u64, most: u64) -> Result<std::ops::Range<u64>, Status> {
    if count == 0 || count > most {
        let what = format!("is {count}, not 1 to {most}");
        return Err(invalid_field("count", what));
    }
    let end = start.checked_add(count);
    let end = end.ok_or_else(|| invalid_field("start_index", "is too large"))?;
    Ok(start..end)
}

fn plans(
    cache: Arc<AssetCache>,
    recipe: RecipeRequest,
    indices: std::ops::Range<u64>,
    cancelled: &dyn Fn() -> bool,
) -> samples::Result<v1::PlanSamplesResponse> {
    let samples = RecipeSamples::prepare(cache, recipe)?;
    let mut plans = Vec::new();
    let mut bytes = 0;
    for index in indices {
        if cancelled() {
            return Err(EngineError::Cancelled.into());
        }
        let plan = plan_to_wire(samples.plan(index)?, index);
        bytes += plan.encoded_len();
        if bytes > MAX_REPLY_BYTES / 2 {
            let what = format!("{} plans fill a reply: ask for fewer at once", plans.len());
            return Err(samples::Error::Invalid { what });
        }
        plans.push(plan);
    }
    Ok(v1::PlanSamplesResponse {
        library_snapshot: format!("librarySnapshots/{}", samples.snapshot()),
        plans,
    })
}

fn next(
    samples: &RecipeSamples,
    index: u64,
    origins: &Origins,
    sender: &mpsc::Sender<Result<v1::StreamSamplesResponse, Status>>,
    stopping: &CancellationToken,
) -> Result<v1::StreamSamplesResponse, Status> {
    if stopping.is_cancelled() {
        return Err(stopped(index));
    }
    let cancelled = || sender.is_closed() || stopping.is_cancelled();
    match samples.sample(index, &cancelled) {
        Ok(sample) => Ok(v1::StreamSamplesResponse {
            sample: Some(sample_to_wire(sample, index, origins)),
        }),
        Err(_) if stopping.is_cancelled() => Err(stopped(index)),
        Err(error) => Err(to_status(&error)),
    }
}

fn stopped(index: u64) -> Status {
    let what = format!("the server is stopping; go on with start_index {index}");
    status(ErrorKind::Unavailable, what)
}

/// Rendering may take as long as its client reads: it gets a thread of its own, not one of the blocking pool's.
fn spawn(work: impl FnOnce() + Send + 'static) -> Result<(), Status> {
    let span = tracing::Span::current();
    std::thread::Builder::new()
        .name("samples".into())
        .spawn(move || span.in_scope(work))
        .map(|_| ())
        .map_err(|e| status(ErrorKind::Unavailable, format!("start a thread: {e}")))
}
