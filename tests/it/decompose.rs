//! Decomposition as a job: what it says, that it is kept, and that later jobs reuse it and nothing stale.

use std::path::Path;

use backlot_client::{Connection, upload, watch};
use backlot_e2e::damaged_masks::damage;
use backlot_e2e::programs::finish;
use backlot_e2e::{Server, backlot, logs};
use backlot_proto::v1;
use tonic::Code;

const LOG: &str = "driveLogs/street";

/// A server with a log whose instance masks name no track.
async fn server_with_log(folder: &Path) -> (Server, Connection) {
    let server = Server::start(&folder.join("data")).await;
    let connection = server.connect().await;
    let mut log = logs::small(7);
    damage(&mut log, 3);
    upload::upload_log(&connection, &log, LOG, &|_| {})
        .await
        .unwrap();
    (server, connection)
}

fn request(kind: v1::JobKind, budget: v1::Budget) -> v1::CreateJobRequest {
    v1::CreateJobRequest {
        kind: kind.into(),
        drive_log: LOG.to_owned(),
        budget: budget.into(),
        ..Default::default()
    }
}

async fn decompose(connection: &Connection) -> v1::Job {
    let request = request(v1::JobKind::Decompose, v1::Budget::Quick);
    let job = watch::create_job(connection, request).await.unwrap();
    let job = watch::watch_job(connection, &job.name, |_| {}).await;
    let job = job.unwrap();
    assert_eq!(job.state(), v1::JobState::Succeeded, "{job:?}");
    job
}

/// Starts training a background, and stops it once it decodes; what it said then.
async fn decoding_message(connection: &Connection) -> String {
    let request = request(v1::JobKind::Background, v1::Budget::Paper);
    let name = watch::create_job(connection, request).await.unwrap().name;
    let watch = v1::WatchJobRequest { name: name.clone() };
    let mut stream = connection
        .jobs()
        .watch_job(watch)
        .await
        .unwrap()
        .into_inner();
    let mut found = String::new();
    while let Some(message) = stream.message().await.unwrap() {
        let job = message.job.expect("a message holds a job");
        let progress = job.progress.unwrap_or_default();
        if progress.message.starts_with("decoding frames") && found.is_empty() {
            found = progress.message;
            let cancel = v1::CancelJobRequest { name: name.clone() };
            connection.jobs().cancel_job(cancel).await.unwrap();
        }
    }
    found
}

#[tokio::test]
async fn a_decomposition_is_shown_and_reused_until_its_inputs_change() {
    let folder = tempfile::tempdir().unwrap();
    let (server, connection) = server_with_log(folder.path()).await;
    let show = ["--output", "json", "logs", "show", "street", "--tracks"];
    let none = finish(&mut backlot(&server.url(), &show));
    assert_ne!(none.code, Some(0), "{none:?}");
    assert!(
        none.stderr.contains("jobs submit decompose --log street"),
        "it says what to do: {none:?}"
    );

    let job = decompose(&connection).await;
    check_report(&job);
    let shown = finish(&mut backlot(&server.url(), &show)).succeeded();
    check_rows(&shown.stdout, &job);

    let message = decoding_message(&connection).await;
    assert!(message.contains(&job.name), "reuse is said: {message:?}");
    let again = decompose(&connection).await;
    assert!(
        again.warnings.iter().any(|w| w.contains(&job.name)),
        "{again:?}"
    );
    assert_eq!(
        (again.tracks, again.free_masks),
        (job.tracks.clone(), job.free_masks.clone())
    );

    // Another threshold is another decomposition, whatever the log's name is.
    assert!(server.stop().success());
    let config = folder.path().join("server.toml");
    std::fs::write(&config, "mask_iou = 0.55\n").unwrap();
    let config = config.to_string_lossy().into_owned();
    let data = folder.path().join("data");
    let arguments = ["--config", &config];
    let server = Server::start_on(&data, backlot_e2e::server::free_port(), &arguments).await;
    let connection = server.connect().await;
    let message = decoding_message(&connection).await;
    assert!(
        !message.is_empty() && !message.contains("jobs/"),
        "nothing stale is used: {message:?}"
    );
    let other = decompose(&connection).await;
    assert!(other.warnings.is_empty(), "{other:?}");
}

fn check_report(job: &v1::Job) {
    assert!(job.assets.is_empty() && job.error.is_none(), "{job:?}");
    let log = logs::small(7).drive_log;
    assert_eq!(job.tracks.len(), log.tracks.len(), "every track is decided");
    assert!(job.tracks.iter().any(|track| track.kept), "{job:?}");
    for track in &job.tracks {
        assert_eq!(track.kept, track.reason.is_empty(), "{track:?}");
        let counted: u32 = track.rejected_by_reason.values().sum();
        assert_eq!(counted, track.rejected_frames, "{track:?}");
    }
    let masks = &job.free_masks;
    assert!(
        masks["matched"] > 50 && masks["merged"] > 0 && masks["no_cuboid"] > 0,
        "{masks:?}"
    );
    let reasons = |reason: &str| -> u32 {
        let of = |track: &v1::TrackDecision| track.rejected_by_reason.get(reason).copied();
        job.tracks.iter().filter_map(of).sum()
    };
    assert!(reasons("no_mask") > 0 && reasons("merged_mask") > 0);
}

fn check_rows(json: &str, job: &v1::Job) {
    let rows: Vec<serde_json::Value> = serde_json::from_str(json).unwrap();
    assert_eq!(rows.len(), job.tracks.len());
    for (row, track) in rows.iter().zip(&job.tracks) {
        assert_eq!(row["track"], track.track_id.as_str());
        assert_eq!(row["kept"], track.kept);
        assert_eq!(row["usable_frames"], track.usable_frames);
        assert_eq!(row["rejected_frames"], track.rejected_frames);
        assert_eq!(row["reason"], track.reason.as_str());
        assert!(row["class"].as_str().is_some_and(|class| !class.is_empty()));
    }
}

#[tokio::test]
async fn a_decomposition_of_nothing_is_refused_and_a_waiting_one_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data")).await;
    let connection = server.connect().await;
    let unknown = v1::CreateJobRequest {
        drive_log: "driveLogs/nowhere".to_owned(),
        ..request(v1::JobKind::Decompose, v1::Budget::Quick)
    };
    let refused = connection.jobs().create_job(unknown).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound, "{refused}");

    upload::upload_log(&connection, &logs::tiny(3), LOG, &|_| {})
        .await
        .unwrap();
    // The one worker is busy for long.
    let busy = request(v1::JobKind::Background, v1::Budget::Paper);
    let busy = watch::create_job(&connection, busy).await.unwrap().name;
    let waiting = request(v1::JobKind::Decompose, v1::Budget::Quick);
    let waiting = watch::create_job(&connection, waiting).await.unwrap().name;
    for name in [waiting.clone(), busy] {
        let cancel = v1::CancelJobRequest { name };
        connection.jobs().cancel_job(cancel).await.unwrap();
    }
    let ended = watch::watch_job(&connection, &waiting, |_| {})
        .await
        .unwrap();
    assert_eq!(ended.state(), v1::JobState::Cancelled, "{ended:?}");
}
