//! The assets that a snapshot offers to a recipe.

use std::sync::Arc;

use backlot_engine::Asset;
use backlot_engine::scene::Candidate;

use super::cache::AssetCache;
use super::error::{Error, Result};
use crate::domain::blob::Digest;
use crate::domain::ids::AssetId;
use crate::store::Library;

/// An object asset of the snapshot.
#[derive(Clone, Debug)]
pub(super) struct LibraryObject {
    pub payload: Digest,
    pub synthetic: bool,
}

/// The objects of a library, in the order of their names.
#[derive(Debug)]
pub(super) struct Objects {
    pub candidates: Vec<Candidate>,
    /// Same order and length as `candidates`.
    pub objects: Vec<LibraryObject>,
}

/// The snapshot of `digest`, or the present library.
pub(super) fn resolve(cache: &AssetCache, digest: Option<&Digest>) -> Result<Library> {
    Ok(match digest {
        Some(digest) => cache.store().library(digest)?,
        None => cache.store().present_library()?,
    })
}

/// Decodes the named asset of the library.
pub(super) fn load(cache: &AssetCache, library: &Library, id: &AssetId) -> Result<Arc<Asset>> {
    let entry = library.entries.iter().find(|e| e.asset == *id);
    let entry = entry.ok_or_else(|| not_found(library, id))?;
    cache.asset(&entry.payload)
}

/// The headers of every object of the library. `named` must all be among them.
pub(super) fn objects(cache: &AssetCache, library: &Library, named: &[AssetId]) -> Result<Objects> {
    let mut objects = Objects {
        candidates: Vec::new(),
        objects: Vec::new(),
    };
    for entry in &library.entries {
        let record = cache.store().asset_or_deleted(&entry.asset)?;
        if record.content.object.is_none() {
            continue;
        }
        let header = cache.header(&entry.payload)?;
        let name = entry.asset.to_string();
        objects
            .candidates
            .push(Candidate::from_header(&name, &header));
        objects.objects.push(LibraryObject {
            payload: entry.payload,
            synthetic: header.synthetic,
        });
    }
    for id in named {
        let name = id.to_string();
        if library.entries.iter().all(|e| e.asset != *id) {
            return Err(not_found(library, id));
        }
        if objects.candidates.iter().all(|c| c.name != name) {
            return Err(Error::Invalid {
                what: format!("{name} is not an object"),
            });
        }
    }
    Ok(objects)
}

fn not_found(library: &Library, id: &AssetId) -> Error {
    Error::NotFound {
        what: format!("{id} is not in library snapshot {}", library.digest),
    }
}
