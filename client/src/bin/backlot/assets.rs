//! `backlot assets`.

use anyhow::Context;
use backlot_client::download::download_blob;
use backlot_client::geometry::vector_from_wire;
use backlot_client::{Connection, listing, names};
use backlot_proto::v1;
use serde::Serialize;

use crate::args::{AssetKind, AssetsCommand, Output};
use crate::output::{self, Row, measured};

pub(crate) async fn run(
    connection: &Connection,
    command: AssetsCommand,
    output: Output,
) -> anyhow::Result<()> {
    match command {
        AssetsCommand::List { kind, log } => {
            let kind = match kind {
                None => v1::AssetKind::Unspecified,
                Some(AssetKind::Background) => v1::AssetKind::Background,
                Some(AssetKind::Object) => v1::AssetKind::Object,
            };
            let log = log.map(|log| names::drive_log(&log)).transpose()?;
            let assets = listing::assets(connection, kind, &log.unwrap_or_default()).await?;
            output::print(
                output,
                &assets.iter().map(AssetRow::new).collect::<Vec<_>>(),
            )
        }
        AssetsCommand::Show { asset } => {
            let asset = get(connection, &names::asset(&asset)?).await?;
            show(&AssetRow::new(&asset), output)
        }
        AssetsCommand::Export { asset, out } => {
            let asset = get(connection, &names::asset(&asset)?).await?;
            let payload = asset.payload.clone().context("the asset has no payload")?;
            download_blob(connection, &payload, &out).await?;
            eprintln!("{} written to {}", asset.name, out.display());
            Ok(())
        }
        AssetsCommand::Delete { asset } => {
            let name = names::asset(&asset)?;
            let request = v1::DeleteAssetRequest { name: name.clone() };
            let reply = connection.assets().delete_asset(request).await;
            let doing = format!("deleting {name}");
            reply.map_err(|status| backlot_client::Error::from_status(&doing, status))?;
            eprintln!("{name} deleted");
            Ok(())
        }
    }
}

async fn get(connection: &Connection, name: &str) -> anyhow::Result<v1::Asset> {
    let request = v1::GetAssetRequest {
        name: name.to_owned(),
    };
    let reply = connection.assets().get_asset(request).await;
    let doing = format!("reading {name}");
    let reply = reply.map_err(|status| backlot_client::Error::from_status(&doing, status))?;
    reply.into_inner().asset.context("the reply holds no asset")
}

fn show(row: &AssetRow, output: Output) -> anyhow::Result<()> {
    if output == Output::Json {
        return output::print(output, std::slice::from_ref(row));
    }
    // Field by field, as the record has more of them than a line has room for.
    if let serde_json::Value::Object(fields) = serde_json::to_value(row)? {
        for (field, value) in fields {
            println!("{field:24} {}", value.to_string().trim_matches('"'));
        }
    }
    Ok(())
}

/// An asset as scripts see it.
#[derive(Serialize)]
pub(crate) struct AssetRow {
    name: String,
    kind: &'static str,
    usage: &'static str,
    usage_reason: String,
    class: Option<String>,
    size_m: Option<[f64; 3]>,
    source_log: String,
    source_track_id: Option<String>,
    job: String,
    psnr_held_out: Option<f64>,
    ssim_held_out: Option<f64>,
    depth_mae_m: Option<f64>,
    train_views: u32,
    held_out_views: u32,
    train_seconds: f64,
    voxel_size_m: f64,
    synthetic: bool,
    bytes: u64,
    payload_digest: String,
    warnings: Vec<String>,
    created: Option<String>,
}

impl AssetRow {
    pub(crate) fn new(asset: &v1::Asset) -> Self {
        let quality = asset.quality.clone().unwrap_or_default();
        let payload = asset.payload.clone().unwrap_or_default();
        let is_object = asset.kind() == v1::AssetKind::Object;
        let class = asset.object_class().as_str_name();
        let track = &asset.source_track_id;
        Self {
            name: asset.name.clone(),
            kind: asset.kind().as_str_name().trim_start_matches("ASSET_KIND_"),
            usage: asset
                .usage()
                .as_str_name()
                .trim_start_matches("ASSET_USAGE_"),
            usage_reason: asset.usage_reason.clone(),
            class: is_object.then(|| class.trim_start_matches("OBJECT_CLASS_").to_owned()),
            size_m: is_object.then(|| vector_from_wire(asset.size_m.as_ref()).to_array()),
            source_log: asset.source_log.clone(),
            source_track_id: (!track.is_empty()).then(|| track.clone()),
            job: asset.job.clone(),
            psnr_held_out: measured(quality.psnr_held_out),
            ssim_held_out: measured(quality.ssim_held_out),
            depth_mae_m: measured(quality.depth_mae_m),
            train_views: quality.train_views,
            held_out_views: quality.held_out_views,
            train_seconds: quality.train_seconds,
            voxel_size_m: quality.voxel_size_m,
            synthetic: asset.synthetic,
            bytes: payload.size_bytes,
            payload_digest: payload.digest,
            warnings: quality.warnings,
            created: asset.create_time.map(|t| t.to_string()),
        }
    }
}

impl Row for AssetRow {
    const COLUMNS: &'static [&'static str] = &[
        "NAME",
        "KIND",
        "CLASS",
        "USAGE",
        "LOG",
        "TRACK",
        "PSNR",
        "DEPTH ERROR",
        "SIZE",
        "CREATED",
    ];

    fn cells(&self) -> Vec<String> {
        vec![
            names::id(&self.name).to_owned(),
            self.kind.to_owned(),
            self.class.clone().unwrap_or_else(|| "-".to_owned()),
            self.usage.to_owned(),
            names::id(&self.source_log).to_owned(),
            output::or_dash(self.source_track_id.as_deref().unwrap_or("")),
            output::figure(self.psnr_held_out, 2),
            output::figure(self.depth_mae_m, 3),
            output::mebibytes(self.bytes),
            self.created.clone().unwrap_or_default(),
        ]
    }
}
