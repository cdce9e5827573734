//! `DriveLogService`: manifests are validated on arrival, then kept.

use std::sync::Arc;

use backlot_proto::v1;
use backlot_proto::v1::drive_log_service_server::DriveLogService;
use bytes::Bytes;
use tonic::{Request, Response, Status};

use super::blobs::blob_to_wire;
use super::blocking::{blocking, blocking_status};
use super::convert_drive_log::{drive_log_from_wire, drive_log_to_wire};
use super::page::Page;
use super::status::{invalid_field, to_status, violations_status};
use super::time::timestamp;
use crate::domain::blob::BlobRef;
use crate::domain::clock::Clock;
use crate::domain::drive_log::DriveLog;
use crate::domain::ids::DriveLogId;
use crate::ingest::{self, ArrivedImages, LogBlobs};
use crate::store::{self, DriveLogRecord, Store};

/// Drive logs of one store.
#[derive(Clone, Debug)]
pub(crate) struct DriveLogApi {
    store: Store,
    images: ArrivedImages,
    clock: Arc<dyn Clock>,
}

impl DriveLogApi {
    pub(crate) fn new(store: Store, images: ArrivedImages, clock: Arc<dyn Clock>) -> Self {
        Self {
            store,
            images,
            clock,
        }
    }
}

#[tonic::async_trait]
impl DriveLogService for DriveLogApi {
    async fn create_drive_log(
        &self,
        request: Request<v1::CreateDriveLogRequest>,
    ) -> Result<Response<v1::CreateDriveLogResponse>, Status> {
        let request = request.into_inner();
        let wire = request
            .drive_log
            .ok_or_else(|| invalid_field("drive_log", "is missing"))?;
        let log = drive_log_from_wire(wire).map_err(|e| violations_status(&e))?;
        let api = self.clone();
        blocking_status(move || api.create(&log, request.validate_only))
            .await
            .map(Response::new)
    }

    async fn get_drive_log(
        &self,
        request: Request<v1::GetDriveLogRequest>,
    ) -> Result<Response<v1::GetDriveLogResponse>, Status> {
        let id = id_from_wire(&request.get_ref().name)?;
        let store = self.store.clone();
        let (record, log) = blocking(move || read(&store, &id)).await?;
        Ok(Response::new(v1::GetDriveLogResponse {
            drive_log: Some(to_wire(&log, Some(&record))),
        }))
    }

    async fn list_drive_logs(
        &self,
        request: Request<v1::ListDriveLogsRequest>,
    ) -> Result<Response<v1::ListDriveLogsResponse>, Status> {
        let request = request.into_inner();
        let page = Page::parse(request.page_size, &request.page_token, "driveLogs".into())?;
        let (store, after, limit) = (self.store.clone(), page.after.clone(), page.read_limit());
        let mut records = blocking(move || store.drive_logs(&after, limit)).await?;
        let next_page_token = page.close(&mut records, |log| log.id.as_str().to_owned());
        Ok(Response::new(v1::ListDriveLogsResponse {
            drive_logs: records.iter().map(summary).collect(),
            next_page_token,
        }))
    }

    async fn delete_drive_log(
        &self,
        request: Request<v1::DeleteDriveLogRequest>,
    ) -> Result<Response<v1::DeleteDriveLogResponse>, Status> {
        let id = id_from_wire(&request.get_ref().name)?;
        let store = self.store.clone();
        blocking(move || store.delete_drive_log(&id)).await?;
        Ok(Response::new(v1::DeleteDriveLogResponse {}))
    }
}

impl DriveLogApi {
    fn create(
        &self,
        log: &DriveLog,
        validate_only: bool,
    ) -> Result<v1::CreateDriveLogResponse, Status> {
        let blobs = StoredBlobs {
            store: &self.store,
            images: &self.images,
        };
        let accepted = ingest::validate(log, &blobs)
            .map_err(|e| to_status(&e))?
            .map_err(|e| violations_status(&e))?;
        let record = match validate_only {
            true => None,
            false => Some(self.commit(log).map_err(|e| to_status(&e))?),
        };
        Ok(v1::CreateDriveLogResponse {
            drive_log: Some(to_wire(log, record.as_ref())),
            warnings: accepted.warnings,
        })
    }

    /// Manifest first, then the record that names it.
    fn commit(&self, log: &DriveLog) -> store::Result<DriveLogRecord> {
        let manifest = self.store.blobs().put(&log.to_manifest())?;
        self.store.create_drive_log(DriveLogRecord {
            id: log.id.clone(),
            manifest,
            dataset: log.dataset.clone(),
            synthetic: log.synthetic,
            camera_count: log.cameras.len() as u32,
            frame_count: log.frames.len() as u32,
            sweep_count: log.sweeps.len() as u32,
            track_count: log.tracks.len() as u32,
            travel_m: travel_m(log),
            created_at: self.clock.now(),
        })
    }
}

/// The blobs of the store, as validation reads them.
struct StoredBlobs<'a> {
    store: &'a Store,
    images: &'a ArrivedImages,
}

impl LogBlobs for StoredBlobs<'_> {
    type Error = store::Error;

    fn size_bytes(&self, blob: &BlobRef) -> store::Result<Option<u64>> {
        self.store.blobs().size_bytes(&blob.digest)
    }

    fn read(&self, blob: &BlobRef) -> store::Result<Bytes> {
        self.store.blobs().read(&blob.digest)
    }

    fn decoded_size(&self, blob: &BlobRef) -> Option<(u32, u32)> {
        self.images.decoded_size(&blob.digest)
    }
}

fn read(store: &Store, id: &DriveLogId) -> store::Result<(DriveLogRecord, DriveLog)> {
    let record = store.drive_log(id)?;
    let manifest = store.blobs().read(&record.manifest.digest)?;
    let log = DriveLog::from_manifest(&manifest).map_err(|e| store::Error::Corrupt {
        what: format!("manifest of {id} ({e})"),
    })?;
    Ok((record, log))
}

fn id_from_wire(name: &str) -> Result<DriveLogId, Status> {
    name.parse().map_err(|e| invalid_field("name", e))
}

fn to_wire(log: &DriveLog, record: Option<&DriveLogRecord>) -> v1::DriveLog {
    v1::DriveLog {
        create_time: record.map(|record| timestamp(record.created_at)),
        manifest: record.map(|record| blob_to_wire(&record.manifest)),
        ..drive_log_to_wire(log)
    }
}

fn summary(record: &DriveLogRecord) -> v1::DriveLogSummary {
    v1::DriveLogSummary {
        name: record.id.to_string(),
        dataset: record.dataset.clone(),
        synthetic: record.synthetic,
        camera_count: record.camera_count,
        frame_count: record.frame_count,
        sweep_count: record.sweep_count,
        track_count: record.track_count,
        travel_m: record.travel_m,
        create_time: Some(timestamp(record.created_at)),
    }
}

/// Path length of the ego trajectory in metres.
fn travel_m(log: &DriveLog) -> f64 {
    log.world_from_ego
        .poses()
        .windows(2)
        .map(|pair| {
            pair[0]
                .pose
                .translation_m
                .distance(pair[1].pose.translation_m)
        })
        .sum()
}
