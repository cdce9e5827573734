//! `backlot assets`.

use std::fmt;

use anyhow::Context;
use backlot_client::download::download_blob;
use backlot_client::geometry::vector_from_wire;
use backlot_client::{Connection, listing, names};
use backlot_proto::v1;
use serde::Serialize;

use crate::args::{AssetKind, AssetsCommand, Output};
use crate::output::{self, Row, measured};
use crate::valid_region;

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
        AssetsCommand::ValidRegion(options) => valid_region::run(connection, &options).await,
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

pub(crate) async fn get(connection: &Connection, name: &str) -> anyhow::Result<v1::Asset> {
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
        for (field, value) in fields.into_iter().filter(|f| f.0 != "seen_from") {
            println!("{field:24} {}", value.to_string().trim_matches('"'));
        }
    }
    let sectors: Vec<String> = row.seen_from.iter().map(Sector::to_string).collect();
    if !sectors.is_empty() {
        println!("{:24} {}", "seen_from", sectors.join(", "));
    }
    Ok(())
}

/// One of the 15-degree sectors from which an object was seen.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
struct Sector {
    /// Where the sector begins; 0 is the object's front, turning left.
    azimuth_deg: u32,
    views: u32,
    /// Only the mirror image was seen from here.
    mirrored: bool,
}

impl fmt::Display for Sector {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.mirrored {
            true => write!(f, "{} deg: mirrored", self.azimuth_deg),
            false => write!(f, "{} deg: {} views", self.azimuth_deg, self.views),
        }
    }
}

/// The sectors that were seen, directly or mirrored.
fn seen_from(quality: &v1::QualityReport) -> Vec<Sector> {
    let count = quality.azimuth_histogram.len().max(1) as u32;
    let mirrored = |at: usize| quality.azimuth_mirrored.get(at).is_some_and(|m| *m);
    let sectors = quality.azimuth_histogram.iter().enumerate();
    sectors
        .filter(|(at, views)| **views > 0 || mirrored(*at))
        .map(|(at, views)| Sector {
            azimuth_deg: at as u32 * 360 / count,
            views: *views,
            mirrored: *views == 0,
        })
        .collect()
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
    held_out_frames: Vec<u32>,
    accumulation_in_mask: Option<f64>,
    halo: Option<f64>,
    seen_from: Vec<Sector>,
    image_size_px: Option<[u32; 2]>,
    train_seconds: f64,
    train_rays: u64,
    peak_rss_bytes: Option<u64>,
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
            accumulation_in_mask: is_object
                .then(|| measured(quality.accumulation_in_mask))
                .flatten(),
            halo: is_object.then(|| measured(quality.halo)).flatten(),
            seen_from: seen_from(&quality),
            image_size_px: (quality.image_width_px > 0)
                .then_some([quality.image_width_px, quality.image_height_px]),
            held_out_frames: quality.held_out_frames,
            train_seconds: quality.train_seconds,
            train_rays: quality.train_rays,
            peak_rss_bytes: (quality.peak_rss_bytes > 0).then_some(quality.peak_rss_bytes),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_objects_whole_report_is_shown_and_mirrored_sectors_are_marked() {
        let mut histogram = vec![0; 24];
        let mut mirrored = vec![false; 24];
        (histogram[1], mirrored[22]) = (4, true);
        let asset = v1::Asset {
            kind: v1::AssetKind::Object.into(),
            quality: Some(v1::QualityReport {
                halo: 0.125,
                accumulation_in_mask: 0.97,
                azimuth_histogram: histogram,
                azimuth_mirrored: mirrored,
                held_out_frames: vec![4, 12],
                peak_rss_bytes: 1 << 30,
                train_rays: 77,
                ..Default::default()
            }),
            ..Default::default()
        };
        let row = AssetRow::new(&asset);
        let shown: Vec<String> = row.seen_from.iter().map(Sector::to_string).collect();
        assert_eq!(shown, ["15 deg: 4 views", "330 deg: mirrored"]);
        let json = serde_json::to_value(&row).unwrap();
        let figures = [
            "halo",
            "accumulation_in_mask",
            "peak_rss_bytes",
            "train_rays",
        ];
        assert!(
            figures.iter().all(|figure| json[figure].is_number()),
            "{json}"
        );
        assert_eq!(json["held_out_frames"], serde_json::json!([4, 12]));
        assert_eq!(json["seen_from"][1]["mirrored"], true);
    }
}
