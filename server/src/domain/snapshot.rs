//! A frozen list of assets, named by a digest over its content, so that a growing library never changes a recipe's samples.

use serde::{Deserialize, Serialize};

use super::blob::{BlobRef, Digest};
use super::clock::UnixMs;
use super::ids::AssetId;

/// One asset of a snapshot.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SnapshotEntry {
    pub asset: AssetId,
    pub payload: Digest,
}

/// The record of a snapshot; its entries are a blob, since a library may hold many thousand assets.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LibrarySnapshot {
    /// Digest over the sorted asset names and payload digests; `librarySnapshots/{digest}` names the snapshot.
    pub digest: Digest,
    /// JSON array of [`SnapshotEntry`], sorted by asset.
    pub entries: BlobRef,
    pub asset_count: u32,
    pub created_at: UnixMs,
}

/// The digest that names a snapshot of `entries`, which must be sorted by asset and free of repeats.
pub fn snapshot_digest(entries: &[SnapshotEntry]) -> Digest {
    debug_assert!(entries.windows(2).all(|pair| pair[0].asset < pair[1].asset));
    let mut hasher = blake3::Hasher::new();
    for entry in entries {
        // A name holds neither a space nor a line feed, so the text has one reading.
        hasher.update(format!("{} {}\n", entry.asset, entry.payload).as_bytes());
    }
    hasher.finalize().into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_digest_depends_on_names_and_payloads() {
        let entry = |id: &str, content: &[u8]| SnapshotEntry {
            asset: AssetId::new(id).unwrap(),
            payload: Digest::of(content),
        };
        let base = snapshot_digest(&[entry("a", b"1"), entry("b", b"2")]);
        assert_eq!(base, snapshot_digest(&[entry("a", b"1"), entry("b", b"2")]));
        assert_ne!(base, snapshot_digest(&[entry("a", b"1"), entry("b", b"3")]));
        assert_ne!(base, snapshot_digest(&[entry("a", b"1"), entry("c", b"2")]));
        assert_ne!(base, snapshot_digest(&[entry("a", b"1")]));
    }
}
