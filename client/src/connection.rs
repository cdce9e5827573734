//! A connection to one server and the typed services on it.

use std::time::Duration;

use backlot_proto::v1;
use tonic::Request;
use tonic::transport::{Channel, Endpoint};

use crate::error::{Error, Result};

/// Largest message accepted: a sample with image, depth and instance planes of a 4,096-pixel image.
const MAX_MESSAGE_BYTES: usize = 64 << 20;

/// Deadline of calls that answer at once; a server that is training on every core may take seconds.
const CALL_TIMEOUT: Duration = Duration::from_secs(60);

const CONNECT_TIMEOUT: Duration = Duration::from_secs(5);

/// A dead peer is noticed within this and half of it again.
const KEEP_ALIVE: Duration = Duration::from_secs(20);

/// Cheap to clone; clones share one HTTP/2 connection.
#[derive(Clone, Debug)]
pub struct Connection {
    channel: Channel,
    url: String,
}

pub type Blobs = v1::blob_service_client::BlobServiceClient<Channel>;
pub type DriveLogs = v1::drive_log_service_client::DriveLogServiceClient<Channel>;
pub type Jobs = v1::job_service_client::JobServiceClient<Channel>;
pub type Assets = v1::asset_service_client::AssetServiceClient<Channel>;
pub type Samples = v1::sample_service_client::SampleServiceClient<Channel>;

impl Connection {
    /// Connects to `url`, e.g. `http://127.0.0.1:50051`; later breaks are mended by reconnecting on the next call.
    pub async fn open(url: &str) -> Result<Self> {
        let endpoint = Endpoint::from_shared(url.to_owned())
            .map_err(|e| Error::Address {
                url: url.to_owned(),
                what: e.to_string(),
            })?
            .connect_timeout(CONNECT_TIMEOUT)
            .http2_keep_alive_interval(KEEP_ALIVE)
            .keep_alive_timeout(KEEP_ALIVE / 2)
            .keep_alive_while_idle(false);
        if endpoint.uri().host().is_none() {
            return Err(Error::Address {
                url: url.to_owned(),
                what: "has no host".to_owned(),
            });
        }
        let channel = endpoint.connect().await.map_err(|e| Error::Connect {
            url: url.to_owned(),
            what: innermost(&e),
        })?;
        Ok(Self {
            channel,
            url: url.to_owned(),
        })
    }

    pub fn url(&self) -> &str {
        &self.url
    }

    pub fn blobs(&self) -> Blobs {
        Blobs::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub fn drive_logs(&self) -> DriveLogs {
        DriveLogs::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub fn jobs(&self) -> Jobs {
        Jobs::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub fn assets(&self) -> Assets {
        Assets::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }

    pub fn samples(&self) -> Samples {
        Samples::new(self.channel.clone()).max_decoding_message_size(MAX_MESSAGE_BYTES)
    }
}

/// A request with the deadline of calls that answer at once.
pub(crate) fn with_deadline<T>(message: T) -> Request<T> {
    let mut request = Request::new(message);
    request.set_timeout(CALL_TIMEOUT);
    request
}

/// tonic's own message is "transport error"; the cause is at the end of the chain.
fn innermost(error: &dyn std::error::Error) -> String {
    let mut cause = error;
    while let Some(source) = cause.source() {
        cause = source;
    }
    cause.to_string()
}
