//! The port through which all metadata is read and written, and the typed view of it.

use super::error::{Error, Result};
use super::record::{Record, Stored, decode, key};
use super::txn::Txn;

/// Key-value metadata with transactions. Calls block for as long as the disk takes.
pub trait Metadata: Send + Sync + std::fmt::Debug {
    /// Applies all of `txn` or nothing; success means it is on stable storage.
    fn commit(&self, txn: Txn) -> Result<()>;

    fn get(&self, key: &[u8]) -> Result<Option<Vec<u8>>>;

    /// Up to `limit` pairs whose key begins with `prefix` and is greater than `after`, in key order.
    fn scan(&self, prefix: &[u8], after: &[u8], limit: usize) -> Result<Vec<(Vec<u8>, Vec<u8>)>>;

    /// Why writes are refused, if they are.
    fn poisoned(&self) -> Option<String>;
}

impl dyn Metadata + '_ {
    /// The record of this id, if there is one.
    pub fn find<T: Record>(&self, id: &str) -> Result<Option<Stored<T>>> {
        self.get(&key::<T>(id))?
            .map(|raw| decode(id, raw))
            .transpose()
    }

    /// The record of this id; its absence is an error.
    pub fn load<T: Record>(&self, id: &str) -> Result<Stored<T>> {
        self.find(id)?.ok_or_else(|| Error::NotFound {
            what: format!("{} \"{id}\"", T::NOUN),
        })
    }

    /// Up to `limit` records with ids greater than `after` (all for ""), in id order.
    pub fn page<T: Record>(&self, after: &str, limit: usize) -> Result<Vec<Stored<T>>> {
        self.scan(&[T::TABLE], &key::<T>(after), limit)?
            .into_iter()
            .map(|(key, raw)| decode(&String::from_utf8_lossy(&key[1..]), raw))
            .collect()
    }

    /// Up to `limit` records with ids greater than `after` for which `keep` holds, in id order.
    pub fn page_where<T: Record>(
        &self,
        after: &str,
        limit: usize,
        keep: impl Fn(&T) -> bool,
    ) -> Result<Vec<T>> {
        /// Records read at once while looking for those to keep.
        const BATCH: usize = 256;
        let mut out = Vec::new();
        let mut after = after.to_owned();
        loop {
            let batch = self.page::<T>(&after, BATCH)?;
            let is_last = batch.len() < BATCH;
            for stored in batch {
                after = stored.record.id();
                if keep(&stored.record) {
                    out.push(stored.record);
                    if out.len() == limit {
                        return Ok(out);
                    }
                }
            }
            if is_last {
                return Ok(out);
            }
        }
    }
}
