//! All services behind one listener, with the limits of the wire.

use std::future::Future;
use std::sync::Arc;

use backlot_engine::backend::Backend;
use backlot_proto::FILE_DESCRIPTOR_SET;
use backlot_proto::v1::asset_service_server::AssetServiceServer;
use backlot_proto::v1::blob_service_server::BlobServiceServer;
use backlot_proto::v1::drive_log_service_server::DriveLogServiceServer;
use backlot_proto::v1::job_service_server::JobServiceServer;
use backlot_proto::v1::sample_service_server::SampleServiceServer;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;
use tonic::service::Routes;
use tonic::transport::Server;
use tonic::transport::server::TcpIncoming;
use tonic_health::pb::FILE_DESCRIPTOR_SET as HEALTH_DESCRIPTOR_SET;
use tonic_health::server::HealthReporter;

use super::assets::AssetApi;
use super::blobs::BlobApi;
use super::drive_logs::DriveLogApi;
use super::jobs::JobApi;
use super::samples::SampleApi;
use super::{layers, limits};
use crate::domain::clock::Clock;
use crate::ingest::ArrivedImages;
use crate::jobs::Queue;
use crate::store::Store;

/// What the services work on.
#[derive(Clone, Debug)]
pub struct Services {
    pub store: Store,
    pub queue: Arc<Queue>,
    /// Renders.
    pub backend: Arc<dyn Backend>,
    pub clock: Arc<dyn Clock>,
    /// Cancelled when the server begins to stop: long streams end.
    pub stopping: CancellationToken,
}

/// Serves until `stop` is ready and every call has ended.
pub async fn serve(
    listener: TcpListener,
    services: Services,
    health: HealthReporter,
    stop: impl Future<Output = ()> + Send,
) -> Result<(), tonic::transport::Error> {
    let incoming = TcpIncoming::from(listener).with_nodelay(Some(true));
    Server::builder()
        .initial_stream_window_size(limits::STREAM_WINDOW_BYTES)
        .initial_connection_window_size(limits::CONNECTION_WINDOW_BYTES)
        .max_concurrent_streams(limits::MAX_STREAMS)
        .http2_max_header_list_size(limits::MAX_HEADER_BYTES)
        .http2_keepalive_interval(Some(limits::KEEPALIVE_EVERY))
        .http2_keepalive_timeout(Some(limits::KEEPALIVE_TIMEOUT))
        .layer(layers::trace())
        .layer(layers::catch_panic())
        .add_routes(routes(services, health))
        .serve_with_incoming_shutdown(incoming, stop)
        .await
}

fn routes(services: Services, health: HealthReporter) -> Routes {
    let Services {
        store,
        queue,
        backend,
        clock,
        stopping,
    } = services;
    macro_rules! limited {
        ($server:ident, $service:expr) => {
            $server::new($service)
                .max_decoding_message_size(limits::MAX_REQUEST_BYTES)
                .max_encoding_message_size(limits::MAX_REPLY_BYTES)
        };
    }
    let reflection = tonic_reflection::server::Builder::configure()
        .register_encoded_file_descriptor_set(FILE_DESCRIPTOR_SET)
        .register_encoded_file_descriptor_set(HEALTH_DESCRIPTOR_SET)
        .build_v1()
        .expect("the descriptor sets are those compiled in");
    let health = tonic_health::pb::health_server::HealthServer::new(
        tonic_health::server::HealthService::from_health_reporter(health),
    );
    let images = ArrivedImages::new(rayon::current_num_threads());
    Routes::new(health)
        .add_service(reflection)
        .add_service(limited!(
            BlobServiceServer,
            BlobApi::new(&store, images.clone(), stopping.clone())
        ))
        .add_service(limited!(
            DriveLogServiceServer,
            DriveLogApi::new(store.clone(), images, clock.clone())
        ))
        .add_service(limited!(
            AssetServiceServer,
            AssetApi::new(store.clone(), clock)
        ))
        .add_service(limited!(
            SampleServiceServer,
            SampleApi::new(store.clone(), backend, stopping.clone())
        ))
        .add_service(limited!(
            JobServiceServer,
            JobApi::new(queue, store, stopping)
        ))
}
