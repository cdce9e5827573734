//! Decomposition as a job: what it says, that it is kept, and that later jobs reuse it and nothing stale.

use backlot_client::{Connection, listing, upload, watch};
use backlot_e2e::damaged_masks::damage;
use backlot_e2e::programs::finish;
use backlot_e2e::{Server, backlot, logs};
use backlot_proto::v1;
use tonic::Code;

const LOG: &str = "driveLogs/street";

fn request(kind: v1::JobKind) -> v1::CreateJobRequest {
    v1::CreateJobRequest {
        kind: kind.into(),
        drive_log: LOG.to_owned(),
        budget: v1::Budget::Quick.into(),
        ..Default::default()
    }
}

async fn finished(connection: &Connection, kind: v1::JobKind) -> v1::Job {
    let job = watch::create_job(connection, request(kind)).await.unwrap();
    let job = watch::watch_job(connection, &job.name, |_| {}).await;
    let job = job.unwrap();
    assert_eq!(job.state(), v1::JobState::Succeeded, "{job:?}");
    job
}

#[tokio::test]
async fn every_track_of_a_decomposed_log_is_shown_with_its_reasons() {
    let folder = tempfile::tempdir().unwrap();
    let server = Server::start(&folder.path().join("data")).await;
    let connection = server.connect().await;
    // Its instance masks name no track.
    let mut log = logs::small(7);
    damage(&mut log, 3);
    upload::upload_log(&connection, &log, LOG, &|_| {})
        .await
        .unwrap();
    let show = ["--output", "json", "logs", "show", "street", "--tracks"];
    let none = finish(&mut backlot(&server.url(), &show));
    assert_ne!(none.code, Some(0), "{none:?}");
    assert!(
        none.stderr.contains("jobs submit decompose --log street"),
        "it says what to do: {none:?}"
    );
    let arguments = ["jobs", "submit", "decompose", "--log", "street", "--watch"];
    finish(&mut backlot(&server.url(), &arguments)).succeeded();
    let jobs = listing::jobs(&connection, LOG).await.unwrap();
    check_report(&jobs[0]);
    let shown = finish(&mut backlot(&server.url(), &show)).succeeded();
    check_rows(&shown.stdout, &jobs[0]);
}

/// Whether the job reused the decomposition of `made`.
fn reuses(job: &v1::Job, made: &v1::Job) -> bool {
    job.warnings.iter().any(|w| w.contains(&made.name))
}

#[tokio::test]
async fn a_decomposition_is_reused_until_its_inputs_change() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let server = Server::start(&data).await;
    let connection = server.connect().await;
    // Its objects are too small to be trained, so that jobs end at once.
    upload::upload_log(&connection, &logs::tiny(3), LOG, &|_| {})
        .await
        .unwrap();
    let alone = finished(&connection, v1::JobKind::Objects).await;
    let made = finished(&connection, v1::JobKind::Decompose).await;
    let with = finished(&connection, v1::JobKind::Objects).await;
    assert!(!reuses(&alone, &made) && reuses(&with, &made), "{with:?}");
    assert_eq!(with.tracks, alone.tracks, "reuse changes no decision");
    let again = finished(&connection, v1::JobKind::Decompose).await;
    assert!(reuses(&again, &made), "{again:?}");
    assert_eq!(again.tracks, made.tracks);

    // A restart loses nothing, and another threshold is another decomposition.
    assert!(server.stop().success());
    let server = Server::start(&data).await;
    let with = finished(&server.connect().await, v1::JobKind::Objects).await;
    assert!(reuses(&with, &made), "{with:?}");
    assert!(server.stop().success());
    let config = folder.path().join("server.toml");
    std::fs::write(&config, "mask_iou = 0.55\n").unwrap();
    let config = config.to_string_lossy().into_owned();
    let port = backlot_e2e::server::free_port();
    let server = Server::start_on(&data, port, &["--config", &config]).await;
    let connection = server.connect().await;
    let stale = finished(&connection, v1::JobKind::Objects).await;
    assert!(!reuses(&stale, &made), "{stale:?}");
    let other = finished(&connection, v1::JobKind::Decompose).await;
    assert!(!reuses(&other, &made), "{other:?}");
    let with = finished(&connection, v1::JobKind::Objects).await;
    assert!(reuses(&with, &other), "{with:?}");
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
        ..request(v1::JobKind::Decompose)
    };
    let refused = connection.jobs().create_job(unknown).await.unwrap_err();
    assert_eq!(refused.code(), Code::NotFound, "{refused}");

    upload::upload_log(&connection, &logs::tiny(3), LOG, &|_| {})
        .await
        .unwrap();
    // The one worker is busy for long.
    let busy = v1::CreateJobRequest {
        budget: v1::Budget::Paper.into(),
        ..request(v1::JobKind::Background)
    };
    let busy = watch::create_job(&connection, busy).await.unwrap().name;
    let waiting = request(v1::JobKind::Decompose);
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
