//! `BlobService`: checksummed chunks in and out.

use std::collections::HashSet;
use std::sync::Arc;

use backlot_proto::v1;
use backlot_proto::v1::blob_service_server::BlobService;
use futures::stream::{self, BoxStream};
use futures::{StreamExt, TryStreamExt};
use tokio_util::sync::CancellationToken;
use tonic::{Request, Response, Status, Streaming};

use super::blocking::{blocking, blocking_status};
use super::limits::{MAX_CHUNK_BYTES, MAX_DIGESTS, UPLOAD_IDLE};
use super::status::{invalid_field, status, to_status};
use crate::domain::blob::{BlobRef, Digest};
use crate::error::ErrorKind;
use crate::ingest::ArrivedImages;
use crate::store::{self, Begun, BlobStore, Store, Upload};

/// Blobs of one store.
#[derive(Clone, Debug)]
pub(crate) struct BlobApi {
    blobs: Arc<BlobStore>,
    images: ArrivedImages,
    stopping: CancellationToken,
}

impl BlobApi {
    pub(crate) fn new(store: &Store, images: ArrivedImages, stopping: CancellationToken) -> Self {
        Self {
            blobs: Arc::new(store.blobs().clone()),
            images,
            stopping,
        }
    }

    /// Has a blob that is whole now looked at, while the client sends the next.
    fn look_at(&self, blob: &BlobRef) {
        if self.images.arrived(blob) {
            let api = self.clone();
            // Nobody waits for it: what it does not get to is left to the log's check.
            drop(tokio::task::spawn_blocking(move || {
                api.images.work(|digest| {
                    let goes_on = !api.stopping.is_cancelled();
                    goes_on.then(|| api.blobs.read(digest).ok()).flatten()
                });
            }));
        }
    }
}

#[tonic::async_trait]
impl BlobService for BlobApi {
    async fn find_missing_blobs(
        &self,
        request: Request<v1::FindMissingBlobsRequest>,
    ) -> Result<Response<v1::FindMissingBlobsResponse>, Status> {
        let digests = request.into_inner().digests;
        if digests.len() > MAX_DIGESTS {
            let what = format!("has {} entries, at most {MAX_DIGESTS}", digests.len());
            return Err(invalid_field("digests", what));
        }
        let digests = digests
            .iter()
            .enumerate()
            .map(|(i, text)| digest_from_wire(&format!("digests[{i}]"), text))
            .collect::<Result<Vec<_>, _>>()?;
        let blobs = self.blobs.clone();
        let missing = blocking(move || missing(&blobs, digests)).await?;
        Ok(Response::new(v1::FindMissingBlobsResponse {
            missing_digests: missing.iter().map(Digest::to_string).collect(),
        }))
    }

    async fn write_blob(
        &self,
        request: Request<Streaming<v1::WriteBlobRequest>>,
    ) -> Result<Response<v1::WriteBlobResponse>, Status> {
        let mut messages = request.into_inner();
        let first = next_chunk(&mut messages)
            .await?
            .ok_or_else(|| invalid_field("blob", "is missing: the call sent no message"))?;
        let blob = blob_from_wire("blob", first.blob.as_ref())?;
        let blobs = self.blobs.clone();
        let mut upload = match blocking(move || blobs.begin(blob)).await? {
            Begun::Writing(upload) => upload,
            Begun::Present => {
                return Ok(Response::new(v1::WriteBlobResponse {
                    committed_bytes: blob.size_bytes,
                    already_present: true,
                }));
            }
        };
        let mut next = Some(first);
        while let Some(message) = next {
            upload = append(upload, message).await?;
            next = next_chunk(&mut messages).await?;
        }
        let committed_bytes = conclude(upload).await?;
        if committed_bytes == blob.size_bytes {
            self.look_at(&blob);
        }
        Ok(Response::new(v1::WriteBlobResponse {
            committed_bytes,
            already_present: false,
        }))
    }

    async fn query_blob_write(
        &self,
        request: Request<v1::QueryBlobWriteRequest>,
    ) -> Result<Response<v1::QueryBlobWriteResponse>, Status> {
        let digest = digest_from_wire("digest", &request.get_ref().digest)?;
        let blobs = self.blobs.clone();
        let (committed_bytes, complete) = blocking(move || blobs.committed(&digest)).await?;
        Ok(Response::new(v1::QueryBlobWriteResponse {
            committed_bytes,
            complete,
        }))
    }

    type ReadBlobStream = BoxStream<'static, Result<v1::ReadBlobResponse, Status>>;

    async fn read_blob(
        &self,
        request: Request<v1::ReadBlobRequest>,
    ) -> Result<Response<Self::ReadBlobStream>, Status> {
        let request = request.into_inner();
        let digest = digest_from_wire("digest", &request.digest)?;
        let blobs = self.blobs.clone();
        let size_bytes = blocking(move || blobs.verify(&digest)).await?;
        if request.offset > size_bytes {
            let what = format!("{} is behind the end, {size_bytes}", request.offset);
            return Err(invalid_field("offset", what));
        }
        let left = size_bytes - request.offset;
        let reading = Reading {
            blobs: self.blobs.clone(),
            digest,
            size_bytes,
            offset: request.offset,
            left: match request.limit {
                0 => left,
                limit => limit.min(left),
            },
            sent: false,
        };
        // Pulled by the transport: what the client does not take is not read.
        Ok(Response::new(
            stream::try_unfold(reading, Reading::next).boxed(),
        ))
    }
}

fn missing(blobs: &BlobStore, digests: Vec<Digest>) -> store::Result<Vec<Digest>> {
    let mut seen = HashSet::new();
    let mut missing = Vec::new();
    for digest in digests {
        if seen.insert(digest) && blobs.size_bytes(&digest)?.is_none() {
            missing.push(digest);
        }
    }
    Ok(missing)
}

/// The next message; a client that is silent for too long is cut.
async fn next_chunk(
    messages: &mut Streaming<v1::WriteBlobRequest>,
) -> Result<Option<v1::WriteBlobRequest>, Status> {
    tokio::time::timeout(UPLOAD_IDLE, messages.try_next())
        .await
        .map_err(|_| {
            let what = format!("nothing was sent for {} s", UPLOAD_IDLE.as_secs());
            status(ErrorKind::Cancelled, what)
        })?
}

/// Checks a chunk and appends it. An empty one only names the blob.
async fn append(mut upload: Upload, message: v1::WriteBlobRequest) -> Result<Upload, Status> {
    let chunk = message.chunk;
    if chunk.len() > MAX_CHUNK_BYTES {
        let what = format!("has {} bytes, at most {MAX_CHUNK_BYTES}", chunk.len());
        return Err(invalid_field("chunk", what));
    }
    if crc32c::crc32c(&chunk) != message.chunk_crc32c {
        let what = format!("does not match the chunk at byte {}", message.offset);
        return Err(invalid_field("chunk_crc32c", what));
    }
    if chunk.is_empty() {
        return Ok(upload);
    }
    blocking(move || upload.write(message.offset, &chunk).map(|()| upload)).await
}

/// Publishes a whole blob, keeps a part for later; returns the bytes that are on stable storage.
async fn conclude(upload: Upload) -> Result<u64, Status> {
    blocking_status(move || {
        let committed_bytes = upload.committed_bytes();
        let done = match upload.is_whole() {
            true => upload.finish(),
            false => upload.sync(),
        };
        done.map(|()| committed_bytes).map_err(|e| to_status(&e))
    })
    .await
}

/// A blob on its way out.
struct Reading {
    blobs: Arc<BlobStore>,
    digest: Digest,
    size_bytes: u64,
    offset: u64,
    left: u64,
    sent: bool,
}

impl Reading {
    /// The next chunk. An empty range is one empty chunk, so that the client learns the size.
    async fn next(mut self) -> Result<Option<(v1::ReadBlobResponse, Self)>, Status> {
        if self.left == 0 && self.sent {
            return Ok(None);
        }
        let (blobs, digest, offset) = (self.blobs.clone(), self.digest, self.offset);
        let count = self.left.min(MAX_CHUNK_BYTES as u64);
        let chunk = blocking(move || blobs.read_range(&digest, offset, count)).await?;
        self.offset += count;
        self.left -= count;
        self.sent = true;
        let message = v1::ReadBlobResponse {
            size_bytes: self.size_bytes,
            offset,
            chunk_crc32c: crc32c::crc32c(&chunk),
            chunk,
        };
        Ok(Some((message, self)))
    }
}

fn digest_from_wire(field: &str, text: &str) -> Result<Digest, Status> {
    text.parse().map_err(|e| invalid_field(field, e))
}

fn blob_from_wire(field: &str, blob: Option<&v1::BlobRef>) -> Result<BlobRef, Status> {
    let blob = blob.ok_or_else(|| invalid_field(field, "is missing"))?;
    Ok(BlobRef {
        digest: digest_from_wire(&format!("{field}.digest"), &blob.digest)?,
        size_bytes: blob.size_bytes,
    })
}

pub(crate) fn blob_to_wire(blob: &BlobRef) -> v1::BlobRef {
    v1::BlobRef {
        digest: blob.digest.to_string(),
        size_bytes: blob.size_bytes,
    }
}
