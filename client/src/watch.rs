//! Submitting jobs and following them to their end.

use std::time::Duration;

use backlot_proto::v1;

use crate::connection::{Connection, with_deadline};
use crate::error::{Error, Result};

/// Reconnections in a row before a watch gives up.
const RECONNECTS: u32 = 8;
const FIRST_PAUSE: Duration = Duration::from_millis(250);

/// Queues a job.
pub async fn create_job(connection: &Connection, request: v1::CreateJobRequest) -> Result<v1::Job> {
    let doing = format!("submitting a job for {}", request.drive_log);
    let reply = connection.jobs().create_job(with_deadline(request)).await;
    let job = reply
        .map_err(Error::status(doing.clone()))?
        .into_inner()
        .job;
    job.ok_or_else(|| Error::Protocol {
        doing,
        what: "the reply holds no job".to_owned(),
    })
}

/// Follows a job until it has succeeded, failed or been cancelled, through restarts of the server.
pub async fn watch_job(
    connection: &Connection,
    name: &str,
    mut on_change: impl FnMut(&v1::Job),
) -> Result<v1::Job> {
    let mut pause = FIRST_PAUSE;
    let mut cuts = 0;
    loop {
        let mut seen = false;
        let error = match watch_once(connection, name, &mut on_change, &mut seen).await {
            Ok(job) => return Ok(job),
            Err(error) => error,
        };
        if seen {
            (cuts, pause) = (0, FIRST_PAUSE);
        }
        cuts += 1;
        if cuts > RECONNECTS || !error.is_transient() {
            return Err(error);
        }
        tokio::time::sleep(pause).await;
        pause *= 2;
    }
}

/// True once a job's state no longer changes.
pub fn is_finished(job: &v1::Job) -> bool {
    use v1::JobState::{Cancelled, Failed, Succeeded};
    matches!(job.state(), Succeeded | Failed | Cancelled)
}

async fn watch_once(
    connection: &Connection,
    name: &str,
    on_change: &mut impl FnMut(&v1::Job),
    seen: &mut bool,
) -> Result<v1::Job> {
    let doing = format!("watching {name}");
    let request = v1::WatchJobRequest {
        name: name.to_owned(),
    };
    let reply = connection.jobs().watch_job(request).await;
    let mut stream = reply.map_err(Error::status(doing.clone()))?.into_inner();
    loop {
        let message = stream
            .message()
            .await
            .map_err(Error::status(doing.clone()))?;
        let Some(job) = message.and_then(|m| m.job) else {
            // Ended without a terminal state: the server is shutting down.
            let status = tonic::Status::unavailable("the stream ended before the job did");
            return Err(Error::status(doing)(status));
        };
        *seen = true;
        on_change(&job);
        if is_finished(&job) {
            return Ok(job);
        }
    }
}
