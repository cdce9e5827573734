//! The composition root: opens the store, recovers, starts the workers, serves, and drains when told to stop.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use backlot_engine::backend::{self, Backend, DeviceChoice};
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;
use tonic_health::ServingStatus;
use tonic_health::server::HealthReporter;

use crate::api;
use crate::config::Config;
use crate::domain::clock::{Clock, SystemClock, UuidSource};
use crate::error::{ErrorKind, Kinded};
use crate::jobs::execute::Masking;
use crate::jobs::{self, Execute, LocalPort, Queue, Workers};
use crate::segment::{self, Segmenter};
use crate::store::{self, Store, StoreConfig};

/// Services whose health is reported, besides "" for the whole.
const SERVICES: [&str; 5] = [
    "backlot.v1.BlobService",
    "backlot.v1.DriveLogService",
    "backlot.v1.AssetService",
    "backlot.v1.JobService",
    "backlot.v1.SampleService",
];

/// Time between two looks at whether the store still takes writes.
const HEALTH_EVERY: Duration = Duration::from_secs(1);

#[derive(Debug, thiserror::Error)]
pub enum Error {
    #[error("listen on {listen}: {source}")]
    Listen {
        listen: SocketAddr,
        source: std::io::Error,
    },
    #[error(transparent)]
    Store(#[from] store::Error),
    #[error(transparent)]
    Jobs(#[from] jobs::Error),
    #[error("device {device}: {source}")]
    Device {
        device: DeviceChoice,
        source: backlot_engine::Error,
    },
    #[error(transparent)]
    Segmenter(#[from] segment::OpenError),
    #[error("start worker threads: {0}")]
    Workers(std::io::Error),
    #[error("serve: {0}")]
    Serve(String),
}

impl Kinded for Error {
    fn kind(&self) -> ErrorKind {
        match self {
            Self::Store(e) => e.kind(),
            Self::Jobs(e) => e.kind(),
            Self::Device { source, .. } => source.kind(),
            Self::Segmenter(e) => e.kind(),
            Self::Listen { .. } | Self::Workers(_) => ErrorKind::Unavailable,
            Self::Serve(_) => ErrorKind::Internal,
        }
    }
}

/// Starts servers.
#[derive(Debug)]
pub struct Server;

impl Server {
    /// Opens the data directory, recovers what a crash left, and serves. Returns once calls are answered.
    pub async fn start(config: Config) -> Result<RunningServer, Error> {
        let segmenter = {
            let config = config.clone();
            on_blocking_thread(move || open_segmenter(&config)).await?
        };
        let execute = jobs::execute::executor(Masking {
            matching: config.mask_matching,
            segmenter,
        });
        Self::start_with(config, execute).await
    }

    /// As `start`, with the work that is done for a job.
    pub async fn start_with(config: Config, execute: Execute) -> Result<RunningServer, Error> {
        size_engine_pool(config.threads);
        // Before anything is opened, so that a taken port changes nothing.
        let listening = |source| Error::Listen {
            listen: config.listen,
            source,
        };
        let listener = TcpListener::bind(config.listen).await.map_err(listening)?;
        let local_addr = listener.local_addr().map_err(listening)?;
        let clock: Arc<dyn Clock> = Arc::new(SystemClock::new());
        let backend = {
            let config = config.clone();
            on_blocking_thread(move || open_device(&config)).await?
        };
        let (store, queue, workers) = {
            let (config, clock) = (config.clone(), clock.clone());
            on_blocking_thread(move || open(&config, clock, execute)).await?
        };
        let stopping = CancellationToken::new();
        let health = HealthReporter::new();
        report_health(&health, ServingStatus::Serving).await;
        let services = api::Services {
            store: store.clone(),
            queue,
            backend,
            clock,
            stopping: stopping.clone(),
        };
        let stop = stopping.clone().cancelled_owned();
        let serving = tokio::spawn(api::serve(listener, services, health.clone(), stop));
        let watching = tokio::spawn(watch_store(store.clone(), health.clone()));
        tracing::info!(address = %local_addr, data_dir = %config.data_dir.display(), "serving");
        Ok(RunningServer {
            local_addr,
            stopping,
            health,
            serving,
            watching,
            workers,
            store,
        })
    }
}

/// A server that answers calls until it is shut down.
#[derive(Debug)]
pub struct RunningServer {
    local_addr: SocketAddr,
    stopping: CancellationToken,
    health: HealthReporter,
    serving: JoinHandle<Result<(), tonic::transport::Error>>,
    watching: JoinHandle<()>,
    workers: Workers,
    store: Store,
}

impl RunningServer {
    pub fn local_addr(&self) -> SocketAddr {
        self.local_addr
    }

    /// Waits until serving ends by itself, which it does only on an error.
    pub async fn failed(&mut self) -> Error {
        match (&mut self.serving).await {
            Ok(Ok(())) => Error::Serve("ended".into()),
            Ok(Err(e)) => Error::Serve(e.to_string()),
            Err(e) => Error::Serve(e.to_string()),
        }
    }

    /// Reports not serving, takes no new work, gives running jobs back and lets calls end, for at most `grace`. Returns
    /// whether all ended in time; what did not is taken up again at the next start.
    pub async fn shutdown(self, grace: Duration) -> bool {
        let deadline = Instant::now() + grace;
        report_health(&self.health, ServingStatus::NotServing).await;
        self.watching.abort();
        self.workers.stop();
        self.stopping.cancel();
        let serving = self.serving;
        let abort = serving.abort_handle();
        let calls_ended = tokio::time::timeout_at(deadline.into(), serving)
            .await
            .is_ok();
        abort.abort();
        let workers = self.workers;
        let store = self.store;
        let jobs_ended = on_blocking_thread(move || {
            let ended = workers.join(deadline);
            drop(store);
            ended
        })
        .await;
        tracing::info!(calls_ended, jobs_ended, "stopped");
        calls_ended && jobs_ended
    }
}

/// Everything that blocks while a server starts.
fn open(
    config: &Config,
    clock: Arc<dyn Clock>,
    execute: Execute,
) -> Result<(Store, Arc<Queue>, Workers), Error> {
    let store = Store::open(&StoreConfig {
        data_dir: config.data_dir.clone(),
        low_water_bytes: config.low_water_bytes,
        ballast_bytes: config.ballast_bytes,
    })?;
    let queue = Arc::new(Queue::new(store.clone(), clock, Arc::new(UuidSource)));
    let recovered = queue.recover()?;
    if recovered > 0 {
        tracing::info!(jobs = recovered, "took up jobs of the process before");
    }
    let port = Arc::new(LocalPort::new(queue.clone()));
    let workers =
        Workers::start(config.workers, queue.clone(), port, execute).map_err(Error::Workers)?;
    Ok((store, queue, workers))
}

/// Before the data directory, so that a device that is not there changes nothing.
fn open_device(config: &Config) -> Result<Arc<dyn Backend>, Error> {
    let opened = backend::open(&config.device, config.gpu_memory_bytes);
    let opened = opened.map_err(|source| Error::Device {
        device: config.device.clone(),
        source,
    })?;
    tracing::info!(
        device = opened.device(),
        backend = opened.name(),
        "computing"
    );
    Ok(opened)
}

/// Before the data directory, as the device.
fn open_segmenter(config: &Config) -> Result<Option<Arc<dyn Segmenter>>, Error> {
    let settings = config.segmenter.as_ref();
    let opened = settings.map(|settings| segment::open(settings, config.threads));
    Ok(opened.transpose()?)
}

/// The engine's threads are those of the process; the first server that starts in it decides.
fn size_engine_pool(threads: usize) {
    let _ = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(|i| format!("engine-{i}"))
        .build_global();
}

/// A store that refuses writes makes the server not ready; reads go on.
async fn watch_store(store: Store, health: HealthReporter) {
    while store.metadata().poisoned().is_none() {
        tokio::time::sleep(HEALTH_EVERY).await;
    }
    report_health(&health, ServingStatus::NotServing).await;
}

async fn report_health(health: &HealthReporter, status: ServingStatus) {
    health.set_service_status("", status).await;
    for service in SERVICES {
        health.set_service_status(service, status).await;
    }
}

async fn on_blocking_thread<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    match tokio::task::spawn_blocking(work).await {
        Ok(value) => value,
        Err(e) => std::panic::resume_unwind(e.into_panic()),
    }
}

#[cfg(test)]
#[path = "server_tests.rs"]
mod tests;
