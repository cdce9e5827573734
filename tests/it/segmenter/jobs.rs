//! Decompose jobs on logs without masks, through real sockets.

use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use backlot_client::read_log::ReadLog;
use backlot_client::{Connection, upload, watch};
use backlot_e2e::programs::finish;
use backlot_e2e::{Server, backlot, logs, painted};
use backlot_proto::v1;
use backlot_server::config::Config;
use backlot_server::domain::blob::Digest;
use backlot_server::jobs::execute::{Masking, executor};
use backlot_server::segment::{
    ChannelOrder, Instance, Layout, RgbImage, RoadUser, RuntimeKind, SegmentError, Segmenter,
    SegmenterSettings, open,
};
use backlot_server::server::{RunningServer, Server as InProcess};

use super::networks::{painted_log, settings};
use super::refusals::config;

const LOG: &str = "driveLogs/painted";

async fn in_process(folder: &Path, masking: Masking) -> (RunningServer, Connection) {
    let config = Config::new(folder.join("data"), "127.0.0.1:0".parse().unwrap());
    let server = InProcess::start_with(config, executor(masking))
        .await
        .unwrap();
    let url = format!("http://{}", server.local_addr());
    (server, Connection::open(&url).await.unwrap())
}

async fn uploaded(connection: &Connection, log: &ReadLog) {
    upload::upload_log(connection, log, LOG, &|_| {})
        .await
        .unwrap();
}

fn decompose() -> v1::CreateJobRequest {
    v1::CreateJobRequest {
        kind: v1::JobKind::Decompose.into(),
        drive_log: LOG.to_owned(),
        budget: v1::Budget::Quick.into(),
        ..Default::default()
    }
}

async fn decomposed(connection: &Connection) -> v1::Job {
    let job = watch::create_job(connection, decompose()).await.unwrap();
    let job = watch::watch_job(connection, &job.name, |_| {})
        .await
        .unwrap();
    assert_eq!(job.state(), v1::JobState::Succeeded, "{job:?}");
    job
}

/// What a decomposition says of each track that does not hang on a few pixels.
fn kept(job: &v1::Job) -> Vec<&str> {
    let kept = job.tracks.iter().filter(|track| track.kept);
    kept.map(|track| track.track_id.as_str()).collect()
}

/// Every colour is a vehicle.
fn of_all_classes(settings: SegmenterSettings) -> SegmenterSettings {
    let all = (0..painted::CLASSES as u32).map(|class| (class, RoadUser::Vehicle));
    SegmenterSettings {
        classes: all.collect(),
        ..settings
    }
}

#[tokio::test]
async fn a_log_without_masks_is_decomposed_by_the_segmenter() {
    let folder = tempfile::tempdir().unwrap();
    let settings = of_all_classes(settings(folder.path(), Layout::YoloSeg, RuntimeKind::Tract));
    let segmenter = |settings: &SegmenterSettings| Masking {
        segmenter: Some(open(settings, 2).unwrap()),
        ..Default::default()
    };
    let with_masks = painted_log();
    let mut without = painted_log();
    painted::forget_masks(&mut without);

    let masks_folder = tempfile::tempdir().unwrap();
    let (server, connection) = in_process(masks_folder.path(), segmenter(&settings)).await;
    uploaded(&connection, &with_masks).await;
    let reference = decomposed(&connection).await;
    assert!(
        reference.free_masks.is_empty(),
        "the log's masks go first: {reference:?}"
    );
    server.shutdown(Duration::from_secs(5)).await;

    let (server, connection) = in_process(folder.path(), segmenter(&settings)).await;
    uploaded(&connection, &without).await;
    let made = decomposed(&connection).await;
    assert!(made.free_masks["matched"] > 50, "{made:?}");
    assert!(
        made.warnings.iter().any(|w| w.contains("yolo.onnx found")),
        "{made:?}"
    );
    assert!(!kept(&reference).is_empty());
    assert_eq!(kept(&made), kept(&reference));
    let again = decomposed(&connection).await;
    assert!(
        again.warnings.iter().any(|w| w.contains(&made.name)),
        "{again:?}"
    );
    server.shutdown(Duration::from_secs(5)).await;

    // The same model in the wrong channel order is another segmenter: nothing is reused, and it finds nothing.
    let wrong = SegmenterSettings {
        channels: ChannelOrder::Bgr,
        ..settings
    };
    let (server, connection) = in_process(folder.path(), segmenter(&wrong)).await;
    let wrong = decomposed(&connection).await;
    assert!(
        !wrong.warnings.iter().any(|w| w.contains(&made.name)),
        "{wrong:?}"
    );
    assert!(kept(&wrong).is_empty(), "{wrong:?}");
    server.shutdown(Duration::from_secs(5)).await;
}

/// A slow segmenter that says when it has begun.
#[derive(Debug)]
struct Slow {
    images: AtomicUsize,
    begun: Mutex<Option<tokio::sync::oneshot::Sender<()>>>,
}

impl Segmenter for Slow {
    fn segment(&self, _: RgbImage<'_>) -> Result<Vec<Instance>, SegmentError> {
        self.images.fetch_add(1, Ordering::SeqCst);
        if let Some(begun) = self.begun.lock().unwrap().take() {
            begun.send(()).unwrap();
        }
        std::thread::sleep(Duration::from_secs(1));
        Ok(Vec::new())
    }

    fn digest(&self) -> Digest {
        Digest::of(b"slow")
    }

    fn name(&self) -> &str {
        "slow"
    }
}

#[tokio::test]
async fn a_running_decomposition_is_cancelled_between_two_images() {
    let folder = tempfile::tempdir().unwrap();
    let (begun, has_begun) = tokio::sync::oneshot::channel();
    let slow = Arc::new(Slow {
        images: AtomicUsize::new(0),
        begun: Mutex::new(Some(begun)),
    });
    let masking = Masking {
        segmenter: Some(slow.clone()),
        ..Default::default()
    };
    let (server, connection) = in_process(folder.path(), masking).await;
    let mut log = logs::small(7);
    painted::forget_masks(&mut log);
    uploaded(&connection, &log).await;
    let job = watch::create_job(&connection, decompose()).await.unwrap();
    has_begun.await.unwrap();
    let name = job.name.clone();
    let get = v1::GetJobRequest { name: name.clone() };
    let reply = connection.jobs().get_job(get).await.unwrap();
    let running = reply.into_inner().job.unwrap();
    assert_eq!(running.state(), v1::JobState::Running, "{running:?}");
    let cancel = v1::CancelJobRequest { name: name.clone() };
    connection.jobs().cancel_job(cancel).await.unwrap();
    let ended = watch::watch_job(&connection, &name, |_| {}).await.unwrap();
    assert_eq!(ended.state(), v1::JobState::Cancelled, "{ended:?}");
    let images = slow.images.load(Ordering::SeqCst);
    assert!(
        images < log.drive_log.frames.len(),
        "all {images} images were segmented"
    );
    server.shutdown(Duration::from_secs(5)).await;
}

#[tokio::test]
#[ignore = "needs the shared library of ONNX Runtime: tests/onnxruntime_ci.sh"]
async fn the_configured_server_decomposes_with_onnxruntime() {
    let folder = tempfile::tempdir().unwrap();
    let settings = settings(folder.path(), Layout::MaskRcnn, RuntimeKind::OnnxRuntime);
    let text = format!(
        "[segmenter]\nmodel = \"{}\"\nlayout = \"mask-rcnn\"\ninput_px = [{}, {}]\nmost_iou = 0.9\nclasses = {{ 0 = \"vehicle\", 1 = \"vehicle\", 2 = \"vehicle\" }}\n",
        settings.model.display(),
        settings.input_px.0,
        settings.input_px.1,
    );
    let config = config(folder.path(), &text);
    let port = backlot_e2e::server::free_port();
    let data = folder.path().join("data");
    let server = Server::start_on(&data, port, &["--config", &config]).await;
    let connection = server.connect().await;
    let mut log = painted_log();
    painted::forget_masks(&mut log);
    uploaded(&connection, &log).await;
    let job = decomposed(&connection).await;
    assert!(job.free_masks["matched"] > 50, "{job:?}");
    assert!(!kept(&job).is_empty(), "{job:?}");
    let show = ["logs", "show", "painted", "--tracks"];
    let shown = finish(&mut backlot(&server.url(), &show)).succeeded();
    assert!(shown.stdout.contains("matched"), "{shown:?}");
}
