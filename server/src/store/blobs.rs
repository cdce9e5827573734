//! Content-addressed, immutable blobs: `blobs/ab/<digest>`, published by rename from `partial/<digest>`.
//!
//! Finished blobs are read and published through `object_store`, whose local form fsyncs both folders of a rename, so
//! that an S3 bucket can take its place. Unfinished ones are plain files: an object store cannot append at an offset,
//! which is what makes an upload resumable. Calls block and belong on a blocking thread.

use std::collections::HashSet;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, SystemTime};

use bytes::Bytes;
use futures::executor::block_on;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt};

use super::error::{Error, IoContext, Result};
use super::space::Space;
use super::upload::Upload;
use crate::domain::blob::{BlobRef, Digest};

/// Longest blob: four times a LiDAR-rich background asset.
pub const MAX_BLOB_BYTES: u64 = 4 << 30;

/// Longest blob that is read into memory as a whole.
pub(super) const MAX_WHOLE_READ_BYTES: u64 = 1 << 30;

/// Bytes hashed at once.
const BLOCK_BYTES: usize = 1 << 20;

/// An abandoned upload is kept this long for its client to come back.
const PARTIAL_KEPT: Duration = Duration::from_secs(7 * 24 * 3600);

/// Blobs of one data directory.
#[derive(Clone, Debug)]
pub struct BlobStore {
    objects: Arc<dyn ObjectStore>,
    root: PathBuf,
    space: Space,
    writing: Arc<Mutex<HashSet<Digest>>>,
    next_temporary: Arc<AtomicU64>,
}

/// The answer to a wish to write a blob.
#[derive(Debug)]
pub enum Begun {
    /// It is there already.
    Present,
    Writing(Upload),
}

impl BlobStore {
    /// Opens the blobs under `root` and removes what dead processes left.
    pub fn open(root: &Path, space: Space) -> Result<Self> {
        let root = root.canonicalize().at("open", root)?;
        let objects = LocalFileSystem::new_with_prefix(&root)
            .map_err(object_error)?
            .with_fsync(true);
        let store = Self {
            objects: Arc::new(objects),
            root,
            space,
            writing: Arc::default(),
            next_temporary: Arc::default(),
        };
        store.sweep()?;
        Ok(store)
    }

    /// The size in bytes of a finished blob; `None` if it is not held.
    pub fn size_bytes(&self, digest: &Digest) -> Result<Option<u64>> {
        match block_on(self.objects.head(&object_path(digest))) {
            Ok(meta) => Ok(Some(meta.size)),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(e) => Err(object_error(e)),
        }
    }

    /// Bytes held of a blob, and whether it is finished.
    pub fn committed(&self, digest: &Digest) -> Result<(u64, bool)> {
        if let Some(size) = self.size_bytes(digest)? {
            return Ok((size, true));
        }
        let partial = self.partial(digest);
        match std::fs::metadata(&partial) {
            Ok(found) => Ok((found.len(), false)),
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok((0, false)),
            Err(e) => Err(e).at("look at", partial),
        }
    }

    /// Begins or resumes the writing of a blob. Only one call writes a blob at a time.
    pub fn begin(&self, blob: BlobRef) -> Result<Begun> {
        if blob.size_bytes > MAX_BLOB_BYTES {
            return Err(Error::TooLarge {
                what: format!("blob {}", blob.digest),
                size_bytes: blob.size_bytes,
                limit_bytes: MAX_BLOB_BYTES,
            });
        }
        if let Some(size_bytes) = self.size_bytes(&blob.digest)? {
            if size_bytes != blob.size_bytes {
                return Err(Error::Invalid {
                    what: format!(
                        "blob {} has {size_bytes} bytes, not {}",
                        blob.digest, blob.size_bytes
                    ),
                });
            }
            return Ok(Begun::Present);
        }
        let partial = self.partial(&blob.digest);
        Upload::begin(self.clone(), blob, partial).map(Begun::Writing)
    }

    /// Writes a blob that is in memory.
    pub fn put(&self, content: &[u8]) -> Result<BlobRef> {
        let blob = BlobRef::of(content);
        if self.size_bytes(&blob.digest)?.is_some() {
            return Ok(blob);
        }
        self.space.require_for_blob(blob.size_bytes)?;
        // A name of its own: other writers of the same content are not in the way.
        let serial = self.next_temporary.fetch_add(1, Ordering::Relaxed);
        let name = format!("{}.{serial}", blob.digest);
        let path = self.root.join("partial").join(&name);
        let written = std::fs::write(&path, content)
            .and_then(|()| File::open(&path)?.sync_all())
            .at("write", &path)
            .and_then(|()| self.publish(&name, &blob.digest));
        if written.is_err() {
            let _ = std::fs::remove_file(&path);
        }
        written.map(|()| blob)
    }

    /// A blob's whole content, checked against its digest.
    pub fn read(&self, digest: &Digest) -> Result<Bytes> {
        let size_bytes = self.require_size(digest)?;
        if size_bytes > MAX_WHOLE_READ_BYTES {
            return Err(Error::TooLarge {
                what: format!("blob {digest}, read into memory"),
                size_bytes,
                limit_bytes: MAX_WHOLE_READ_BYTES,
            });
        }
        let content = self.read_range(digest, 0, size_bytes)?;
        if Digest::of(&content) != *digest {
            return Err(damaged(digest));
        }
        Ok(content)
    }

    /// Reads a whole finished blob block by block and checks it against its digest; returns its size in bytes.
    pub fn verify(&self, digest: &Digest) -> Result<u64> {
        let size_bytes = self.require_size(digest)?;
        let mut hasher = blake3::Hasher::new();
        let mut offset = 0;
        while offset < size_bytes {
            let count = (size_bytes - offset).min(BLOCK_BYTES as u64);
            hasher.update(&self.read_range(digest, offset, count)?);
            offset += count;
        }
        if Digest::from(hasher.finalize()) != *digest {
            return Err(damaged(digest));
        }
        Ok(size_bytes)
    }

    /// `count` bytes from `offset`, unchecked: verify the blob first.
    pub fn read_range(&self, digest: &Digest, offset: u64, count: u64) -> Result<Bytes> {
        if count == 0 {
            return Ok(Bytes::new());
        }
        let range = offset..offset.saturating_add(count);
        let bytes =
            block_on(self.objects.get_range(&object_path(digest), range)).map_err(|e| match e {
                object_store::Error::NotFound { .. } => missing(digest),
                e => object_error(e),
            })?;
        if bytes.len() as u64 != count {
            return Err(damaged(digest));
        }
        Ok(bytes)
    }

    pub(super) fn space(&self) -> &Space {
        &self.space
    }

    /// Reserves the right to write a blob; false if another call has it.
    pub(super) fn reserve(&self, digest: Digest) -> bool {
        self.writing
            .lock()
            .expect("no panic while held")
            .insert(digest)
    }

    pub(super) fn unreserve(&self, digest: &Digest) {
        self.writing
            .lock()
            .expect("no panic while held")
            .remove(digest);
    }

    /// Renames a fsynced file of `partial/` into place and fsyncs both folders.
    pub(super) fn publish(&self, partial_name: &str, digest: &Digest) -> Result<()> {
        let from = ObjectPath::from_iter(["partial", partial_name]);
        block_on(self.objects.rename(&from, &object_path(digest))).map_err(object_error)
    }

    fn partial(&self, digest: &Digest) -> PathBuf {
        self.root.join("partial").join(digest.to_string())
    }

    fn require_size(&self, digest: &Digest) -> Result<u64> {
        self.size_bytes(digest)?.ok_or_else(|| missing(digest))
    }

    /// Removes temporary files of dead processes and uploads abandoned long ago, and makes finished names durable: a
    /// killed process may have renamed without the fsync that follows.
    fn sweep(&self) -> Result<()> {
        let partial = self.root.join("partial");
        for entry in std::fs::read_dir(&partial).at("list", &partial)? {
            let entry = entry.at("list", &partial)?;
            let resumable = entry
                .file_name()
                .to_str()
                .is_some_and(|name| name.parse::<Digest>().is_ok());
            let age = entry
                .metadata()
                .and_then(|found| found.modified())
                .map(|modified| {
                    SystemTime::now()
                        .duration_since(modified)
                        .unwrap_or_default()
                });
            if !resumable || age.is_ok_and(|age| age > PARTIAL_KEPT) {
                std::fs::remove_file(entry.path()).at("remove", entry.path())?;
            }
        }
        let blobs = self.root.join("blobs");
        for entry in std::fs::read_dir(&blobs).at("list", &blobs)? {
            let folder = entry.at("list", &blobs)?.path();
            File::open(&folder)
                .and_then(|folder| folder.sync_all())
                .at("sync", &folder)?;
        }
        File::open(&blobs)
            .and_then(|folder| folder.sync_all())
            .at("sync", &blobs)
    }
}

/// The digest of a file, read block by block.
pub(super) fn digest_of_file(path: &Path) -> Result<Digest> {
    let mut file = File::open(path).at("open", path)?;
    let mut hasher = blake3::Hasher::new();
    let mut block = vec![0; BLOCK_BYTES];
    loop {
        match file.read(&mut block).at("read", path)? {
            0 => return Ok(hasher.finalize().into()),
            count => hasher.update(&block[..count]),
        };
    }
}

/// 256 folders keep each of them short.
fn object_path(digest: &Digest) -> ObjectPath {
    let text = digest.to_string();
    ObjectPath::from_iter(["blobs", &text[..2], &text])
}

fn missing(digest: &Digest) -> Error {
    Error::NotFound {
        what: format!("blob {digest}"),
    }
}

fn damaged(digest: &Digest) -> Error {
    tracing::error!(%digest, "a stored blob does not match its digest");
    Error::corrupt(format!("blob {digest}"))
}

fn object_error(error: object_store::Error) -> Error {
    let kind = io_kind(&error).unwrap_or(std::io::ErrorKind::Other);
    Error::Io {
        verb: "access",
        path: PathBuf::from("blobs"),
        source: std::io::Error::new(kind, error.to_string()),
    }
}

/// The kind of the IO error at the root of `error`, so that a full disk is told from a broken one.
fn io_kind(error: &(dyn std::error::Error + 'static)) -> Option<std::io::ErrorKind> {
    std::iter::successors(Some(error), |error| error.source())
        .find_map(|error| error.downcast_ref::<std::io::Error>())
        .map(std::io::Error::kind)
}
