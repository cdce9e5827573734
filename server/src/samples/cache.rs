//! Decoded assets, kept while they fit, by the bytes they hold, and the device that renders them.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};

use backlot_engine::Asset;
use backlot_engine::asset::AssetHeader;
use backlot_engine::backend::Backend;

use super::error::Result;
use crate::domain::blob::Digest;
use crate::store::Store;

/// Decoded fields kept for the next sample. One background of a 60 m street takes about 200 MiB.
const MAX_BYTES: u64 = 768 << 20;
/// Headers are kept apart: composition needs those of a whole library, and an object's is a few kilobytes.
const MAX_HEADERS: usize = 16_384;

/// Decoded assets by payload digest, shared by all calls. What is in use stays in memory whether it is kept here or not.
#[derive(Debug)]
pub struct AssetCache {
    store: Store,
    backend: Arc<dyn Backend>,
    max_bytes: u64,
    kept: Mutex<Kept>,
}

#[derive(Debug, Default)]
struct Kept {
    assets: HashMap<Digest, Entry>,
    headers: HashMap<Digest, Arc<AssetHeader>>,
    bytes: u64,
    /// Grows with every use.
    clock: u64,
}

#[derive(Debug)]
struct Entry {
    asset: Arc<Asset>,
    bytes: u64,
    used: u64,
}

impl AssetCache {
    pub fn new(store: Store, backend: Arc<dyn Backend>) -> Self {
        Self {
            store,
            backend,
            max_bytes: MAX_BYTES,
            kept: Mutex::default(),
        }
    }

    /// The device that renders.
    pub fn backend(&self) -> &dyn Backend {
        &*self.backend
    }

    pub fn store(&self) -> &Store {
        &self.store
    }

    /// The decoded payload. Two calls at once may both decode it; one copy is kept.
    pub(super) fn asset(&self, payload: &Digest) -> Result<Arc<Asset>> {
        if let Some(asset) = self.lock().touch(payload) {
            return Ok(asset);
        }
        let asset = Arc::new(Asset::decode(&self.store.blobs().read(payload)?)?);
        self.lock().keep(*payload, &asset, self.max_bytes);
        Ok(asset)
    }

    /// The payload's header alone.
    pub(super) fn header(&self, payload: &Digest) -> Result<Arc<AssetHeader>> {
        if let Some(header) = self.lock().headers.get(payload) {
            return Ok(header.clone());
        }
        let header = Arc::new(Asset::decode_header(&self.store.blobs().read(payload)?)?);
        let mut kept = self.lock();
        if kept.headers.len() >= MAX_HEADERS {
            kept.headers.clear();
        }
        kept.headers.insert(*payload, header.clone());
        Ok(header)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Kept> {
        self.kept.lock().expect("no panic while held")
    }
}

impl Kept {
    fn touch(&mut self, payload: &Digest) -> Option<Arc<Asset>> {
        self.clock += 1;
        let entry = self.assets.get_mut(payload)?;
        entry.used = self.clock;
        Some(entry.asset.clone())
    }

    fn keep(&mut self, payload: Digest, asset: &Arc<Asset>, max_bytes: u64) {
        let bytes = asset.field.memory_bytes();
        if bytes > max_bytes || self.assets.contains_key(&payload) {
            return;
        }
        while self.bytes + bytes > max_bytes {
            let oldest = self.assets.iter().min_by_key(|(_, e)| e.used);
            let Some(digest) = oldest.map(|(digest, _)| *digest) else {
                break;
            };
            if let Some(entry) = self.assets.remove(&digest) {
                self.bytes -= entry.bytes;
            }
        }
        self.clock += 1;
        self.bytes += bytes;
        let entry = Entry {
            asset: asset.clone(),
            bytes,
            used: self.clock,
        };
        self.assets.insert(payload, entry);
    }
}
