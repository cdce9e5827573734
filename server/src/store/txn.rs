//! A metadata transaction: what must hold, what is written and what is removed, all or nothing.

use super::error::Result;
use super::record::{Record, Stored, encode, key};

/// Something that must hold when the transaction is applied.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Precondition {
    Absent { key: Vec<u8> },
    Present { key: Vec<u8> },
    Unchanged { key: Vec<u8>, raw: Vec<u8> },
}

/// One change of one key.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Change {
    Put { key: Vec<u8>, value: Vec<u8> },
    Delete { key: Vec<u8> },
}

/// Built by the typed methods, applied by [`super::metadata::Metadata::commit`].
#[derive(Clone, Debug, Default)]
pub struct Txn {
    pub(super) preconditions: Vec<Precondition>,
    pub(super) changes: Vec<Change>,
}

impl Txn {
    pub fn new() -> Self {
        Self::default()
    }

    /// Writes a record that must not exist yet.
    pub fn create<T: Record>(mut self, record: &T) -> Result<Self> {
        let key = key::<T>(&record.id());
        self.preconditions
            .push(Precondition::Absent { key: key.clone() });
        self.put(key, encode(record)?);
        Ok(self)
    }

    /// Replaces a record that must still be as it was read.
    pub fn replace<T: Record>(mut self, old: &Stored<T>, new: &T) -> Result<Self> {
        debug_assert_eq!(old.record.id(), new.id(), "a record keeps its key");
        self = self.require(old);
        self.put(key::<T>(&new.id()), encode(new)?);
        Ok(self)
    }

    /// Removes a record that must still be as it was read.
    pub fn remove<T: Record>(self, old: &Stored<T>) -> Self {
        let mut txn = self.require(old);
        txn.changes.push(Change::Delete {
            key: key::<T>(&old.record.id()),
        });
        txn
    }

    /// Requires a record to be still as it was read.
    pub fn require<T: Record>(mut self, old: &Stored<T>) -> Self {
        self.preconditions.push(Precondition::Unchanged {
            key: key::<T>(&old.record.id()),
            raw: old.raw.clone(),
        });
        self
    }

    /// Requires a record of this id to exist.
    pub fn require_present<T: Record>(mut self, id: &str) -> Self {
        self.preconditions
            .push(Precondition::Present { key: key::<T>(id) });
        self
    }

    /// Adds an index entry; it may exist already.
    pub fn mark(mut self, key: Vec<u8>) -> Self {
        self.put(key, Vec::new());
        self
    }

    /// Removes an index entry; it may be absent.
    pub fn unmark(mut self, key: Vec<u8>) -> Self {
        self.changes.push(Change::Delete { key });
        self
    }

    fn put(&mut self, key: Vec<u8>, value: Vec<u8>) {
        self.changes.push(Change::Put { key, value });
    }
}

/// The changes as the journal stores them: count, then `[1][key][value]` or `[0][key]` with u32 LE lengths.
pub(super) fn encode_changes(changes: &[Change]) -> Vec<u8> {
    let mut out = Vec::new();
    out.extend_from_slice(&(changes.len() as u32).to_le_bytes());
    let bytes = |out: &mut Vec<u8>, field: &[u8]| {
        out.extend_from_slice(&(field.len() as u32).to_le_bytes());
        out.extend_from_slice(field);
    };
    for change in changes {
        match change {
            Change::Put { key, value } => {
                out.push(1);
                bytes(&mut out, key);
                bytes(&mut out, value);
            }
            Change::Delete { key } => {
                out.push(0);
                bytes(&mut out, key);
            }
        }
    }
    out
}

/// The inverse of [`encode_changes`]; `None` if the bytes are not a whole list of changes.
pub(super) fn decode_changes(mut bytes: &[u8]) -> Option<Vec<Change>> {
    let count = u32::from_le_bytes(take(&mut bytes, 4)?.try_into().ok()?);
    let mut changes = Vec::new();
    for _ in 0..count {
        changes.push(match take(&mut bytes, 1)? {
            [1] => Change::Put {
                key: take_field(&mut bytes)?,
                value: take_field(&mut bytes)?,
            },
            [0] => Change::Delete {
                key: take_field(&mut bytes)?,
            },
            _ => return None,
        });
    }
    bytes.is_empty().then_some(changes)
}

fn take_field(bytes: &mut &[u8]) -> Option<Vec<u8>> {
    let length = u32::from_le_bytes(take(bytes, 4)?.try_into().ok()?);
    take(bytes, length as usize).map(<[u8]>::to_vec)
}

fn take<'a>(bytes: &mut &'a [u8], count: usize) -> Option<&'a [u8]> {
    let (head, tail) = bytes.split_at_checked(count)?;
    *bytes = tail;
    Some(head)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn changes() -> impl Strategy<Value = Vec<Change>> {
        let bytes = || proptest::collection::vec(any::<u8>(), 0..20);
        let change = prop_oneof![
            (bytes(), bytes()).prop_map(|(key, value)| Change::Put { key, value }),
            bytes().prop_map(|key| Change::Delete { key }),
        ];
        proptest::collection::vec(change, 0..8)
    }

    proptest! {
        #[test]
        fn changes_round_trip_and_cuts_are_refused(changes in changes()) {
            let bytes = encode_changes(&changes);
            for length in 0..bytes.len() {
                prop_assert!(decode_changes(&bytes[..length]).is_none());
            }
            prop_assert_eq!(decode_changes(&bytes), Some(changes));
        }

        #[test]
        fn hostile_bytes_do_not_panic(bytes in proptest::collection::vec(any::<u8>(), 0..64)) {
            let _ = decode_changes(&bytes);
        }
    }
}
