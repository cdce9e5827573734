//! Job records with their two indices: `q` lists queued jobs in order of creation, `r` the running ones.

use serde::{Deserialize, Serialize};

use super::error::{Error, Result};
use super::record::{Record, Stored};
use super::{Store, Txn};
use crate::domain::ids::JobId;
use crate::domain::job::{Job, JobSpec};

const QUEUED: u8 = b'q';
const RUNNING: u8 = b'r';

impl Record for Job {
    const TABLE: u8 = b'j';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "job";

    fn id(&self) -> String {
        self.id.as_str().to_owned()
    }
}

/// Which job a request made, so that repeating the request makes no second one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct RequestRecord {
    request_id: String,
    job: JobId,
    spec: JobSpec,
}

impl Record for RequestRecord {
    const TABLE: u8 = b'i';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "request";

    fn id(&self) -> String {
        self.request_id.clone()
    }
}

impl Store {
    /// Commits a new job. With the `request_id` of an earlier job that job is returned, or an error if it differs. The
    /// job's drive log must exist when the job is committed.
    pub fn create_job(&self, job: Job, request_id: Option<&str>) -> Result<Job> {
        if let Some(present) = self.job_of_request(request_id, &job.spec)? {
            return Ok(present);
        }
        let log = job.spec.drive_log.as_str();
        let mut txn = Txn::new()
            .require_present::<super::DriveLogRecord>(log)
            .create(&job)?;
        txn = with_indices(txn, None, &job);
        if let Some(request_id) = request_id {
            txn = txn.create(&RequestRecord {
                request_id: request_id.to_owned(),
                job: job.id.clone(),
                spec: job.spec.clone(),
            })?;
        }
        match self.metadata().commit(txn) {
            Ok(()) => Ok(job),
            Err(Error::Conflict { key }) => {
                // Either the log is gone or a twin of this request was faster.
                self.drive_log(&job.spec.drive_log)?;
                self.job_of_request(request_id, &job.spec)?
                    .ok_or(Error::Conflict { key })
            }
            Err(e) => Err(e),
        }
    }

    fn job_of_request(&self, request_id: Option<&str>, spec: &JobSpec) -> Result<Option<Job>> {
        let Some(request_id) = request_id else {
            return Ok(None);
        };
        let Some(request) = self.metadata().find::<RequestRecord>(request_id)? else {
            return Ok(None);
        };
        if request.record.spec != *spec {
            return Err(Error::Exists {
                what: format!("request \"{request_id}\""),
            });
        }
        Ok(Some(self.job(&request.record.job)?.record))
    }

    pub fn job(&self, id: &JobId) -> Result<Stored<Job>> {
        self.metadata().load(id.as_str())
    }

    /// Up to `limit` jobs with ids greater than `after` for which `keep` holds.
    pub fn jobs(&self, after: &str, limit: usize, keep: impl Fn(&Job) -> bool) -> Result<Vec<Job>> {
        self.metadata().page_where(after, limit, keep)
    }

    /// Replaces a job that must still be as it was read, together with what `txn` holds.
    pub fn replace_job(&self, old: &Stored<Job>, new: &Job, txn: Txn) -> Result<()> {
        let txn = txn.replace(old, new)?;
        self.metadata()
            .commit(with_indices(txn, Some(&old.record), new))
    }

    /// Up to `limit` queued jobs with ids greater than `after`, oldest first.
    pub fn queued_jobs(&self, after: &str, limit: usize) -> Result<Vec<JobId>> {
        self.marked(QUEUED, after, limit)
    }

    pub fn running_jobs(&self) -> Result<Vec<JobId>> {
        self.marked(RUNNING, "", usize::MAX)
    }

    fn marked(&self, table: u8, after: &str, limit: usize) -> Result<Vec<JobId>> {
        self.metadata()
            .scan(&[table], &marker(table, after), limit)?
            .into_iter()
            .map(|(key, _)| {
                let id = String::from_utf8_lossy(&key[1..]).into_owned();
                JobId::new(&id).map_err(|e| Error::corrupt(format!("job index ({e})")))
            })
            .collect()
    }
}

fn with_indices(mut txn: Txn, old: Option<&Job>, new: &Job) -> Txn {
    let id = new.id.as_str();
    for (table, was, is) in [
        (QUEUED, old.is_some_and(Job::is_queued), new.is_queued()),
        (RUNNING, old.is_some_and(Job::is_running), new.is_running()),
    ] {
        txn = match (was, is) {
            (false, true) => txn.mark(marker(table, id)),
            (true, false) => txn.unmark(marker(table, id)),
            _ => txn,
        };
    }
    txn
}

fn marker(table: u8, id: &str) -> Vec<u8> {
    let mut key = vec![table];
    key.extend_from_slice(id.as_bytes());
    key
}
