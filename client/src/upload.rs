//! Uploading a log: only what the server lacks, in checksummed chunks, resumable, then the manifest.

use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

use backlot_proto::v1;
use bytes::Bytes;
use futures::{StreamExt, TryStreamExt, stream};

use crate::connection::{Connection, with_deadline};
use crate::error::{Error, Result};
use crate::read_log::{BlobSource, ReadLog};
use crate::violated_files::with_files;

/// Digests a FindMissingBlobs call may name.
const FIND_BATCH: usize = 10_000;

/// Bytes of one chunk. The server takes up to 1 MiB; less keeps a slow link's acknowledgements and memory small.
const CHUNK_BYTES: usize = 512 << 10;

/// Blobs written at once; each is held in memory while it is.
const PARALLEL_WRITES: usize = 4;

/// Tries of one blob, each going on where the last one was cut.
const ATTEMPTS: u32 = 6;
const FIRST_PAUSE: Duration = Duration::from_millis(200);

/// How far an upload is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UploadProgress {
    /// Bytes of the log's blobs that the server has.
    pub present_bytes: u64,
    pub total_bytes: u64,
}

/// A finished upload.
#[derive(Clone, Debug)]
pub struct Uploaded {
    pub drive_log: v1::DriveLog,
    /// The server's: legal, but probably not meant.
    pub warnings: Vec<String>,
    pub blobs_total: usize,
    /// Blobs the server did not have, or not whole.
    pub blobs_sent: usize,
    /// Bytes of their content that were sent: of a blob that was cut only the rest.
    pub bytes_sent: u64,
    /// Until every blob was on the server's disk.
    pub sending: Duration,
    /// The server's check of the whole log, and its commit.
    pub accepting: Duration,
}

/// Uploads a log as `name` (`driveLogs/{id}`). After a cut the same call sends only the rest.
pub async fn upload_log(
    connection: &Connection,
    log: &ReadLog,
    name: &str,
    on_progress: &(dyn Fn(UploadProgress) + Sync),
) -> Result<Uploaded> {
    let sizes = blob_sizes(&log.drive_log);
    let missing = find_missing(connection, log).await?;
    let total_bytes: u64 = sizes.values().sum();
    let missing_bytes: u64 = missing.iter().filter_map(|d| sizes.get(d)).sum();
    let present = AtomicU64::new(total_bytes - missing_bytes);
    let on_bytes = |bytes: u64| {
        let present_bytes = present.fetch_add(bytes, Ordering::Relaxed) + bytes;
        on_progress(UploadProgress {
            present_bytes: present_bytes.min(total_bytes),
            total_bytes,
        });
    };
    on_bytes(0);
    let started = Instant::now();
    let sent = AtomicU64::new(0);
    stream::iter(&missing)
        .map(Ok)
        .try_for_each_concurrent(PARALLEL_WRITES, |digest| {
            write_blob(connection, log, digest, &sent, &on_bytes)
        })
        .await?;
    let sending = started.elapsed();
    let created = create(connection, log, name).await?;
    Ok(Uploaded {
        bytes_sent: sent.into_inner(),
        sending,
        accepting: started.elapsed() - sending,
        drive_log: created.drive_log.unwrap_or_default(),
        warnings: created.warnings,
        blobs_total: log.blobs.len(),
        blobs_sent: missing.len(),
    })
}

fn blob_sizes(log: &v1::DriveLog) -> std::collections::BTreeMap<String, u64> {
    let frames = log.frames.iter().flat_map(|f| {
        [
            &f.image,
            &f.instance_mask,
            &f.sky_mask,
            &f.free_instance_mask,
        ]
    });
    let maps = log.frames.iter().flat_map(|f| &f.depth_map);
    let sweeps = log.sweeps.iter().map(|s| &s.points);
    let points = log.sfm_points.iter();
    frames
        .chain(maps.map(|map| &map.image))
        .chain(sweeps)
        .chain(points.flat_map(|sfm| [&sfm.points, &sfm.observations]))
        .flatten()
        .map(|blob| (blob.digest.clone(), blob.size_bytes))
        .collect()
}

async fn find_missing(connection: &Connection, log: &ReadLog) -> Result<Vec<String>> {
    let digests: Vec<&String> = log.blobs.keys().collect();
    let mut missing = Vec::new();
    for batch in digests.chunks(FIND_BATCH) {
        let request = v1::FindMissingBlobsRequest {
            digests: batch.iter().map(|digest| (*digest).clone()).collect(),
        };
        let reply = connection
            .blobs()
            .find_missing_blobs(with_deadline(request))
            .await
            .map_err(Error::status("asking which blobs are missing"))?;
        missing.extend(reply.into_inner().missing_digests);
    }
    Ok(missing)
}

async fn write_blob(
    connection: &Connection,
    log: &ReadLog,
    digest: &str,
    sent: &AtomicU64,
    on_bytes: &(dyn Fn(u64) + Sync),
) -> Result<()> {
    let source = log.blobs.get(digest).ok_or_else(|| Error::Protocol {
        doing: "asking which blobs are missing".to_owned(),
        what: format!("the server asked for blob {digest}, which was not offered"),
    })?;
    let content = read_source(source).await?;
    let mut counted = 0;
    let mut pause = FIRST_PAUSE;
    for attempt in 1.. {
        match write_rest(connection, source, digest, &content, sent).await {
            Ok(()) => break,
            Err(error) if attempt < ATTEMPTS && error.is_transient() => {
                tracing::debug!(digest, attempt, %error, "write was cut");
                let held = committed_bytes(connection, digest).await.unwrap_or(counted);
                on_bytes(held.saturating_sub(counted));
                counted = held.max(counted);
                tokio::time::sleep(pause).await;
                pause *= 2;
            }
            Err(error) => return Err(error),
        }
    }
    on_bytes(content.len() as u64 - counted);
    Ok(())
}

async fn read_source(source: &BlobSource) -> Result<Bytes> {
    match source {
        BlobSource::Memory(content) => Ok(content.clone()),
        BlobSource::File(path) => {
            let content = tokio::fs::read(path).await;
            Ok(content.map_err(|e| Error::io(path, e))?.into())
        }
        BlobSource::Spooled { .. } => {
            let source = source.clone();
            let content = tokio::task::spawn_blocking(move || source.read()).await;
            let content = content.unwrap_or_else(|e| Err(std::io::Error::other(e)));
            content.map_err(|e| Error::io(&std::env::temp_dir(), e))
        }
    }
}

async fn committed_bytes(connection: &Connection, digest: &str) -> Result<u64> {
    let request = v1::QueryBlobWriteRequest {
        digest: digest.to_owned(),
    };
    let reply = connection
        .blobs()
        .query_blob_write(with_deadline(request))
        .await
        .map_err(Error::status("asking how much of a blob is written"))?;
    Ok(reply.into_inner().committed_bytes)
}

/// Sends the blob from the server's committed offset to its end.
async fn write_rest(
    connection: &Connection,
    source: &BlobSource,
    digest: &str,
    content: &Bytes,
    sent: &AtomicU64,
) -> Result<()> {
    let committed = committed_bytes(connection, digest).await?;
    let start = committed.min(content.len() as u64) as usize;
    sent.fetch_add((content.len() - start) as u64, Ordering::Relaxed);
    let blob = v1::BlobRef {
        digest: digest.to_owned(),
        size_bytes: content.len() as u64,
    };
    let messages = stream::iter(chunk_messages(blob, content.clone(), start));
    let doing = format!("uploading {}", source.describe(digest));
    let reply = connection
        .blobs()
        .write_blob(messages)
        .await
        .map_err(Error::status(doing.clone()))?
        .into_inner();
    if reply.committed_bytes == content.len() as u64 {
        return Ok(());
    }
    let what = format!(
        "the server committed {} of {} bytes",
        reply.committed_bytes,
        content.len()
    );
    Err(Error::Protocol { doing, what })
}

/// At least one message, so that an empty or complete blob is still named.
fn chunk_messages(
    blob: v1::BlobRef,
    content: Bytes,
    start: usize,
) -> impl Iterator<Item = v1::WriteBlobRequest> + Send + 'static {
    let offsets = (start..content.len().max(start + 1)).step_by(CHUNK_BYTES);
    offsets.map(move |offset| {
        let chunk = content.slice(offset..content.len().min(offset + CHUNK_BYTES).max(offset));
        v1::WriteBlobRequest {
            blob: (offset == start).then(|| blob.clone()),
            offset: offset as u64,
            chunk_crc32c: crc32c::crc32c(&chunk),
            chunk,
        }
    })
}

async fn create(
    connection: &Connection,
    log: &ReadLog,
    name: &str,
) -> Result<v1::CreateDriveLogResponse> {
    let drive_log = v1::DriveLog {
        name: name.to_owned(),
        ..log.drive_log.clone()
    };
    let request = v1::CreateDriveLogRequest {
        drive_log: Some(drive_log),
        validate_only: false,
    };
    // Validation decodes every image, so this call has no short deadline; it may be repeated.
    let mut pause = FIRST_PAUSE;
    for attempt in 1.. {
        let reply = connection
            .drive_logs()
            .create_drive_log(request.clone())
            .await
            .map_err(|status| with_files(status, log))
            .map_err(Error::status(format!("creating {name}")));
        match reply {
            Err(error) if attempt < ATTEMPTS && error.is_transient() => {
                tokio::time::sleep(pause).await;
                pause *= 2;
            }
            reply => return reply.map(tonic::Response::into_inner),
        }
    }
    unreachable!("the last attempt returns")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn messages(content: &[u8], start: usize) -> Vec<v1::WriteBlobRequest> {
        let blob = v1::BlobRef {
            digest: "d".to_owned(),
            size_bytes: content.len() as u64,
        };
        chunk_messages(blob, Bytes::copy_from_slice(content), start).collect()
    }

    #[test]
    fn chunks_put_together_are_the_rest_of_the_blob() {
        let content: Vec<u8> = (0..CHUNK_BYTES * 2 + 17).map(|i| i as u8).collect();
        for start in [0, 1, CHUNK_BYTES, content.len() - 1] {
            let messages = messages(&content, start);
            let mut joined = Vec::new();
            for (i, message) in messages.iter().enumerate() {
                assert_eq!(message.offset as usize, start + joined.len());
                assert_eq!(message.blob.is_some(), i == 0);
                assert_eq!(message.chunk_crc32c, crc32c::crc32c(&message.chunk));
                joined.extend_from_slice(&message.chunk);
            }
            assert_eq!(joined, content[start..]);
        }
    }

    #[test]
    fn empty_and_complete_blobs_are_still_named() {
        for (content, start) in [(&[][..], 0), (&[1, 2][..], 2)] {
            let messages = messages(content, start);
            assert_eq!(messages.len(), 1);
            assert!(messages[0].blob.is_some() && messages[0].chunk.is_empty());
        }
    }
}
