//! The library of assets and its frozen snapshots.

use super::error::{Error, Result};
use super::record::Record;
use super::{Store, Txn};
use crate::domain::asset::Asset;
use crate::domain::blob::Digest;
use crate::domain::clock::UnixMs;
use crate::domain::ids::AssetId;
use crate::domain::snapshot::{LibrarySnapshot, SnapshotEntry, snapshot_digest};

impl Record for Asset {
    const TABLE: u8 = b'a';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "asset";

    fn id(&self) -> String {
        self.id.as_str().to_owned()
    }
}

impl Record for LibrarySnapshot {
    const TABLE: u8 = b's';
    const VERSION: u8 = 1;
    const NOUN: &'static str = "library snapshot";

    fn id(&self) -> String {
        self.digest.to_string()
    }
}

/// The assets of a snapshot, sorted by name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Library {
    pub digest: Digest,
    pub entries: Vec<SnapshotEntry>,
}

impl Store {
    /// An asset of the present library.
    pub fn asset(&self, id: &AssetId) -> Result<Asset> {
        let asset = self.asset_or_deleted(id)?;
        if asset.deleted_at.is_some() {
            return Err(Error::NotFound {
                what: format!("{} \"{}\"", Asset::NOUN, id.as_str()),
            });
        }
        Ok(asset)
    }

    /// An asset that a snapshot names: deletion does not hide it.
    pub fn asset_or_deleted(&self, id: &AssetId) -> Result<Asset> {
        Ok(self.metadata().load(id.as_str())?.record)
    }

    /// Up to `limit` present assets with ids greater than `after` for which `keep` holds.
    pub fn assets(
        &self,
        after: &str,
        limit: usize,
        keep: impl Fn(&Asset) -> bool,
    ) -> Result<Vec<Asset>> {
        self.metadata().page_where(after, limit, |asset: &Asset| {
            asset.deleted_at.is_none() && keep(asset)
        })
    }

    /// Removes the asset from the library; snapshots that name it still find it.
    pub fn delete_asset(&self, id: &AssetId, now: UnixMs) -> Result<()> {
        let present = self.metadata().load::<Asset>(id.as_str())?;
        if present.record.deleted_at.is_some() {
            return self.asset(id).map(|_| ());
        }
        let mut deleted = present.record.clone();
        deleted.deleted_at = Some(now);
        self.metadata()
            .commit(Txn::new().replace(&present, &deleted)?)
    }

    /// Freezes the present library. The same library gives the same snapshot.
    pub fn create_snapshot(&self, now: UnixMs) -> Result<LibrarySnapshot> {
        let library = self.present_library()?;
        if let Some(present) = self.metadata().find(&library.digest.to_string())? {
            return Ok(present.record);
        }
        let entries = serde_json::to_vec(&library.entries).map_err(|e| Error::Invalid {
            what: e.to_string(),
        })?;
        let snapshot = LibrarySnapshot {
            digest: library.digest,
            entries: self.blobs().put(&entries)?,
            asset_count: library.entries.len() as u32,
            created_at: now,
        };
        match self.metadata().commit(Txn::new().create(&snapshot)?) {
            // Another call froze the same library.
            Err(Error::Conflict { .. }) => self.snapshot(&snapshot.digest),
            committed => committed.map(|()| snapshot),
        }
    }

    pub fn snapshot(&self, digest: &Digest) -> Result<LibrarySnapshot> {
        Ok(self.metadata().load(&digest.to_string())?.record)
    }

    pub fn snapshots(&self, after: &str, limit: usize) -> Result<Vec<LibrarySnapshot>> {
        self.metadata().page_where(after, limit, |_| true)
    }

    /// The assets that a snapshot names.
    pub fn library(&self, digest: &Digest) -> Result<Library> {
        let snapshot = self.snapshot(digest)?;
        let content = self.blobs().read(&snapshot.entries.digest)?;
        let entries: Vec<SnapshotEntry> = serde_json::from_slice(&content)
            .map_err(|e| Error::corrupt(format!("entries of library snapshot {digest} ({e})")))?;
        Ok(Library {
            digest: *digest,
            entries,
        })
    }

    /// The library as it is now, not kept.
    pub fn present_library(&self) -> Result<Library> {
        let entries: Vec<SnapshotEntry> = self
            .assets("", usize::MAX, |_| true)?
            .into_iter()
            .map(|asset| SnapshotEntry {
                payload: asset.content.payload.digest,
                asset: asset.id,
            })
            .collect();
        Ok(Library {
            digest: snapshot_digest(&entries),
            entries,
        })
    }
}
