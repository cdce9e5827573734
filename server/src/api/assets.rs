//! `AssetService`: the library and its snapshots.

use std::sync::Arc;

use backlot_proto::v1;
use backlot_proto::v1::asset_service_server::AssetService;
use tonic::{Request, Response, Status};

use super::blocking::blocking;
use super::convert_asset::asset_to_wire;
use super::page::Page;
use super::status::invalid_field;
use super::time::timestamp;
use crate::domain::asset::AssetKind;
use crate::domain::blob::Digest;
use crate::domain::clock::Clock;
use crate::domain::ids::{AssetId, DriveLogId};
use crate::domain::snapshot::LibrarySnapshot;
use crate::store::{self, Store};

/// Collection of the snapshots' resource names.
const SNAPSHOTS: &str = "librarySnapshots/";

/// Assets of one store.
#[derive(Clone, Debug)]
pub(crate) struct AssetApi {
    store: Store,
    clock: Arc<dyn Clock>,
}

impl AssetApi {
    pub(crate) fn new(store: Store, clock: Arc<dyn Clock>) -> Self {
        Self { store, clock }
    }
}

#[tonic::async_trait]
impl AssetService for AssetApi {
    async fn get_asset(
        &self,
        request: Request<v1::GetAssetRequest>,
    ) -> Result<Response<v1::GetAssetResponse>, Status> {
        let id = asset_id(&request.get_ref().name)?;
        let store = self.store.clone();
        let asset = blocking(move || store.asset(&id)).await?;
        Ok(Response::new(v1::GetAssetResponse {
            asset: Some(asset_to_wire(&asset)),
        }))
    }

    async fn list_assets(
        &self,
        request: Request<v1::ListAssetsRequest>,
    ) -> Result<Response<v1::ListAssetsResponse>, Status> {
        let request = request.into_inner();
        let list = format!("assets {} {}", request.kind, request.source_log);
        let page = Page::parse(request.page_size, &request.page_token, list)?;
        let kind = kind_from_wire(request.kind)?;
        let log = optional_log(&request.source_log)?;
        let (store, after, limit) = (self.store.clone(), page.after.clone(), page.read_limit());
        let mut assets = blocking(move || {
            store.assets(&after, limit, |asset| {
                kind.is_none_or(|kind| kind == asset.kind())
                    && log.as_ref().is_none_or(|log| *log == asset.source_log)
            })
        })
        .await?;
        let next_page_token = page.close(&mut assets, |asset| asset.id.as_str().to_owned());
        Ok(Response::new(v1::ListAssetsResponse {
            assets: assets.iter().map(asset_to_wire).collect(),
            next_page_token,
        }))
    }

    async fn delete_asset(
        &self,
        request: Request<v1::DeleteAssetRequest>,
    ) -> Result<Response<v1::DeleteAssetResponse>, Status> {
        let id = asset_id(&request.get_ref().name)?;
        let (store, now) = (self.store.clone(), self.clock.now());
        blocking(move || store.delete_asset(&id, now)).await?;
        Ok(Response::new(v1::DeleteAssetResponse {}))
    }

    async fn create_library_snapshot(
        &self,
        _: Request<v1::CreateLibrarySnapshotRequest>,
    ) -> Result<Response<v1::CreateLibrarySnapshotResponse>, Status> {
        let (store, now) = (self.store.clone(), self.clock.now());
        let snapshot = blocking(move || {
            let snapshot = store.create_snapshot(now)?;
            whole(&store, &snapshot)
        })
        .await?;
        Ok(Response::new(v1::CreateLibrarySnapshotResponse {
            library_snapshot: Some(snapshot),
        }))
    }

    async fn get_library_snapshot(
        &self,
        request: Request<v1::GetLibrarySnapshotRequest>,
    ) -> Result<Response<v1::GetLibrarySnapshotResponse>, Status> {
        let digest = snapshot_digest(&request.get_ref().name)?;
        let store = self.store.clone();
        let snapshot = blocking(move || {
            let snapshot = store.snapshot(&digest)?;
            whole(&store, &snapshot)
        })
        .await?;
        Ok(Response::new(v1::GetLibrarySnapshotResponse {
            library_snapshot: Some(snapshot),
        }))
    }

    async fn list_library_snapshots(
        &self,
        request: Request<v1::ListLibrarySnapshotsRequest>,
    ) -> Result<Response<v1::ListLibrarySnapshotsResponse>, Status> {
        let request = request.into_inner();
        let list = "librarySnapshots".to_owned();
        let page = Page::parse(request.page_size, &request.page_token, list)?;
        let (store, after, limit) = (self.store.clone(), page.after.clone(), page.read_limit());
        let mut snapshots = blocking(move || store.snapshots(&after, limit)).await?;
        let next_page_token = page.close(&mut snapshots, |found| found.digest.to_string());
        Ok(Response::new(v1::ListLibrarySnapshotsResponse {
            library_snapshots: snapshots.iter().map(named).collect(),
            next_page_token,
        }))
    }
}

fn asset_id(name: &str) -> Result<AssetId, Status> {
    name.parse().map_err(|e| invalid_field("name", e))
}

fn optional_log(name: &str) -> Result<Option<DriveLogId>, Status> {
    match name {
        "" => Ok(None),
        name => name
            .parse()
            .map(Some)
            .map_err(|e| invalid_field("source_log", e)),
    }
}

fn kind_from_wire(kind: i32) -> Result<Option<AssetKind>, Status> {
    match v1::AssetKind::try_from(kind) {
        Ok(v1::AssetKind::Unspecified) => Ok(None),
        Ok(v1::AssetKind::Background) => Ok(Some(AssetKind::Background)),
        Ok(v1::AssetKind::Object) => Ok(Some(AssetKind::Object)),
        Err(_) => Err(invalid_field("kind", format!("{kind} is not a kind"))),
    }
}

fn snapshot_digest(name: &str) -> Result<Digest, Status> {
    name.strip_prefix(SNAPSHOTS)
        .and_then(|digest| digest.parse().ok())
        .ok_or_else(|| invalid_field("name", "is not librarySnapshots/{digest}"))
}

/// A snapshot without its assets, as lists show it.
fn named(snapshot: &LibrarySnapshot) -> v1::LibrarySnapshot {
    v1::LibrarySnapshot {
        name: format!("{SNAPSHOTS}{}", snapshot.digest),
        assets: Vec::new(),
        create_time: Some(timestamp(snapshot.created_at)),
    }
}

fn whole(store: &Store, snapshot: &LibrarySnapshot) -> store::Result<v1::LibrarySnapshot> {
    let library = store.library(&snapshot.digest)?;
    Ok(v1::LibrarySnapshot {
        assets: library
            .entries
            .iter()
            .map(|entry| entry.asset.to_string())
            .collect(),
        ..named(snapshot)
    })
}
