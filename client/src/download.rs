//! Reading a blob back, verified.

use std::io::Write;
use std::path::Path;

use backlot_proto::v1;

use crate::connection::Connection;
use crate::error::{Error, Result};

/// Writes a blob's content to `path`, which appears only once size and digest have been verified.
pub async fn download_blob(connection: &Connection, blob: &v1::BlobRef, path: &Path) -> Result<()> {
    let partial = path.with_extension("partial");
    let result = receive(connection, blob, &partial).await;
    let result =
        result.and_then(|()| std::fs::rename(&partial, path).map_err(|e| Error::io(path, e)));
    if result.is_err() {
        // The error that matters is the one being returned.
        let _ = std::fs::remove_file(&partial);
    }
    result
}

async fn receive(connection: &Connection, blob: &v1::BlobRef, path: &Path) -> Result<()> {
    let doing = format!("reading blob {}", blob.digest);
    let protocol = |what: &str| Error::Protocol {
        doing: doing.clone(),
        what: what.to_owned(),
    };
    let request = v1::ReadBlobRequest {
        digest: blob.digest.clone(),
        offset: 0,
        limit: 0,
    };
    let reply = connection.blobs().read_blob(request).await;
    let mut stream = reply.map_err(Error::status(doing.clone()))?.into_inner();
    let mut file = std::fs::File::create(path).map_err(|e| Error::io(path, e))?;
    let mut hasher = blake3::Hasher::new();
    let next = async |stream: &mut tonic::Streaming<v1::ReadBlobResponse>| {
        stream.message().await.map_err(Error::status(doing.clone()))
    };
    while let Some(message) = next(&mut stream).await? {
        if message.offset != hasher.count() {
            return Err(protocol("chunks are out of order"));
        }
        if crc32c::crc32c(&message.chunk) != message.chunk_crc32c {
            return Err(protocol("a chunk was damaged on the way"));
        }
        hasher.update(&message.chunk);
        file.write_all(&message.chunk)
            .map_err(|e| Error::io(path, e))?;
    }
    if hasher.finalize().to_hex().as_str() != blob.digest {
        return Err(protocol("the content does not have the digest"));
    }
    file.sync_all().map_err(|e| Error::io(path, e))
}
