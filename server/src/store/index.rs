//! sled as the index over the journal: opened under guard, repaired or rebuilt from the journal when it is damaged.
//!
//! sled 0.34 is beta: an interrupted snapshot can make it unopenable, a flipped bit can make it panic, and its flush does
//! not fsync. So it is opened and read once in full under `catch_unwind`, everything in it can be made again, and
//! `apply` fsyncs its file itself.

use std::fs::File;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::error::{Error, IoContext, Result};
use super::journal::{State, sync_parent};
use super::lock::{LOCK_WAIT, when_free};
use super::record::is_intact;
use super::txn::Change;

/// Metadata is a few megabytes; sled's default would let it take 1 GiB.
const CACHE_BYTES: u64 = 32 << 20;

/// Key of the journal sequence up to which the index is complete, in its own tree.
const APPLIED: &[u8] = b"applied";

#[derive(Debug)]
pub(super) struct Index {
    folder: PathBuf,
    db: sled::Db,
    records: sled::Tree,
    bookkeeping: sled::Tree,
}

/// An index as found at start.
#[derive(Debug)]
pub(super) struct Opened {
    pub(super) index: Index,
    pub(super) content: State,
    pub(super) applied_seq: u64,
}

impl Index {
    /// Opens what is there, without its snapshot if need be. `None` if it cannot be read; it was moved aside then.
    ///
    /// # Errors
    /// [`Error::InUse`] if its lock is held, [`Error::Io`] if the disk is full or the folder cannot be changed. It is left as it
    /// is then.
    pub(super) fn open(folder: &Path) -> Result<Option<Opened>> {
        Self::open_within(folder, LOCK_WAIT)
    }

    fn open_within(folder: &Path, lock_wait: Duration) -> Result<Option<Opened>> {
        std::fs::create_dir_all(folder).at("create", folder)?;
        remove_unfinished_snapshots(folder)?;
        let first = match when_free(lock_wait, || try_open(folder)) {
            Ok(opened) => return Ok(Some(opened)),
            Err(e) => e,
        };
        if is_disk_full(&first) || matches!(first, Error::InUse { .. }) {
            return Err(first);
        }
        tracing::warn!(error = %first, "the metadata index does not open; trying without its snapshot");
        if move_snapshots_aside(folder)? {
            match when_free(lock_wait, || try_open(folder)) {
                Ok(opened) => return Ok(Some(opened)),
                Err(e) => tracing::warn!(error = %e, "nor without its snapshot"),
            }
        }
        let aside = unused_name(folder, "damaged");
        std::fs::rename(folder, &aside).at("rename", folder)?;
        sync_parent(folder)?;
        tracing::error!(kept = %aside.display(), "the metadata index is damaged and was moved aside");
        Ok(None)
    }

    /// A new, empty index.
    pub(super) fn create(folder: &Path) -> Result<Opened> {
        std::fs::create_dir_all(folder).at("create", folder)?;
        when_free(LOCK_WAIT, || try_open(folder))
    }

    /// Makes the changes, in order, and the sequence durable.
    pub(super) fn apply<'a>(
        &self,
        changes: impl IntoIterator<Item = &'a Change>,
        seq: u64,
    ) -> Result<()> {
        let mut batch = sled::Batch::default();
        for change in changes {
            match change {
                Change::Put { key, value } => batch.insert(key.as_slice(), value.as_slice()),
                Change::Delete { key } => batch.remove(key.as_slice()),
            }
        }
        self.records.apply_batch(batch).map_err(index_error)?;
        // After the batch, so that a recovered prefix of sled's log never claims more than it holds.
        self.bookkeeping
            .insert(APPLIED, &seq.to_le_bytes())
            .map_err(index_error)?;
        self.db.flush().map_err(index_error)?;
        let file = self.folder.join("db");
        File::open(&file)
            .and_then(|file| file.sync_all())
            .at("sync", file)
    }

    /// Makes the index equal to `state`; returns how many keys differed.
    pub(super) fn repair(&self, content: &State, state: &State, seq: u64) -> Result<usize> {
        let put = state
            .iter()
            .filter(|(key, value)| content.get(*key) != Some(value))
            .map(|(key, value)| Change::Put {
                key: key.clone(),
                value: value.clone(),
            });
        let delete = content
            .keys()
            .filter(|key| !state.contains_key(*key))
            .map(|key| Change::Delete { key: key.clone() });
        let changes: Vec<Change> = put.chain(delete).collect();
        self.apply(&changes, seq)?;
        Ok(changes.len())
    }

    pub(super) fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>> {
        let value = self.records.get(key).map_err(index_error)?;
        Ok(value.map(|value| value.to_vec()))
    }

    pub(super) fn scan(
        &self,
        prefix: &[u8],
        after: &[u8],
        limit: usize,
    ) -> Result<Vec<(Vec<u8>, Vec<u8>)>> {
        use std::ops::Bound;
        let from = match after > prefix {
            true => Bound::Excluded(after),
            false => Bound::Included(prefix),
        };
        self.records
            .range::<&[u8], _>((from, Bound::Unbounded))
            .take_while(|pair| !matches!(pair, Ok((key, _)) if !key.starts_with(prefix)))
            .take(limit)
            .map(|pair| {
                let (key, value) = pair.map_err(index_error)?;
                Ok((key.to_vec(), value.to_vec()))
            })
            .collect()
    }

    pub(super) fn content(&self) -> Result<State> {
        let pairs = self.scan(b"", b"", usize::MAX)?;
        Ok(pairs.into_iter().collect())
    }
}

fn try_open(folder: &Path) -> Result<Opened> {
    let open = || -> Result<Opened> {
        let db = sled::Config::new()
            .path(folder)
            .cache_capacity(CACHE_BYTES)
            .flush_every_ms(None)
            .open()
            .map_err(|e| match is_locked(&e) {
                true => Error::InUse {
                    path: folder.to_owned(),
                },
                false => index_error(e),
            })?;
        let index = Index {
            folder: folder.to_owned(),
            records: db.open_tree("records").map_err(index_error)?,
            bookkeeping: db.open_tree("bookkeeping").map_err(index_error)?,
            db,
        };
        let content = index.content()?;
        // An empty value is an index entry, anything else a checksummed record.
        if let Some((key, _)) = content
            .iter()
            .find(|(_, value)| !value.is_empty() && !is_intact(value))
        {
            return Err(Error::corrupt(format!(
                "index record {:?}",
                String::from_utf8_lossy(key)
            )));
        }
        let applied_seq = match index.bookkeeping.get(APPLIED).map_err(index_error)? {
            Some(bytes) => u64::from_le_bytes(
                bytes
                    .as_ref()
                    .try_into()
                    .map_err(|_| Error::corrupt("index sequence"))?,
            ),
            None => 0,
        };
        Ok(Opened {
            index,
            content,
            applied_seq,
        })
    };
    catch_unwind(AssertUnwindSafe(open)).unwrap_or_else(|_| {
        Err(Error::Index {
            what: "sled panicked while opening".into(),
        })
    })
}

/// sled has no error of its own for this, only a text.
fn is_locked(error: &sled::Error) -> bool {
    matches!(error, sled::Error::Io(e) if e.to_string().starts_with("could not acquire lock"))
}

fn index_error(error: sled::Error) -> Error {
    match error {
        sled::Error::Io(source) => Error::Io {
            verb: "access",
            path: PathBuf::from("metadata index"),
            source,
        },
        other => Error::Index {
            what: other.to_string(),
        },
    }
}

fn is_disk_full(error: &Error) -> bool {
    matches!(error, Error::Io { source, .. } if super::error::is_disk_full(source))
}

/// A kill while sled writes a snapshot leaves a file that it cannot open afterwards.
fn remove_unfinished_snapshots(folder: &Path) -> Result<()> {
    for path in files(folder)? {
        if file_name(&path).starts_with("snap.") && file_name(&path).ends_with(".generating") {
            std::fs::remove_file(&path).at("remove", &path)?;
            tracing::info!(file = %path.display(), "removed an unfinished index snapshot");
        }
    }
    Ok(())
}

/// Without snapshots sled reads its whole log instead. Returns whether there was one.
fn move_snapshots_aside(folder: &Path) -> Result<bool> {
    let mut moved = false;
    for path in files(folder)? {
        if file_name(&path).starts_with("snap.") {
            let aside = unused_name(folder, &file_name(&path));
            std::fs::rename(&path, &aside).at("rename", &path)?;
            moved = true;
        }
    }
    Ok(moved)
}

/// `folder-suffix-N` beside `folder` for the first N that is free.
pub(super) fn unused_name(folder: &Path, suffix: &str) -> PathBuf {
    let name = folder
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    (1u32..)
        .map(|n| folder.with_file_name(format!("{name}-{suffix}-{n}")))
        .find(|path| !path.exists())
        .expect("fewer than 2^32 files")
}

fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::read_dir(folder)
        .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect())
        .at("list", folder)
}

fn file_name(path: &Path) -> String {
    path.file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::txn::Change;

    fn filled(folder: &Path, count: usize) -> State {
        let opened = Index::open(folder).unwrap().unwrap();
        let changes: Vec<Change> = (0..count)
            .map(|i| Change::Put {
                key: format!("k{i:05}").into_bytes(),
                value: Vec::new(),
            })
            .collect();
        opened.index.apply(&changes, 7).unwrap();
        opened.index.content().unwrap()
    }

    #[test]
    fn a_planted_unfinished_snapshot_is_removed() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("index");
        let state = filled(&folder, 100);
        std::fs::write(folder.join("snap.FFFFF.generating"), [7; 100]).unwrap();
        let opened = Index::open(&folder).unwrap().unwrap();
        assert_eq!((opened.content, opened.applied_seq), (state, 7));
        assert!(!folder.join("snap.FFFFF.generating").exists());
    }

    #[test]
    fn a_damaged_snapshot_is_survived() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("index");
        let state = filled(&folder, 2_000);
        let snapshots: Vec<_> = files(&folder)
            .unwrap()
            .into_iter()
            .filter(|path| file_name(path).starts_with("snap."))
            .collect();
        // The fault is planted in any case: a snapshot that sled wrote, or one that it did not.
        match snapshots.first() {
            Some(path) => File::options()
                .write(true)
                .open(path)
                .unwrap()
                .set_len(40)
                .unwrap(),
            None => std::fs::write(folder.join("snap.0000000000000FFF"), [7; 100]).unwrap(),
        }
        let opened = Index::open(&folder).unwrap().unwrap();
        assert_eq!(opened.content, state);
    }

    #[test]
    fn a_destroyed_index_is_moved_aside() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("index");
        filled(&folder, 100);
        for path in files(&folder).unwrap() {
            if path.is_file() {
                std::fs::write(&path, [0xa5; 5_000]).unwrap();
            }
        }
        assert!(Index::open(&folder).unwrap().is_none());
        assert!(root.path().join("index-damaged-1").exists());
        assert!(Index::create(&folder).unwrap().content.is_empty());
    }

    #[test]
    fn a_lock_that_lives_on_is_waited_for_and_never_taken_for_damage() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("index");
        let state = filled(&folder, 100);
        let holder = File::open(folder.join("db")).unwrap();
        holder.lock().unwrap();
        let refused = Index::open_within(&folder, Duration::ZERO);
        assert!(matches!(refused, Err(Error::InUse { path }) if path == folder));
        assert!(!root.path().join("index-damaged-1").exists());
        let ending = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(50));
            drop(holder);
        });
        let opened = Index::open_within(&folder, Duration::from_secs(60)).unwrap();
        assert_eq!(opened.unwrap().content, state);
        ending.join().unwrap();
    }

    #[test]
    fn scans_stay_inside_their_prefix() {
        let root = tempfile::tempdir().unwrap();
        let opened = Index::create(&root.path().join("index")).unwrap();
        let keys = ["a1", "b1", "b2", "b3", "c1"];
        let changes: Vec<Change> = keys
            .iter()
            .map(|key| Change::Put {
                key: key.as_bytes().to_vec(),
                value: Vec::new(),
            })
            .collect();
        opened.index.apply(&changes, 1).unwrap();
        let scan = |after: &[u8], limit| -> Vec<String> {
            let pairs = opened.index.scan(b"b", after, limit).unwrap();
            pairs
                .into_iter()
                .map(|(key, _)| String::from_utf8(key).unwrap())
                .collect()
        };
        assert_eq!(scan(b"", 9), ["b1", "b2", "b3"]);
        assert_eq!(scan(b"b1", 1), ["b2"]);
        assert!(scan(b"b3", 9).is_empty());
    }
}
