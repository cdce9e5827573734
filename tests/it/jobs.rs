//! Jobs as a client meets them: idempotent creation, watching, cancelling, failing.

use backlot_client::{Connection, upload, watch};
use backlot_e2e::programs::finish;
use backlot_e2e::{Server, backlot, logs};
use backlot_proto::v1;
use tonic::Code;

const LOG: &str = "driveLogs/street";

async fn server_with_log(folder: &std::path::Path) -> (Server, Connection) {
    let server = Server::start(&folder.join("data")).await;
    let connection = server.connect().await;
    upload::upload_log(&connection, &logs::tiny(3), LOG, &|_| {})
        .await
        .unwrap();
    (server, connection)
}

fn background(request_id: &str) -> v1::CreateJobRequest {
    v1::CreateJobRequest {
        kind: v1::JobKind::Background.into(),
        drive_log: LOG.to_owned(),
        // Long enough that it cannot end before it is cancelled.
        budget: v1::Budget::Paper.into(),
        seed: 5,
        request_id: request_id.to_owned(),
        ..Default::default()
    }
}

#[tokio::test]
async fn a_running_job_is_watched_and_cancelled() {
    let folder = tempfile::tempdir().unwrap();
    let (_server, connection) = server_with_log(folder.path()).await;
    let job = watch::create_job(&connection, background(""))
        .await
        .unwrap();
    let name = job.name.clone();
    let request = v1::WatchJobRequest { name: name.clone() };
    let mut stream = connection
        .jobs()
        .watch_job(request)
        .await
        .unwrap()
        .into_inner();
    let mut states = Vec::new();
    let mut last = v1::Job::default();
    let mut asked = false;
    while let Some(message) = stream.message().await.unwrap() {
        let job = message.job.expect("a message holds a job");
        if states.last() != Some(&job.state()) {
            states.push(job.state());
        }
        let stepping = job
            .progress
            .as_ref()
            .is_some_and(|progress| progress.step > 0);
        if job.state == v1::JobState::Running as i32 && stepping && !asked {
            connection
                .jobs()
                .cancel_job(v1::CancelJobRequest { name: name.clone() })
                .await
                .unwrap();
            asked = true;
        }
        last = job;
    }
    assert_eq!(
        states.last(),
        Some(&v1::JobState::Cancelled),
        "{states:?}: {last:?}"
    );
    assert!(states.contains(&v1::JobState::Running), "{states:?}");
    let again = connection
        .jobs()
        .cancel_job(v1::CancelJobRequest { name: name.clone() })
        .await
        .unwrap_err();
    assert_eq!(again.code(), Code::FailedPrecondition, "{again}");
    let job = connection
        .jobs()
        .get_job(v1::GetJobRequest { name })
        .await
        .unwrap()
        .into_inner()
        .job
        .unwrap();
    assert!(job.assets.is_empty() && job.end_time.is_some(), "{job:?}");
}

#[tokio::test]
async fn a_request_id_makes_creation_idempotent() {
    let folder = tempfile::tempdir().unwrap();
    let (_server, connection) = server_with_log(folder.path()).await;
    let first = watch::create_job(&connection, background("once"))
        .await
        .unwrap();
    let second = watch::create_job(&connection, background("once"))
        .await
        .unwrap();
    assert_eq!(first.name, second.name);
    let other = v1::CreateJobRequest {
        seed: 6,
        ..background("once")
    };
    let refused = connection.jobs().create_job(other).await.unwrap_err();
    assert_eq!(refused.code(), Code::AlreadyExists, "{refused}");
    connection
        .jobs()
        .cancel_job(v1::CancelJobRequest { name: first.name })
        .await
        .unwrap();
}

#[tokio::test]
async fn a_watched_cancelled_job_fails_the_command_line() {
    let folder = tempfile::tempdir().unwrap();
    let (server, connection) = server_with_log(folder.path()).await;
    let arguments = [
        "jobs",
        "submit",
        "background",
        "--log",
        "street",
        "--budget",
        "paper",
        "--watch",
    ];
    let mut command = backlot(&server.url(), &arguments);
    let watching = tokio::task::spawn_blocking(move || finish(&mut command));
    let job = loop {
        let jobs = backlot_client::listing::jobs(&connection, LOG)
            .await
            .unwrap();
        if let Some(job) = jobs.into_iter().next() {
            break job;
        }
        tokio::time::sleep(std::time::Duration::from_millis(20)).await;
    };
    connection
        .jobs()
        .cancel_job(v1::CancelJobRequest { name: job.name })
        .await
        .unwrap();
    let finished = watching.await.unwrap();
    assert!(finished.code.is_some_and(|code| code != 0), "{finished:?}");
    assert!(
        finished.stderr.to_lowercase().contains("cancel"),
        "{finished:?}"
    );
}
