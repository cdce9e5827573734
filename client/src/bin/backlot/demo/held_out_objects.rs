//! Held-out views of objects: rendered alone, written beside the recorded image, and measured inside the exact mask.

use std::fs;
use std::path::Path;

use anyhow::Context;
use backlot_client::generator::{RenderOptions, ShadowCasters, StreetWorld};
use backlot_client::geometry::rigid_to_wire;
use backlot_client::motion::track_pose_at;
use backlot_client::{Connection, names};
use backlot_proto::v1;
use image::RgbImage;

use super::figures;
use super::held_out::{render_scene, wire_view};
use super::source::Source;

/// An object with fewer visible pixels than this says nothing about its field.
const MIN_PIXELS: usize = 150;

/// Mean PSNR of an object of a generated log over its held-out frames, in `out/heldout_objects/<asset>`; `None` if it has none.
pub(crate) async fn measure(
    connection: &Connection,
    source: &Source,
    street: &StreetWorld,
    asset: &v1::Asset,
    out: &Path,
) -> anyhow::Result<Option<f64>> {
    let tracks = &source.log.drive_log.tracks;
    let index = tracks
        .iter()
        .position(|t| t.track_id == asset.source_track_id);
    let index = index.context("an asset's track is not in the log")?;
    let folder = out.join("heldout_objects").join(names::id(&asset.name));
    for part in ["pred", "gt", "mask"] {
        fs::create_dir_all(folder.join(part))?;
    }
    let mut figures_db = Vec::new();
    for &frame_index in &asset.quality.clone().unwrap_or_default().held_out_frames {
        let frame = source.frame(frame_index)?;
        let view = source.view(frame)?;
        let Some(pose) = track_pose_at(&tracks[index], frame.timestamp_ns) else {
            continue;
        };
        let options = RenderOptions {
            supersample: 1,
            shadow_casters: ShadowCasters::None,
        };
        let exact = tokio::task::block_in_place(|| {
            street.render(&view, &street.actors_at(frame.timestamp_ns), &options)
        })?;
        let mask: Vec<bool> = exact
            .instance
            .iter()
            .map(|i| usize::from(*i) == index + 1)
            .collect();
        if mask.iter().filter(|set| **set).count() < MIN_PIXELS {
            continue;
        }
        let request = v1::RenderSceneRequest {
            objects: vec![v1::PlacedObject {
                asset: asset.name.clone(),
                world_from_object: Some(rigid_to_wire(&pose)),
            }],
            view: Some(wire_view(&view)),
            omit_depth: true,
            omit_instance: true,
            ..Default::default()
        };
        let rendered = render_scene(connection, request, frame_index).await?;
        let path = |part: &str| folder.join(part).join(format!("{frame_index:06}.png"));
        fs::write(path("pred"), &rendered.image_png)?;
        let recorded: RgbImage = source.image(frame)?;
        recorded.save(path("gt"))?;
        figures::mask_image(view.camera.width, view.camera.height, &mask).save(path("mask"))?;
        let mask = figures::read_mask(&path("mask"))?;
        figures_db.push(figures::psnr_of_files(&path("pred"), &path("gt"), |i| {
            mask[i]
        })?);
    }
    Ok(figures::mean(figures_db))
}
