//! `JobService`: queue, look at, cancel and watch training jobs.

use std::sync::Arc;

use backlot_proto::v1;
use backlot_proto::v1::job_service_server::JobService;
use futures::StreamExt;
use futures::stream::{self, BoxStream};
use tokio::sync::watch;
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status};

use super::blocking::blocking;
use super::convert_job::{job_to_wire, spec_from_wire};
use super::limits::MAX_REQUEST_ID_BYTES;
use super::page::Page;
use super::status::{invalid_field, status};
use crate::domain::ids::{DriveLogId, JobId};
use crate::domain::job::{Job, JobReport};
use crate::error::ErrorKind;
use crate::jobs::Queue;
use crate::store::{self, Store};

/// Jobs of one queue.
#[derive(Clone, Debug)]
pub(crate) struct JobApi {
    queue: Arc<Queue>,
    store: Store,
    stopping: CancellationToken,
}

impl JobApi {
    /// Watches end when `stopping` is cancelled.
    pub(crate) fn new(queue: Arc<Queue>, store: Store, stopping: CancellationToken) -> Self {
        Self {
            queue,
            store,
            stopping,
        }
    }

    async fn to_wire(&self, job: Job) -> Result<v1::Job, Status> {
        let store = self.store.clone();
        blocking(move || {
            let report = report(&store, &job)?;
            Ok::<_, store::Error>(job_to_wire(&job, report))
        })
        .await
    }
}

#[tonic::async_trait]
impl JobService for JobApi {
    async fn create_job(
        &self,
        request: Request<v1::CreateJobRequest>,
    ) -> Result<Response<v1::CreateJobResponse>, Status> {
        let request = request.into_inner();
        let spec = spec_from_wire(&request)?;
        if request.request_id.len() > MAX_REQUEST_ID_BYTES {
            let what = format!("is longer than {MAX_REQUEST_ID_BYTES} bytes");
            return Err(invalid_field("request_id", what));
        }
        let queue = self.queue.clone();
        let job = blocking(move || {
            let request_id = Some(request.request_id.as_str()).filter(|id| !id.is_empty());
            queue.enqueue(spec, request_id)
        })
        .await?;
        Ok(Response::new(v1::CreateJobResponse {
            job: Some(self.to_wire(job).await?),
        }))
    }

    async fn get_job(
        &self,
        request: Request<v1::GetJobRequest>,
    ) -> Result<Response<v1::GetJobResponse>, Status> {
        let id = job_id(&request.get_ref().name)?;
        let queue = self.queue.clone();
        let job = blocking(move || queue.job(&id)).await?;
        Ok(Response::new(v1::GetJobResponse {
            job: Some(self.to_wire(job).await?),
        }))
    }

    async fn list_jobs(
        &self,
        request: Request<v1::ListJobsRequest>,
    ) -> Result<Response<v1::ListJobsResponse>, Status> {
        let request = request.into_inner();
        let list = format!("jobs {}", request.drive_log);
        let page = Page::parse(request.page_size, &request.page_token, list)?;
        let log = match request.drive_log.as_str() {
            "" => None,
            name => Some(
                name.parse::<DriveLogId>()
                    .map_err(|e| invalid_field("drive_log", e))?,
            ),
        };
        let (queue, after, limit) = (self.queue.clone(), page.after.clone(), page.read_limit());
        let mut found = blocking(move || {
            queue.jobs(&after, limit, |job| {
                log.as_ref().is_none_or(|log| *log == job.spec.drive_log)
            })
        })
        .await?;
        let next_page_token = page.close(&mut found, |job| job.id.as_str().to_owned());
        let store = self.store.clone();
        let jobs = blocking(move || {
            found
                .iter()
                .map(|job| Ok(job_to_wire(job, report(&store, job)?)))
                .collect::<store::Result<Vec<_>>>()
        })
        .await?;
        Ok(Response::new(v1::ListJobsResponse {
            jobs,
            next_page_token,
        }))
    }

    async fn cancel_job(
        &self,
        request: Request<v1::CancelJobRequest>,
    ) -> Result<Response<v1::CancelJobResponse>, Status> {
        let id = job_id(&request.get_ref().name)?;
        let queue = self.queue.clone();
        let job = blocking(move || queue.cancel(&id)).await?;
        Ok(Response::new(v1::CancelJobResponse {
            job: Some(self.to_wire(job).await?),
        }))
    }

    type WatchJobStream = BoxStream<'static, Result<v1::WatchJobResponse, Status>>;

    async fn watch_job(
        &self,
        request: Request<v1::WatchJobRequest>,
    ) -> Result<Response<Self::WatchJobStream>, Status> {
        let id = job_id(&request.get_ref().name)?;
        let queue = self.queue.clone();
        let mut changes = blocking(move || queue.watch(&id)).await?;
        changes.mark_changed();
        let watch = Watch {
            api: self.clone(),
            changes,
            ended: false,
        };
        Ok(Response::new(
            stream::try_unfold(watch, Watch::next).boxed(),
        ))
    }
}

/// A watched job. Only the newest state is held, so a slow client costs nothing.
struct Watch {
    api: JobApi,
    changes: watch::Receiver<Job>,
    ended: bool,
}

impl Watch {
    async fn next(mut self) -> Result<Option<(v1::WatchJobResponse, Self)>, Status> {
        if self.ended {
            return Ok(None);
        }
        tokio::select! {
            changed = self.changes.changed() => changed.map_err(|_| stopping())?,
            () = self.api.stopping.cancelled() => return Err(stopping()),
        }
        let job = self.changes.borrow_and_update().clone();
        self.ended = job.is_ended();
        let message = v1::WatchJobResponse {
            job: Some(self.api.to_wire(job).await?),
        };
        Ok(Some((message, self)))
    }
}

fn stopping() -> Status {
    status(
        ErrorKind::Unavailable,
        "the server is stopping; watch again",
    )
}

/// What a finished job has to say; empty for others.
fn report(store: &Store, job: &Job) -> store::Result<JobReport> {
    let Some(report) = &job.report else {
        return Ok(JobReport::default());
    };
    let content = store.blobs().read(&report.digest)?;
    serde_json::from_slice(&content).map_err(|e| store::Error::Corrupt {
        what: format!("report of {} ({e})", job.id),
    })
}

fn job_id(name: &str) -> Result<JobId, Status> {
    name.parse().map_err(|e| invalid_field("name", e))
}
