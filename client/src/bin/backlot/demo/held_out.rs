//! Held-out frames: rendered, written beside the recorded ones, and measured.

use std::fs;
use std::path::Path;

use anyhow::{Context, ensure};
use backlot_client::generator::{ExactFrame, RenderOptions, ShadowCasters, View, warp_by_depth};
use backlot_client::geometry::{rigid_to_wire, vector_from_wire};
use backlot_client::motion::track_pose_at;
use backlot_client::{Connection, Error};
use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use image::RgbImage;
use image::imageops::{self, FilterType};
use serde::Serialize;

use super::figures;
use super::library::Library;
use super::source::Source;
use crate::progress::Progress;

/// Recorded images larger than this are compared at an integer fraction of their size.
const MAX_LONGER_SIDE_PX: u32 = 960;

/// Room around a mover's cuboid for its shadow and mirror glints, in metres; only for logs without exact masks.
const MOVER_MARGIN_M: f64 = 0.3;

/// Depth figures: surfaces nearer than this, and the best share of them.
const DEPTH_RANGE_M: f32 = 50.0;
const DEPTH_SHARE: f64 = 0.95;

/// Figures of one held-out frame.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct HeldOutFrame {
    pub frame_index: u32,
    /// Over static pixels that are not sky (where the log tells sky).
    pub psnr: f64,
    /// Over every pixel that is not sky, movers replayed from their assets.
    pub psnr_with_movers: f64,
    /// Best neighbouring frame warped by exact depth, over the pixels of `psnr`; generated logs only.
    pub psnr_warp_baseline: Option<f64>,
    /// Mean absolute error of the distance against the exact one, best 95 %, up to 50 m; generated logs only.
    pub depth_mae_m: Option<f64>,
}

/// Renders every held-out frame of the background into `out/heldout` and measures it from the files.
pub(crate) async fn measure(
    connection: &Connection,
    source: &Source,
    library: &Library,
    out: &Path,
) -> anyhow::Result<Vec<HeldOutFrame>> {
    let quality = library.background.quality.clone().unwrap_or_default();
    let progress = Progress::count("held-out views", quality.held_out_frames.len() as u64);
    for folder in ["pred", "gt", "mask", "depth"] {
        fs::create_dir_all(out.join("heldout").join(folder))?;
    }
    let mut frames = Vec::new();
    for &frame_index in &quality.held_out_frames {
        let frame = source.frame(frame_index)?;
        let view = comparison_view(&source.view(frame)?);
        let rendered = render(connection, source, library, frame, &view).await?;
        let measured = tokio::task::block_in_place(|| {
            let held_out = HeldOut {
                source,
                library,
                frame,
                view: &view,
                out,
            };
            held_out.write_and_measure(&rendered)
        })?;
        frames.push(measured);
        progress.advance();
    }
    progress.finish(&format!("{} measured", frames.len()));
    Ok(frames)
}

/// The view at the recorded size, or at the largest integer fraction of it within the limit.
fn comparison_view(view: &View) -> View {
    let camera = &view.camera;
    let longer = camera.width.max(camera.height);
    let divisor = longer.div_ceil(MAX_LONGER_SIDE_PX).max(1);
    View {
        camera: camera.resized(
            camera.width.div_ceil(divisor),
            camera.height.div_ceil(divisor),
        ),
        ..*view
    }
}

/// The background with every mover that has an asset at its recorded pose.
async fn render(
    connection: &Connection,
    source: &Source,
    library: &Library,
    frame: &v1::CameraFrame,
    view: &View,
) -> anyhow::Result<v1::SampleFrame> {
    let tracks = &source.log.drive_log.tracks;
    let movers = tracks
        .iter()
        .filter(|t| library.moving.contains(&t.track_id));
    let objects = movers.filter_map(|track| {
        let pose = track_pose_at(track, frame.timestamp_ns)?;
        let mut assets = library.objects.iter();
        let asset = assets.find(|asset| asset.source_track_id == track.track_id)?;
        Some(v1::PlacedObject {
            asset: asset.name.clone(),
            world_from_object: Some(rigid_to_wire(&pose)),
        })
    });
    let request = v1::RenderSceneRequest {
        background: library.background.name.clone(),
        objects: objects.collect(),
        view: Some(wire_view(view)),
        omit_instance: true,
        ..Default::default()
    };
    render_scene(connection, request, frame.frame_index).await
}

/// Renders one explicit scene.
pub(crate) async fn render_scene(
    connection: &Connection,
    request: v1::RenderSceneRequest,
    frame_index: u32,
) -> anyhow::Result<v1::SampleFrame> {
    let reply = connection.samples().render_scene(request).await;
    let doing = format!("rendering held-out frame {frame_index}");
    let reply = reply.map_err(|status| Error::from_status(&doing, status))?;
    let sample = reply
        .into_inner()
        .sample
        .context("the reply holds no sample")?;
    sample
        .frames
        .into_iter()
        .next()
        .context("the sample holds no frame")
}

pub(crate) fn wire_view(view: &View) -> v1::CameraView {
    let camera = &view.camera;
    v1::CameraView {
        width: camera.width,
        height: camera.height,
        focal_x_px: camera.focal_px.x,
        focal_y_px: camera.focal_px.y,
        principal_x_px: camera.principal_px.x,
        principal_y_px: camera.principal_px.y,
        world_from_camera: Some(rigid_to_wire(&view.world_from_camera)),
    }
}

struct HeldOut<'a> {
    source: &'a Source,
    library: &'a Library,
    frame: &'a v1::CameraFrame,
    view: &'a View,
    out: &'a Path,
}

impl HeldOut<'_> {
    fn write_and_measure(&self, rendered: &v1::SampleFrame) -> anyhow::Result<HeldOutFrame> {
        let path = |folder: &str| {
            let name = format!("{:06}.png", self.frame.frame_index);
            self.out.join("heldout").join(folder).join(name)
        };
        let (width, height) = (self.view.camera.width, self.view.camera.height);
        fs::write(path("pred"), &rendered.image_png)?;
        fs::write(path("depth"), &rendered.depth_png)?;
        let recorded = self.source.image(self.frame)?;
        let recorded = if recorded.dimensions() == (width, height) {
            recorded
        } else {
            imageops::resize(&recorded, width, height, FilterType::Triangle)
        };
        recorded.save(path("gt"))?;
        let exact = self.exact()?;
        let not_sky = exact.as_ref().map_or_else(
            || vec![true; (width * height) as usize],
            |exact| exact.sky.iter().map(|sky| !sky).collect(),
        );
        let movers = match &exact {
            Some(exact) => self.exact_movers(exact),
            None => self.projected_movers(),
        };
        let counted: Vec<bool> = not_sky.iter().zip(&movers).map(|(n, m)| *n && !m).collect();
        figures::mask_image(width, height, &counted).save(path("mask"))?;
        let counted = figures::read_mask(&path("mask"))?;
        let psnr = |mask: &[bool]| figures::psnr_of_files(&path("pred"), &path("gt"), |i| mask[i]);
        let baseline = match &exact {
            Some(exact) => Some(self.warp_baseline(exact, &recorded, &counted)?),
            None => None,
        };
        let depth_mae_m = match &exact {
            Some(exact) => {
                let depth = figures::read_luma16(&path("depth"))?;
                let depth_z_m = depth
                    .pixels()
                    .map(|p| f64::from(p.0[0]) * rendered.depth_unit_m);
                self.depth_error(&depth_z_m.collect::<Vec<_>>(), exact, &counted)
            }
            None => None,
        };
        Ok(HeldOutFrame {
            frame_index: self.frame.frame_index,
            psnr: psnr(&counted)?,
            psnr_with_movers: psnr(&not_sky)?,
            psnr_warp_baseline: baseline,
            depth_mae_m,
        })
    }

    /// Depth, instances and sky of the frame; only of a generated log.
    fn exact(&self) -> anyhow::Result<Option<ExactFrame>> {
        let Some(street) = &self.source.street else {
            return Ok(None);
        };
        let options = RenderOptions {
            // Colours come from the recorded image.
            supersample: 1,
            shadow_casters: ShadowCasters::None,
        };
        let actors = street.actors_at(self.frame.timestamp_ns);
        Ok(Some(street.render(self.view, &actors, &options)?))
    }

    fn exact_movers(&self, exact: &ExactFrame) -> Vec<bool> {
        let tracks = &self.source.log.drive_log.tracks;
        let moves = |id: &str| self.library.moving.contains(id);
        let moving: Vec<bool> = tracks.iter().map(|t| moves(&t.track_id)).collect();
        let instances = exact.instance.iter();
        instances
            .map(|&i| i > 0 && moving.get(usize::from(i) - 1).copied().unwrap_or(false))
            .collect()
    }

    /// Pixels whose ray meets the padded cuboid of a mover.
    fn projected_movers(&self) -> Vec<bool> {
        let camera = &self.view.camera;
        let tracks = &self.source.log.drive_log.tracks;
        let moving = tracks
            .iter()
            .filter(|t| self.library.moving.contains(&t.track_id));
        let boxes: Vec<(Rigid, DVec3)> = moving
            .filter_map(|track| {
                let pose = track_pose_at(track, self.frame.timestamp_ns)?;
                let half = vector_from_wire(track.size_m.as_ref()) / 2.0 + MOVER_MARGIN_M;
                Some((pose.inverse() * self.view.world_from_camera, half))
            })
            .collect();
        let pixels = (0..camera.height).flat_map(|y| (0..camera.width).map(move |x| (x, y)));
        pixels
            .map(|(x, y)| {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let ray = camera.direction(pixel);
                boxes
                    .iter()
                    .any(|(cuboid_from_camera, half)| meets(cuboid_from_camera, ray, *half))
            })
            .collect()
    }

    /// The better neighbour among the recorded frames before and after, warped with exact depth.
    fn warp_baseline(
        &self,
        exact: &ExactFrame,
        recorded: &RgbImage,
        counted: &[bool],
    ) -> anyhow::Result<f64> {
        let mut best = f64::NAN;
        for neighbour in [
            self.frame.frame_index.wrapping_sub(1),
            self.frame.frame_index + 1,
        ] {
            let Ok(neighbour) = self.source.frame(neighbour) else {
                continue;
            };
            let image = self.source.image(neighbour)?;
            ensure!(
                image.dimensions() == recorded.dimensions(),
                "frames differ in size"
            );
            let photograph = ExactFrame {
                rgb8: image.into_raw(),
                ..exact.clone()
            };
            let view = self.source.view(neighbour)?;
            let warped = warp_by_depth((&view, &photograph), (self.view, exact));
            let psnr = backlot_client::generator::psnr(&warped, recorded.as_raw(), |i| counted[i]);
            best = best.max(psnr);
        }
        Ok(best)
    }

    fn depth_error(&self, depth_z_m: &[f64], exact: &ExactFrame, counted: &[bool]) -> Option<f64> {
        let camera = &self.view.camera;
        let mut errors: Vec<f64> = Vec::new();
        for (i, (got, want)) in depth_z_m.iter().zip(&exact.depth_z_m).enumerate() {
            if !counted[i] {
                continue;
            }
            let (x, y) = (i as u32 % exact.width, i as u32 / exact.width);
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let range_per_z = 1.0 / camera.direction(pixel).z;
            if *want * range_per_z as f32 <= DEPTH_RANGE_M {
                errors.push((got - f64::from(*want)).abs() * range_per_z);
            }
        }
        errors.sort_by(f64::total_cmp);
        errors.truncate((errors.len() as f64 * DEPTH_SHARE) as usize);
        figures::mean(errors)
    }
}

/// Slab test of a ray from the camera against a centred box of half extents `half`.
fn meets(cuboid_from_camera: &Rigid, ray: DVec3, half: DVec3) -> bool {
    let origin = cuboid_from_camera.translation_m;
    let direction = cuboid_from_camera.direction(ray);
    let (mut near, mut far) = (0.0f64, f64::INFINITY);
    for axis in 0..3 {
        let a = (-half[axis] - origin[axis]) / direction[axis];
        let b = (half[axis] - origin[axis]) / direction[axis];
        near = near.max(a.min(b));
        far = far.min(a.max(b));
    }
    near <= far
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_meet_boxes_ahead_only() {
        let half = DVec3::ONE;
        let ahead = Rigid::new(Default::default(), DVec3::new(0.0, 0.0, -5.0));
        let behind = Rigid::new(Default::default(), DVec3::new(0.0, 0.0, 5.0));
        assert!(meets(&ahead, DVec3::new(0.05, 0.0, 1.0).normalize(), half));
        assert!(!meets(&ahead, DVec3::new(0.5, 0.0, 1.0).normalize(), half));
        assert!(!meets(
            &behind,
            DVec3::new(0.05, 0.0, 1.0).normalize(),
            half
        ));
    }
}
