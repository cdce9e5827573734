//! What an image shows of each object of its scene.

use glam::{DVec2, DVec3};

use super::composition::{Composition, PlacedObject};
use super::frame::RenderedFrame;
use super::lidar::count_returns;
use super::projection::{PixelBox, amodal_box};
use super::rle::column_runs;
use super::valid_region::ValidRegion;
use crate::camera::Rigid;

/// The view of one object in one frame.
#[derive(Clone, Debug, PartialEq)]
pub struct FrameLabel {
    pub instance_id: u16,
    /// Bounds of the near-clipped cuboid's projection, clipped to the image.
    pub amodal: Option<PixelBox>,
    /// Bounds of the instance's pixels.
    pub visible: PixelBox,
    /// At least 1: an object without a visible pixel has no label.
    pub visible_px: u32,
    /// Visible pixels over those the object would have alone in the image, 0..=1.
    pub visible_fraction: f64,
    /// Fraction of the amodal box outside the image, 0..=1.
    pub truncation: f64,
    /// Instance that hides most of it; 0 if none, or the background does.
    pub occluder: u16,
    /// Run lengths of the instance's pixels, see [`column_runs`].
    pub mask_runs: Vec<u32>,
    pub camera_from_object: Rigid,
    pub ego_from_object: Rigid,
    pub local_from_object: Rigid,
    /// In the local frame; `None` where the log does not tell.
    pub velocity_mps: Option<DVec3>,
    /// Returns that a 64-beam scanner at the ego would get from it (simulated).
    pub lidar_points: u32,
}

/// Labels of the objects that own at least one pixel, in the composition's order.
///
/// 3D poses and amodal boxes depend on the composition alone; the rest on the rendered frame.
pub fn label(
    composition: &Composition,
    region: &ValidRegion,
    frame: &RenderedFrame,
) -> Vec<FrameLabel> {
    let highest = composition.objects.iter().map(|o| o.instance_id).max();
    let slots = usize::from(highest.unwrap_or(0)) + 1;
    let owned = owned_pixels(frame, slots);
    let returns = count_returns(composition, region, frame, slots);
    let mut runs = column_runs(&frame.instance, frame.width as usize, slots);
    composition
        .objects
        .iter()
        .filter_map(|object| {
            let (bounds, visible_px) = owned[usize::from(object.instance_id)]?;
            let lidar_points = returns[usize::from(object.instance_id)];
            Some(FrameLabel {
                lidar_points,
                mask_runs: std::mem::take(&mut runs[usize::from(object.instance_id)]),
                ..label_of(composition, frame, object, bounds, visible_px)
            })
        })
        .collect()
}

fn label_of(
    composition: &Composition,
    frame: &RenderedFrame,
    object: &PlacedObject,
    visible: PixelBox,
    visible_px: u32,
) -> FrameLabel {
    let camera_from_object = composition.local_from_camera.inverse() * object.local_from_object;
    let bounds = amodal_box(&composition.camera, &camera_from_object, object.size_m);
    let id = object.instance_id;
    let alone = frame.alone_px.iter().find(|(i, _)| *i == id);
    let alone_px = alone.map_or(0, |(_, px)| *px).max(visible_px);
    FrameLabel {
        instance_id: id,
        amodal: bounds.and_then(|b| b.clipped(&composition.camera)),
        visible,
        visible_px,
        visible_fraction: f64::from(visible_px) / f64::from(alone_px),
        truncation: bounds.map_or(1.0, |b| b.truncation(&composition.camera)),
        occluder: occluder(frame, id),
        mask_runs: Vec::new(),
        camera_from_object,
        ego_from_object: composition.local_from_ego.inverse() * object.local_from_object,
        local_from_object: object.local_from_object,
        velocity_mps: object.velocity_mps,
        lidar_points: 0,
    }
}

/// Bounds and number of each instance's pixels.
fn owned_pixels(frame: &RenderedFrame, slots: usize) -> Vec<Option<(PixelBox, u32)>> {
    let mut owned: Vec<Option<(PixelBox, u32)>> = vec![None; slots];
    for (i, instance) in frame.instance.iter().enumerate() {
        if *instance == 0 {
            continue;
        }
        let column = i % frame.width as usize;
        let row = i / frame.width as usize;
        let min = DVec2::new(column as f64, row as f64);
        let max = min + 1.0;
        let slot = &mut owned[usize::from(*instance)];
        let (bounds, count) = slot.get_or_insert((PixelBox { min, max }, 0));
        bounds.min = bounds.min.min(min);
        bounds.max = bounds.max.max(max);
        *count += 1;
    }
    owned
}

fn occluder(frame: &RenderedFrame, id: u16) -> u16 {
    frame
        .hidden_px
        .range((id, 0)..=(id, u16::MAX))
        .max_by_key(|(_, px)| **px)
        .map_or(0, |((_, by), _)| *by)
}
