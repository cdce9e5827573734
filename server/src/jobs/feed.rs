//! The latest state of watched jobs. A watcher that is slow sees the newest state, not a backlog.

use std::collections::HashMap;
use std::sync::Mutex;

use tokio::sync::watch;

use crate::domain::ids::JobId;
use crate::domain::job::{Job, Progress};

/// Tells watchers about changes that are already on stable storage.
#[derive(Debug, Default)]
pub(super) struct Feed {
    watched: Mutex<HashMap<JobId, watch::Sender<Job>>>,
}

impl Feed {
    /// A receiver whose value is the present job, which `load` reads. `load` runs after the registration, so that no
    /// change falls between the two.
    pub(super) fn subscribe<E>(
        &self,
        id: &JobId,
        load: impl Fn() -> Result<Job, E>,
    ) -> Result<watch::Receiver<Job>, E> {
        let first = load()?;
        let receiver = {
            let mut watched = self.watched.lock().expect("no panic while held");
            watched.retain(|_, sender| sender.receiver_count() > 0);
            watched
                .entry(id.clone())
                .or_insert_with(|| watch::channel(first).0)
                .subscribe()
        };
        self.publish(&load()?);
        Ok(receiver)
    }

    /// Shows a committed state, unless a newer one is shown already.
    pub(super) fn publish(&self, job: &Job) {
        if let Some(sender) = self
            .watched
            .lock()
            .expect("no panic while held")
            .get(&job.id)
        {
            sender.send_if_modified(|shown| {
                let newer = job.revision > shown.revision;
                if newer {
                    shown.clone_from(job);
                }
                newer
            });
        }
    }

    /// Shows progress between two commits.
    pub(super) fn publish_progress(&self, job: &Job, progress: &Progress) {
        if let Some(sender) = self
            .watched
            .lock()
            .expect("no panic while held")
            .get(&job.id)
        {
            sender.send_if_modified(|shown| {
                let same = shown.revision == job.revision && shown.progress != *progress;
                if same {
                    shown.progress = progress.clone();
                }
                same
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::domain::clock::UnixMs;
    use crate::domain::ids::DriveLogId;
    use crate::domain::job::{Budget, Event, JobKind, JobSpec};

    fn job() -> Job {
        let spec = JobSpec {
            kind: JobKind::Objects,
            drive_log: DriveLogId::new("street").unwrap(),
            budget: Budget::Quick,
            seed: 0,
            hold_out_every: 8,
        };
        Job::new(JobId::new("j").unwrap(), spec, UnixMs(0))
    }

    #[test]
    fn watchers_see_newer_states_only() {
        let feed = Feed::default();
        let first = job();
        let worker = "w".to_owned();
        let second = first.apply(Event::Claimed { worker }, UnixMs(1)).unwrap();
        let receiver = feed
            .subscribe(&first.id, || Ok::<_, ()>(first.clone()))
            .unwrap();
        assert_eq!(*receiver.borrow(), first);
        feed.publish(&second);
        assert_eq!(*receiver.borrow(), second);
        feed.publish(&first);
        assert_eq!(*receiver.borrow(), second);
        let late = feed
            .subscribe(&first.id, || Ok::<_, ()>(second.clone()))
            .unwrap();
        assert_eq!(*late.borrow(), second);
    }

    #[test]
    fn a_missing_job_is_not_watched() {
        let feed = Feed::default();
        assert!(feed.subscribe(&job().id, || Err::<Job, _>("none")).is_err());
        assert!(feed.watched.lock().unwrap().is_empty());
    }
}
