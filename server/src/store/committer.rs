//! The one writer of metadata: a thread that takes waiting transactions in groups, so that one fsync serves them all.
//!
//! A group goes to the journal first, then to the index; only then are its callers told. So the index never shows what
//! is not yet durable, and a caller that reads a record may promise it to others.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;

use super::error::{Error, IoContext, Result};
use super::index::{Index, Opened, unused_name};
use super::journal::{self, Journal, Replay, Tail};
use super::metadata::Metadata;
use super::space::Space;
use super::txn::{Change, Precondition, Txn};

/// Transactions that may wait; more callers block.
const QUEUE: usize = 256;

/// Transactions that share one fsync at most.
const GROUP: usize = 128;

/// The journal is rewritten once it is this long and mostly history.
const CHECKPOINT_BYTES: u64 = 16 << 20;

struct Request {
    txn: Txn,
    reply: SyncSender<Result<()>>,
}

/// sled behind a journal.
#[derive(Debug)]
pub(super) struct JournaledIndex {
    index: Arc<Index>,
    requests: Mutex<Option<SyncSender<Request>>>,
    poison: Arc<OnceLock<String>>,
    committer: Mutex<Option<JoinHandle<()>>>,
}

impl JournaledIndex {
    /// Opens `folder`/journal and `folder`/index and makes them agree; both are made if they are missing.
    pub(super) fn open(folder: &Path, space: Space) -> Result<Self> {
        let (journal, index) = open_consistently(folder)?;
        let index = Arc::new(index);
        let poison = Arc::new(OnceLock::new());
        let (requests, waiting) = sync_channel(QUEUE);
        let mut committer = Committer {
            path: folder.join(JOURNAL),
            journal,
            index: index.clone(),
            space,
            poison: poison.clone(),
        };
        let thread = std::thread::Builder::new()
            .name("metadata-commit".into())
            .spawn(move || committer.run(&waiting))
            .map_err(|source| Error::Io {
                verb: "start a thread for",
                path: folder.to_owned(),
                source,
            })?;
        Ok(Self {
            index,
            requests: Mutex::new(Some(requests)),
            poison,
            committer: Mutex::new(Some(thread)),
        })
    }
}

impl Metadata for JournaledIndex {
    fn commit(&self, txn: Txn) -> Result<()> {
        let requests = self
            .requests
            .lock()
            .expect("no panic while held")
            .clone()
            .ok_or_else(|| poisoned("closed"))?;
        let (reply, answer) = sync_channel(1);
        requests
            .send(Request { txn, reply })
            .map_err(|_| poisoned("the commit thread has ended"))?;
        answer
            .recv()
            .unwrap_or_else(|_| Err(poisoned("the commit thread has ended")))
    }

    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>> {
        self.index.get(key)
    }

    fn scan(&self, prefix: &[u8], after: &[u8], limit: usize) -> Result<Vec<(Vec<u8>, Vec<u8>)>> {
        self.index.scan(prefix, after, limit)
    }

    fn poisoned(&self) -> Option<String> {
        self.poison.get().cloned()
    }
}

impl Drop for JournaledIndex {
    fn drop(&mut self) {
        self.requests.lock().expect("no panic while held").take();
        if let Some(thread) = self.committer.lock().expect("no panic while held").take() {
            let _ = thread.join();
        }
    }
}

const JOURNAL: &str = "journal";
const INDEX: &str = "index";

/// Reads journal and index and repairs the one from the other.
fn open_consistently(folder: &Path) -> Result<(Journal, Index)> {
    let path = folder.join(JOURNAL);
    let replay = Journal::replay(&path)?;
    let index_folder = folder.join(INDEX);
    let opened = match Index::open(&index_folder)? {
        Some(opened) => opened,
        None => Index::create(&index_folder)?,
    };
    if replay.tail == Tail::Damaged || opened.applied_seq > replay.last_seq {
        return rewrite_journal(&path, replay, opened);
    }
    if replay.tail == Tail::Torn {
        tracing::info!("cut an unfinished transaction off the journal");
    }
    let journal = Journal::open(&path, &replay)?;
    if opened.applied_seq == replay.last_seq && opened.content == replay.state {
        // Nothing is written, so that a full disk can be opened.
        return Ok((journal, opened.index));
    }
    let repaired = opened
        .index
        .repair(&opened.content, &replay.state, replay.last_seq)?;
    if repaired > 0 {
        tracing::warn!(
            records = repaired,
            "brought the metadata index up to the journal"
        );
    }
    Ok((journal, opened.index))
}

/// Saves a journal that lost entries from an index that has them, and from its own entries behind the damage.
fn rewrite_journal(path: &Path, replay: Replay, opened: Opened) -> Result<(Journal, Index)> {
    let both_damaged = || {
        Error::corrupt(format!(
            "the journal {} (after entry {}), and the index beside it (entry {}) cannot replace it; both were kept: the store",
            path.display(),
            replay.last_seq,
            opened.applied_seq
        ))
    };
    // An index that holds no more than the undamaged part knows nothing of the damaged one.
    if opened.applied_seq <= replay.last_seq {
        return Err(both_damaged());
    }
    let mut state = opened.content.clone();
    let mut seq = opened.applied_seq;
    for (later, changes) in &replay.behind_damage {
        if *later > seq + 1 {
            return Err(both_damaged());
        }
        if *later == seq + 1 {
            journal::apply(&mut state, changes.iter().cloned());
            seq = *later;
        }
    }
    let aside = unused_name(path, "damaged");
    if path.exists() {
        std::fs::copy(path, &aside).at("copy", path)?;
    }
    tracing::error!(
        kept = %aside.display(), intact_entries = replay.last_seq, index = opened.applied_seq,
        "the journal is damaged; it was written anew from the index"
    );
    let journal = Journal::checkpoint(path, &state, seq)?;
    opened.index.repair(&opened.content, &state, seq)?;
    Ok((journal, opened.index))
}

struct Committer {
    path: PathBuf,
    journal: Journal,
    index: Arc<Index>,
    space: Space,
    poison: Arc<OnceLock<String>>,
}

impl Committer {
    fn run(&mut self, waiting: &Receiver<Request>) {
        while let Ok(first) = waiting.recv() {
            let mut group = vec![first];
            while group.len() < GROUP
                && let Ok(request) = waiting.try_recv()
            {
                group.push(request);
            }
            let outcomes = self.commit_group(&group);
            for (request, outcome) in group.into_iter().zip(outcomes) {
                // A caller that went away does not change what happened.
                let _ = request.reply.send(outcome);
            }
            self.checkpoint_if_long();
        }
    }

    fn commit_group(&mut self, group: &[Request]) -> Vec<Result<()>> {
        if let Some(cause) = self.poison.get() {
            return group.iter().map(|_| Err(poisoned(cause))).collect();
        }
        let (outcomes, accepted) = self.check(group);
        if accepted.is_empty() {
            return outcomes;
        }
        match self.write(&accepted) {
            Ok(()) => outcomes,
            // A refusal may rest on a transaction of the same group that was not written: all are told the failure.
            Err(error) => group.iter().map(|_| Err(same_failure(&error))).collect(),
        }
    }

    /// Which transactions hold, each seeing the effect of those before it.
    fn check<'a>(&self, group: &'a [Request]) -> (Vec<Result<()>>, Vec<&'a [Change]>) {
        let mut pending: HashMap<&[u8], Option<&[u8]>> = HashMap::new();
        let mut accepted = Vec::new();
        let outcomes = group
            .iter()
            .map(|request| {
                for precondition in &request.txn.preconditions {
                    self.check_one(precondition, &pending)?;
                }
                for change in &request.txn.changes {
                    match change {
                        Change::Put { key, value } => pending.insert(key, Some(value)),
                        Change::Delete { key } => pending.insert(key, None),
                    };
                }
                if !request.txn.changes.is_empty() {
                    accepted.push(request.txn.changes.as_slice());
                }
                Ok(())
            })
            .collect();
        (outcomes, accepted)
    }

    fn check_one(
        &self,
        precondition: &Precondition,
        pending: &HashMap<&[u8], Option<&[u8]>>,
    ) -> Result<()> {
        let (Precondition::Absent { key }
        | Precondition::Present { key }
        | Precondition::Unchanged { key, .. }) = precondition;
        let present = match pending.get(key.as_slice()) {
            Some(value) => value.map(<[u8]>::to_vec),
            None => self.index.get(key)?,
        };
        let holds = match precondition {
            Precondition::Absent { .. } => present.is_none(),
            Precondition::Present { .. } => present.is_some(),
            Precondition::Unchanged { raw, .. } => present.as_ref() == Some(raw),
        };
        holds.then_some(()).ok_or_else(|| Error::Conflict {
            key: String::from_utf8_lossy(key).into_owned(),
        })
    }

    fn write(&mut self, accepted: &[&[Change]]) -> Result<()> {
        self.space.require_for_metadata()?;
        let seq = self.journal.append(accepted).map_err(|(error, is_lost)| {
            if is_lost {
                self.poison_with(&error);
            }
            error
        })?;
        let changes = accepted.iter().flat_map(|changes| changes.iter());
        self.index.apply(changes, seq).inspect_err(|error| {
            // The journal has the group: a restart completes it.
            self.poison_with(error);
        })
    }

    fn poison_with(&self, error: &Error) {
        tracing::error!(%error, "the store refuses further writes until the server is restarted");
        let _ = self.poison.set(error.to_string());
    }

    fn checkpoint_if_long(&mut self) {
        if self.journal.length() < CHECKPOINT_BYTES || self.poison.get().is_some() {
            return;
        }
        let rewritten = self.index.content().and_then(|state| {
            let live: usize = state.iter().map(|(k, v)| k.len() + v.len()).sum();
            if (live as u64) * 4 > self.journal.length() {
                return Ok(None);
            }
            Journal::checkpoint(&self.path, &state, self.journal.last_seq()).map(Some)
        });
        match rewritten {
            Ok(Some(journal)) => self.journal = journal,
            Ok(None) => {}
            // The rename may or may not have happened, so this handle may point at a file without a name.
            Err(error) => self.poison_with(&error),
        }
    }
}

fn poisoned(cause: &str) -> Error {
    Error::Poisoned {
        cause: cause.to_owned(),
    }
}

/// The same message for every caller of a failed group.
fn same_failure(error: &Error) -> Error {
    match error {
        Error::DiskFull {
            free_bytes,
            needed_bytes,
        } => Error::DiskFull {
            free_bytes: *free_bytes,
            needed_bytes: *needed_bytes,
        },
        Error::Io { verb, path, source } => Error::Io {
            verb,
            path: path.clone(),
            source: std::io::Error::new(source.kind(), source.to_string()),
        },
        other => poisoned(&other.to_string()),
    }
}

#[cfg(test)]
#[path = "committer_tests.rs"]
mod tests;
