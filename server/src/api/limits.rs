//! What a client may send and hold: the one place for the limits of the wire.

use std::time::Duration;

/// Longest request message. Manifests of long drives are the largest; blobs travel in chunks.
pub(crate) const MAX_REQUEST_BYTES: usize = 8 << 20;

/// Longest reply message: six full-resolution frames of a sample.
pub(crate) const MAX_REPLY_BYTES: usize = 64 << 20;

/// Longest chunk of a blob, both ways.
pub(crate) const MAX_CHUNK_BYTES: usize = 1 << 20;

/// Digests in one question for missing blobs.
pub(crate) const MAX_DIGESTS: usize = 10_000;

/// Items on a page that asks for none, and at most.
pub(crate) const DEFAULT_PAGE: usize = 100;
pub(crate) const MAX_PAGE: usize = 1_000;

pub(crate) const MAX_REQUEST_ID_BYTES: usize = 128;

/// An upload that sends nothing for this long is cut; it can be resumed.
pub(crate) const UPLOAD_IDLE: Duration = Duration::from_secs(30);

/// Samples of one call.
pub(crate) const MAX_SAMPLES: u64 = 100_000;

/// Plans of one call, as far as they fit a reply.
pub(crate) const MAX_PLANS: u64 = 1_000;

/// Calls that render at once; all share the engine's threads.
pub(crate) const MAX_RENDERINGS: usize = 16;

/// Finished samples that wait for a slow client, besides the one in the sender's hand.
pub(crate) const SAMPLES_AHEAD: usize = 1;

/// Calls that one connection may have open.
pub(crate) const MAX_STREAMS: u32 = 128;

/// Flow-control windows: memory that a connection may fill without being read.
pub(crate) const STREAM_WINDOW_BYTES: u32 = 2 << 20;
pub(crate) const CONNECTION_WINDOW_BYTES: u32 = 8 << 20;

/// Total size of a request's header fields.
pub(crate) const MAX_HEADER_BYTES: u32 = 16 << 10;

/// Dead peers are found after the two together.
pub(crate) const KEEPALIVE_EVERY: Duration = Duration::from_secs(20);
pub(crate) const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);
