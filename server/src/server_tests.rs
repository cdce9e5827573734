//! The served API, called over a real connection with jobs that are trivial.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};

use backlot_proto::v1::asset_service_client::AssetServiceClient;
use backlot_proto::v1::blob_service_client::BlobServiceClient;
use backlot_proto::v1::job_service_client::JobServiceClient;
use backlot_proto::v1::{self, JobKind, JobState};
use futures::StreamExt;
use tonic::transport::Channel;
use tonic::{Code, Status};
use tonic_health::pb::HealthCheckRequest;
use tonic_health::pb::health_client::HealthClient;
use tonic_reflection::pb::v1::server_reflection_client::ServerReflectionClient;
use tonic_reflection::pb::v1::server_reflection_request::MessageRequest;
use tonic_reflection::pb::v1::server_reflection_response::MessageResponse;
use tonic_reflection::pb::v1::{ServerReflectionRequest, ServerReflectionResponse};
use tonic_types::StatusExt;

use super::*;
use crate::domain::asset::{NewAsset, QualityReport, Usage};
use crate::domain::blob::BlobRef;
use crate::domain::job::Failure;
use crate::jobs::worker_port::{Completion, JobControl, LeasedJob, Outcome, WorkerPort};
use crate::store::DriveLogRecord;

const GRACE: Duration = Duration::from_secs(20);

struct Site {
    folder: tempfile::TempDir,
    server: RunningServer,
    channel: Channel,
}

impl Site {
    async fn start(execute: Execute) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        keep_log(&data);
        let server = Server::start_with(config(&data), execute).await.unwrap();
        let url = format!("http://{}", server.local_addr());
        let channel = Channel::from_shared(url).unwrap().connect().await.unwrap();
        Self {
            folder,
            server,
            channel,
        }
    }

    fn blobs(&self) -> BlobServiceClient<Channel> {
        BlobServiceClient::new(self.channel.clone())
    }

    fn jobs(&self) -> JobServiceClient<Channel> {
        JobServiceClient::new(self.channel.clone())
    }

    fn assets(&self) -> AssetServiceClient<Channel> {
        AssetServiceClient::new(self.channel.clone())
    }

    async fn create(&self, request: v1::CreateJobRequest) -> Result<v1::Job, Status> {
        let reply = self.jobs().create_job(request).await?;
        Ok(reply.into_inner().job.unwrap())
    }

    /// The states of a job until its watch ends.
    async fn watch(&self, job: &v1::Job) -> Vec<v1::Job> {
        let request = v1::WatchJobRequest {
            name: job.name.clone(),
        };
        let stream = self.jobs().watch_job(request).await.unwrap().into_inner();
        let states = stream.map(|message| message.unwrap().job.unwrap());
        states.collect().await
    }

    async fn write(&self, messages: Vec<v1::WriteBlobRequest>) -> Result<u64, Status> {
        let stream = futures::stream::iter(messages);
        let reply = self.blobs().write_blob(stream).await?;
        Ok(reply.into_inner().committed_bytes)
    }
}

fn config(data: &Path) -> Config {
    Config {
        low_water_bytes: 0,
        ballast_bytes: 0,
        ..Config::new(data, ([127, 0, 0, 1], 0).into())
    }
}

/// A data directory with the log that jobs name.
fn keep_log(data: &Path) {
    let store = Store::open(&StoreConfig {
        data_dir: data.to_owned(),
        low_water_bytes: 0,
        ballast_bytes: 0,
    })
    .unwrap();
    let record = DriveLogRecord {
        id: crate::domain::ids::DriveLogId::new("street").unwrap(),
        manifest: BlobRef::of(b""),
        dataset: "generated".into(),
        synthetic: true,
        camera_count: 1,
        frame_count: 1,
        sweep_count: 0,
        track_count: 0,
        travel_m: 1.0,
        created_at: crate::domain::clock::UnixMs(0),
    };
    store.create_drive_log(record).unwrap();
}

fn background(seed: u64) -> v1::CreateJobRequest {
    v1::CreateJobRequest {
        kind: JobKind::Background.into(),
        drive_log: "driveLogs/street".into(),
        seed,
        ..Default::default()
    }
}

fn one_background(job: &LeasedJob, port: &dyn WorkerPort, _: &JobControl) -> Outcome {
    let payload = port
        .write_blob(&job.spec.seed.to_le_bytes())
        .expect("there is room");
    Ok(Completion {
        assets: vec![NewAsset {
            object: None,
            usage: Usage::Library,
            payload,
            quality: QualityReport::default(),
            synthetic: true,
        }],
        ..Completion::default()
    })
}

fn until_stopped(_: &LeasedJob, _: &dyn WorkerPort, control: &JobControl) -> Outcome {
    while !control.cancelled() {
        std::thread::sleep(Duration::from_millis(5));
    }
    Err(Failure {
        reason: "STOPPED".into(),
        message: String::new(),
        retryable: false,
    })
}

fn chunk(blob: Option<&[u8]>, offset: u64, bytes: &[u8]) -> v1::WriteBlobRequest {
    v1::WriteBlobRequest {
        blob: blob.map(|content| v1::BlobRef {
            digest: blake3::hash(content).to_hex().to_string(),
            size_bytes: content.len() as u64,
        }),
        offset,
        chunk_crc32c: crc32c::crc32c(bytes),
        chunk: bytes.to_vec().into(),
    }
}

fn digest(content: &[u8]) -> String {
    blake3::hash(content).to_hex().to_string()
}

#[tokio::test(flavor = "multi_thread")]
async fn blobs_are_resumed_read_in_parts_and_verified() {
    let site = Site::start(Arc::new(one_background)).await;
    let content: Vec<u8> = (0..3_000_000_u32).map(|i| (i * 7) as u8).collect();
    let parts: Vec<&[u8]> = content.chunks(1 << 20).collect();
    let cut = site.write(vec![chunk(Some(&content), 0, parts[0])]).await;
    assert_eq!(cut.unwrap(), 1 << 20);
    let query = v1::QueryBlobWriteRequest {
        digest: digest(&content),
    };
    let held = site.blobs().query_blob_write(query).await.unwrap();
    assert_eq!(
        (held.get_ref().committed_bytes, held.get_ref().complete),
        (1 << 20, false)
    );
    let rest = vec![
        chunk(Some(&content), 1 << 20, parts[1]),
        chunk(None, 2 << 20, parts[2]),
    ];
    assert_eq!(site.write(rest).await.unwrap(), content.len() as u64);
    let request = v1::ReadBlobRequest {
        digest: digest(&content),
        offset: 1_000,
        limit: 2_000_000,
    };
    let stream = site.blobs().read_blob(request).await.unwrap().into_inner();
    let mut read = Vec::new();
    let messages: Vec<_> = stream.collect().await;
    for message in messages {
        let message = message.unwrap();
        assert_eq!(message.offset, 1_000 + read.len() as u64);
        assert_eq!(message.chunk_crc32c, crc32c::crc32c(&message.chunk));
        read.extend_from_slice(&message.chunk);
    }
    assert!(read == content[1_000..2_001_000]);
    let missing = v1::FindMissingBlobsRequest {
        digests: vec![digest(&content), digest(b"none"), digest(b"none")],
    };
    let missing = site.blobs().find_missing_blobs(missing).await.unwrap();
    assert_eq!(missing.get_ref().missing_digests, [digest(b"none")]);
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_blob_calls_are_refused_with_the_cause() {
    let site = Site::start(Arc::new(one_background)).await;
    let wrong_digest = vec![chunk(Some(b"right"), 0, b"wrong")];
    let mut bad_crc = chunk(Some(b"right"), 0, b"right");
    bad_crc.chunk_crc32c ^= 1;
    let gap = vec![chunk(Some(b"right"), 1, b"ight")];
    let long = vec![chunk(Some(b"right"), 0, b"right!")];
    let nameless = vec![chunk(None, 0, b"right")];
    let large = vec![0; (1 << 20) + 1];
    for (messages, cause) in [
        (wrong_digest, "has digest"),
        (vec![bad_crc], "chunk_crc32c"),
        (gap, "must start at byte 0"),
        (long, "over the limit"),
        (nameless, "blob: is missing"),
        (vec![chunk(Some(&large), 0, &large)], "at most 1048576"),
        (Vec::new(), "no message"),
    ] {
        let status = site.write(messages).await.unwrap_err();
        assert_eq!(status.code(), Code::InvalidArgument, "{status}");
        assert!(status.message().contains(cause), "{status}");
    }
    let huge = vec![0; 9 << 20];
    let status = site
        .write(vec![chunk(Some(&huge), 0, &huge)])
        .await
        .unwrap_err();
    assert!(status.message().contains("limit"), "{status}");
    let absent = v1::ReadBlobRequest {
        digest: digest(b"absent"),
        ..Default::default()
    };
    let status = site.blobs().read_blob(absent).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_damaged_blob_is_not_served() {
    let site = Site::start(Arc::new(one_background)).await;
    site.write(vec![chunk(Some(b"right"), 0, b"right")])
        .await
        .unwrap();
    let name = digest(b"right");
    let file: PathBuf = ["data", "blobs", &name[..2], &name].iter().collect();
    std::fs::write(site.folder.path().join(file), b"wrong").unwrap();
    let request = v1::ReadBlobRequest {
        digest: name.clone(),
        ..Default::default()
    };
    let status = site.blobs().read_blob(request).await.unwrap_err();
    assert_eq!(status.code(), Code::DataLoss);
    assert!(status.message().contains(&name));
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_job_is_made_once_watched_to_its_end_and_its_asset_listed() {
    let site = Site::start(Arc::new(one_background)).await;
    let request = v1::CreateJobRequest {
        request_id: "once".into(),
        ..background(7)
    };
    let calls = (0..20).map(|_| site.create(request.clone()));
    let made = futures::future::join_all(calls).await;
    let job = made[0].as_ref().unwrap().clone();
    for other in made {
        assert_eq!(other.unwrap().name, job.name);
    }
    let clash = v1::CreateJobRequest {
        request_id: "once".into(),
        ..background(8)
    };
    assert_eq!(
        site.create(clash).await.unwrap_err().code(),
        Code::AlreadyExists
    );
    let states = site.watch(&job).await;
    let last = states.last().unwrap();
    assert_eq!(last.state(), JobState::Succeeded);
    assert!(
        states[..states.len() - 1]
            .iter()
            .all(|job| job.end_time.is_none())
    );
    let all = v1::ListAssetsRequest::default();
    let assets = site.assets().list_assets(all).await.unwrap();
    let assets = assets.into_inner().assets;
    assert_eq!(assets.len(), 1);
    assert_eq!(last.assets, [assets[0].name.clone()]);
    assert!(assets[0].quality.as_ref().unwrap().psnr_held_out.is_nan());
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn snapshots_outlive_deletion_and_growth() {
    let site = Site::start(Arc::new(one_background)).await;
    let snapshot = async || {
        let request = v1::CreateLibrarySnapshotRequest {};
        let reply = site.assets().create_library_snapshot(request).await;
        reply.unwrap().into_inner().library_snapshot.unwrap()
    };
    let empty = snapshot().await;
    assert!(empty.assets.is_empty());
    let job = site.create(background(1)).await.unwrap();
    let asset = site.watch(&job).await.last().unwrap().assets[0].clone();
    let one = snapshot().await;
    assert_eq!(one, snapshot().await);
    assert_eq!(one.assets, std::slice::from_ref(&asset));
    let name = asset.clone();
    let delete = v1::DeleteAssetRequest { name };
    site.assets().delete_asset(delete).await.unwrap();
    let get = v1::GetAssetRequest { name: asset };
    let status = site.assets().get_asset(get).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert_eq!(snapshot().await.name, empty.name);
    let name = one.name.clone();
    let get = v1::GetLibrarySnapshotRequest { name };
    let kept = site.assets().get_library_snapshot(get).await.unwrap();
    assert_eq!(kept.into_inner().library_snapshot, Some(one));
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn bad_job_calls_name_the_field() {
    let site = Site::start(Arc::new(one_background)).await;
    for (request, code, field) in [
        (
            v1::CreateJobRequest {
                kind: 0,
                ..background(0)
            },
            Code::InvalidArgument,
            "kind",
        ),
        (
            v1::CreateJobRequest {
                hold_out_every: 1,
                ..background(0)
            },
            Code::InvalidArgument,
            "hold_out_every",
        ),
        (
            v1::CreateJobRequest {
                drive_log: "../x".into(),
                ..background(0)
            },
            Code::InvalidArgument,
            "drive_log",
        ),
        (
            v1::CreateJobRequest {
                request_id: "x".repeat(129),
                ..background(0)
            },
            Code::InvalidArgument,
            "request_id",
        ),
        (
            v1::CreateJobRequest {
                drive_log: "driveLogs/none".into(),
                ..background(0)
            },
            Code::NotFound,
            "",
        ),
    ] {
        let status = site.create(request).await.unwrap_err();
        assert_eq!(status.code(), code, "{status}");
        let details = status.get_error_details();
        let named = details
            .bad_request()
            .map_or("", |bad| &bad.field_violations[0].field);
        assert_eq!(named, field);
    }
    let none = v1::ListJobsRequest::default();
    let listed = site.jobs().list_jobs(none).await.unwrap();
    assert!(
        listed.get_ref().jobs.is_empty(),
        "a refused call left a job"
    );
    let get = v1::GetJobRequest {
        name: "jobs/none".into(),
    };
    let status = site.jobs().get_job(get).await.unwrap_err();
    assert_eq!(status.code(), Code::NotFound);
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn lists_are_paged() {
    let site = Site::start(Arc::new(until_stopped)).await;
    let mut made = Vec::new();
    for seed in 0..5 {
        made.push(site.create(background(seed)).await.unwrap().name);
    }
    let mut listed = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListJobsRequest {
            page_size: 2,
            page_token,
            ..Default::default()
        };
        let page = site.jobs().list_jobs(request).await.unwrap().into_inner();
        assert!(page.jobs.len() <= 2);
        listed.extend(page.jobs.into_iter().map(|job| job.name));
        page_token = page.next_page_token;
        if page_token.is_empty() {
            break;
        }
    }
    assert_eq!(listed, made);
    assert!(site.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn shutdown_ends_watches_gives_jobs_back_and_lets_the_next_server_in() {
    let site = Site::start(Arc::new(until_stopped)).await;
    let job = site.create(background(0)).await.unwrap();
    let mut health = HealthClient::new(site.channel.clone());
    let reply = health.check(HealthCheckRequest::default()).await.unwrap();
    assert_eq!(reply.get_ref().status, 1, "serving");
    let request = v1::WatchJobRequest {
        name: job.name.clone(),
    };
    let mut stream = site.jobs().watch_job(request).await.unwrap().into_inner();
    while stream
        .message()
        .await
        .unwrap()
        .unwrap()
        .job
        .unwrap()
        .state()
        != JobState::Running
    {}
    let data = site.folder.path().join("data");
    let second = Server::start_with(config(&data), Arc::new(until_stopped)).await;
    let error = second.unwrap_err().to_string();
    assert!(
        error.contains("another server uses the data directory"),
        "{error}"
    );

    let begun = Instant::now();
    assert!(site.server.shutdown(GRACE).await);
    assert!(begun.elapsed() < GRACE);
    let last = loop {
        match stream.message().await {
            Ok(Some(_)) => {}
            other => break other,
        }
    };
    assert_eq!(last.unwrap_err().code(), Code::Unavailable);

    let server = Server::start_with(config(&data), Arc::new(one_background))
        .await
        .unwrap();
    let url = format!("http://{}", server.local_addr());
    let channel = Channel::from_shared(url).unwrap().connect().await.unwrap();
    let again = Site {
        folder: site.folder,
        server,
        channel,
    };
    let last = again.watch(&job).await.pop().unwrap();
    assert_eq!((last.state(), last.attempt), (JobState::Succeeded, 1));
    assert!(again.server.shutdown(GRACE).await);
}

#[tokio::test(flavor = "multi_thread")]
async fn reflection_lists_every_service() {
    let site = Site::start(Arc::new(one_background)).await;
    let question = ServerReflectionRequest {
        host: String::new(),
        message_request: Some(MessageRequest::ListServices(String::new())),
    };
    let mut client = ServerReflectionClient::new(site.channel.clone());
    let stream = futures::stream::iter([question]);
    let replies = client.server_reflection_info(stream).await.unwrap();
    let replies: Vec<Result<ServerReflectionResponse, Status>> =
        replies.into_inner().collect().await;
    let Some(MessageResponse::ListServicesResponse(listed)) =
        replies[0].clone().unwrap().message_response
    else {
        panic!("{replies:?}")
    };
    let names: Vec<String> = listed.service.into_iter().map(|found| found.name).collect();
    for service in SERVICES {
        assert!(names.iter().any(|name| name == service), "{names:?}");
    }
    assert!(site.server.shutdown(GRACE).await);
}
