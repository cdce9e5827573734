//! The append-only journal of committed metadata transactions. It is the authority: sled is an index made from it.
//!
//! Entry: `[magic u32][length u32][crc32c u32][sequence u64][payload]`, little-endian; the checksum covers sequence and
//! payload. Entries are written and fsynced in groups before anyone is told of success, so after a crash at most the last
//! group is torn, and nobody was told of that one.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::error::{IoContext, Result};
use super::txn::{Change, decode_changes, encode_changes};

/// "BLJ1": makes whole entries findable behind a damaged one.
const MAGIC: [u8; 4] = *b"BLJ1";
const HEADER_BYTES: usize = 20;

/// What all keys hold after the journal was read to its end.
pub(super) type State = BTreeMap<Vec<u8>, Vec<u8>>;

/// How the reading of a journal ended.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Tail {
    Clean,
    /// An unfinished write at the end.
    Torn,
    /// A damaged entry with whole entries behind it: not the work of a crash.
    Damaged,
}

/// A journal as read.
#[derive(Debug)]
pub(super) struct Replay {
    pub(super) state: State,
    /// Sequence of the last whole entry before the damage, 0 if none.
    pub(super) last_seq: u64,
    /// Length of the undamaged beginning.
    pub(super) good_bytes: u64,
    pub(super) tail: Tail,
    /// Whole entries behind the damage, in order.
    pub(super) behind_damage: Vec<(u64, Vec<Change>)>,
}

/// The open journal, positioned at its end.
#[derive(Debug)]
pub(super) struct Journal {
    path: PathBuf,
    file: File,
    length: u64,
    last_seq: u64,
}

impl Journal {
    /// Reads the whole journal; a missing file is an empty one.
    pub(super) fn replay(path: &Path) -> Result<Replay> {
        match std::fs::read(path) {
            Ok(bytes) => Ok(replay(&bytes)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(replay(&[])),
            Err(e) => Err(e).at("read", path),
        }
    }

    /// Opens the journal for appending after `replay`, cutting a torn tail off.
    pub(super) fn open(path: &Path, replay: &Replay) -> Result<Self> {
        let mut file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(path)
            .at("open", path)?;
        file.set_len(replay.good_bytes).at("truncate", path)?;
        file.seek(SeekFrom::End(0)).at("seek", path)?;
        file.sync_all().at("sync", path)?;
        sync_parent(path)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            length: replay.good_bytes,
            last_seq: replay.last_seq,
        })
    }

    /// Replaces the journal by one entry that holds `state`, at the same sequence. A crash leaves the old or the new one.
    pub(super) fn checkpoint(path: &Path, state: &State, last_seq: u64) -> Result<Self> {
        let changes: Vec<Change> = state
            .iter()
            .map(|(key, value)| Change::Put {
                key: key.clone(),
                value: value.clone(),
            })
            .collect();
        let entry = encode_entry(last_seq, &encode_changes(&changes));
        let fresh = path.with_extension("new");
        let mut file = File::create(&fresh).at("create", &fresh)?;
        file.write_all(&entry).at("write", &fresh)?;
        file.sync_all().at("sync", &fresh)?;
        std::fs::rename(&fresh, path).at("rename", &fresh)?;
        sync_parent(path)?;
        Ok(Self {
            path: path.to_owned(),
            file,
            length: entry.len() as u64,
            last_seq,
        })
    }

    /// Appends a group of transactions and waits until it is on stable storage. On failure nothing was appended; if even
    /// that cannot be made sure, the second value of the error is true and the journal must not be used again.
    pub(super) fn append(&mut self, group: &[&[Change]]) -> Result<u64, (super::Error, bool)> {
        let mut bytes = Vec::new();
        let mut seq = self.last_seq;
        for changes in group {
            seq += 1;
            bytes.extend_from_slice(&encode_entry(seq, &encode_changes(changes)));
        }
        let written = self
            .file
            .write_all(&bytes)
            .and_then(|()| self.file.sync_data())
            .at("append to", &self.path);
        match written {
            Ok(()) => {
                self.length += bytes.len() as u64;
                self.last_seq = seq;
                Ok(seq)
            }
            Err(error) => {
                let undone = self
                    .file
                    .set_len(self.length)
                    .and_then(|()| self.file.seek(SeekFrom::End(0)))
                    .and_then(|_| self.file.sync_all());
                // After a failed fsync the kernel may have dropped pages: only a disk that is merely full is trusted again.
                let full = matches!(&error, super::Error::Io { source, .. } if super::error::is_disk_full(source));
                Err((error, undone.is_err() || !full))
            }
        }
    }

    pub(super) fn length(&self) -> u64 {
        self.length
    }

    pub(super) fn last_seq(&self) -> u64 {
        self.last_seq
    }
}

fn encode_entry(seq: u64, payload: &[u8]) -> Vec<u8> {
    let mut entry = Vec::with_capacity(HEADER_BYTES + payload.len());
    entry.extend_from_slice(&MAGIC);
    entry.extend_from_slice(&(payload.len() as u32).to_le_bytes());
    let crc = crc32c::crc32c_append(crc32c::crc32c(&seq.to_le_bytes()), payload);
    entry.extend_from_slice(&crc.to_le_bytes());
    entry.extend_from_slice(&seq.to_le_bytes());
    entry.extend_from_slice(payload);
    entry
}

/// The whole entry that begins at `bytes[0]`: sequence, payload.
fn decode_entry(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let header = bytes.get(..HEADER_BYTES)?;
    if header[..4] != MAGIC {
        return None;
    }
    let length = u32::from_le_bytes(header[4..8].try_into().ok()?) as usize;
    let crc = u32::from_le_bytes(header[8..12].try_into().ok()?);
    let payload = bytes.get(HEADER_BYTES..HEADER_BYTES.checked_add(length)?)?;
    let found = crc32c::crc32c_append(crc32c::crc32c(&header[12..20]), payload);
    let seq = u64::from_le_bytes(header[12..20].try_into().ok()?);
    (found == crc).then_some((seq, payload))
}

fn replay(bytes: &[u8]) -> Replay {
    let mut out = Replay {
        state: State::new(),
        last_seq: 0,
        good_bytes: 0,
        tail: Tail::Clean,
        behind_damage: Vec::new(),
    };
    let mut offset = 0;
    while offset < bytes.len() {
        let entry = decode_entry(&bytes[offset..])
            .and_then(|(seq, payload)| Some((seq, payload.len(), decode_changes(payload)?)));
        // The first entry may be a checkpoint of any sequence; the others follow each other.
        let expected = |seq: u64| out.last_seq == 0 && offset == 0 || seq == out.last_seq + 1;
        let Some((seq, length, changes)) = entry.filter(|(seq, ..)| expected(*seq)) else {
            out.behind_damage = whole_entries(&bytes[offset + 1..]);
            out.tail = match out.behind_damage.is_empty() {
                true => Tail::Torn,
                false => Tail::Damaged,
            };
            break;
        };
        apply(&mut out.state, changes);
        offset += HEADER_BYTES + length;
        out.last_seq = seq;
        out.good_bytes = offset as u64;
    }
    out
}

/// Entries found by their magic and checksum.
fn whole_entries(bytes: &[u8]) -> Vec<(u64, Vec<Change>)> {
    let mut found = Vec::new();
    let mut offset = 0;
    while offset < bytes.len() {
        let entry = decode_entry(&bytes[offset..])
            .and_then(|(seq, payload)| Some((seq, payload.len(), decode_changes(payload)?)));
        offset += match entry {
            Some((seq, length, changes)) => {
                found.push((seq, changes));
                HEADER_BYTES + length
            }
            None => 1,
        };
    }
    found
}

/// Makes the changes in order.
pub(super) fn apply(state: &mut State, changes: impl IntoIterator<Item = Change>) {
    for change in changes {
        match change {
            Change::Put { key, value } => state.insert(key, value),
            Change::Delete { key } => state.remove(&key),
        };
    }
}

/// Makes the name of a file as durable as its content.
pub(super) fn sync_parent(path: &Path) -> Result<()> {
    let parent = path.parent().expect("files of the store have a folder");
    File::open(parent)
        .and_then(|folder| folder.sync_all())
        .at("sync", parent)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn put(key: &str, value: &str) -> Change {
        Change::Put {
            key: key.into(),
            value: value.into(),
        }
    }

    fn write(path: &Path, transactions: usize) -> Journal {
        let mut journal = Journal::open(path, &Journal::replay(path).unwrap()).unwrap();
        for i in 0..transactions {
            let changes = [put("count", &i.to_string()), put(&format!("k{i}"), "v")];
            journal.append(&[&changes]).unwrap();
        }
        journal
    }

    #[test]
    fn a_journal_replays_and_continues() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        write(&path, 3);
        let journal = write(&path, 2);
        assert_eq!(journal.last_seq(), 5);
        let replay = Journal::replay(&path).unwrap();
        assert_eq!((replay.last_seq, replay.tail), (5, Tail::Clean));
        assert_eq!(replay.good_bytes, journal.length());
        assert_eq!(replay.state[&b"count".to_vec()], b"1");
    }

    #[test]
    fn a_cut_anywhere_keeps_every_whole_transaction() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        write(&path, 4);
        let bytes = std::fs::read(&path).unwrap();
        let mut seen = Vec::new();
        for length in 0..bytes.len() {
            let replay = replay(&bytes[..length]);
            assert_ne!(replay.tail, Tail::Damaged, "cut at {length}");
            assert_eq!(
                replay.tail == Tail::Clean,
                replay.good_bytes == length as u64
            );
            seen.push(replay.last_seq);
        }
        seen.dedup();
        assert_eq!(seen, [0, 1, 2, 3]);
    }

    #[test]
    fn damage_in_the_middle_is_told_from_a_torn_end() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        write(&path, 4);
        let bytes = std::fs::read(&path).unwrap();
        let last_entry = bytes.len() / 4 * 3;
        for bit in 0..bytes.len() * 8 {
            let mut bad = bytes.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            let replay = replay(&bad);
            assert_ne!(replay.tail, Tail::Clean, "bit {bit}");
            assert_eq!(
                replay.tail == Tail::Damaged,
                bit / 8 < last_entry,
                "bit {bit}"
            );
        }
    }

    #[test]
    fn a_checkpoint_keeps_state_and_sequence() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let journal = write(&path, 50);
        let before = Journal::replay(&path).unwrap();
        let mut small = Journal::checkpoint(&path, &before.state, journal.last_seq()).unwrap();
        small.append(&[&[put("after", "1")]]).unwrap();
        let after = Journal::replay(&path).unwrap();
        assert_eq!((after.last_seq, &after.tail), (51, &Tail::Clean));
        assert_eq!(after.state.len(), before.state.len() + 1);
        assert!(small.length() < journal.length());
    }
}
