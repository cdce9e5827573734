//! A finished sample: encoded planes and labels in the log's world frame.

use std::collections::BTreeMap;

use backlot_engine::backend::Backend;
use backlot_engine::backend::cpu::Simd;
use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::class::ObjectClass;
use backlot_engine::scene::{
    Daylight, FrameLabel, ObjectLight, Origin, PlacedObject, Relit, RenderedFrame, Tone,
};
use bytes::Bytes;
use glam::DVec3;

use super::encode::{depth_png, grey_png, instance_png, rgb_png};
use super::error::Result;
use super::recipe_samples::Planes;

/// Metres of one step of the depth image: 4 mm up to 256 m.
pub const DEPTH_UNIT_M: f64 = 1.0 / 256.0;

/// The frames of a sample, in the order of time, and what they share.
#[derive(Clone, Debug)]
pub struct Sample {
    pub frames: Vec<SampleFrame>,
    /// The log's world from the local frame of the labels.
    pub world_from_local: Rigid,
    /// Every object that was placed, and the static ones that can be seen.
    pub boxes: Vec<SampleBox>,
    pub rejections: BTreeMap<String, u32>,
    /// Shadows of inserted objects were rendered.
    pub insert_shadows: bool,
    /// The sunlight of shadows and objects, its direction in the log's world frame.
    pub daylight: Option<Daylight>,
    /// The background or any object was trained on synthetic images.
    pub synthetic: bool,
    /// An object that is only good near its recorded poses is in the sample.
    pub has_replay_only: bool,
    /// See [`render_class`].
    pub render_class: String,
}

/// One frame with everything that is known about it.
#[derive(Clone, Debug)]
pub struct SampleFrame {
    pub camera_id: String,
    pub timestamp_ns: i64,
    pub frame_index: u32,
    pub camera: Camera,
    pub world_from_camera: Rigid,
    pub world_from_ego: Rigid,
    pub image_png: Bytes,
    /// Empty if left out.
    pub depth_png: Bytes,
    pub instance_png: Bytes,
    /// Empty if no pixel is to be ignored.
    pub ignore_png: Bytes,
    /// Pixels made up from their surroundings, all of them ignored.
    pub filled_px: u32,
    /// Views of the boxes that can be seen.
    pub labels: Vec<FrameLabel>,
}

/// One object of a sample.
#[derive(Clone, Debug)]
pub struct SampleBox {
    pub instance_id: u16,
    pub origin: Origin,
    pub class: ObjectClass,
    /// At the first frame that holds it.
    pub world_from_object: Rigid,
    pub size_m: DVec3,
    pub track_id: String,
    pub beyond_coverage: bool,
    /// How its colours were matched to the frame.
    pub tone: Option<Tone>,
    /// How it was moved into the light of its place.
    pub relit: Option<Relit>,
    /// `None` for static originals.
    pub object: Option<SampleObject>,
}

/// The asset that was rendered.
#[derive(Clone, Debug)]
pub struct SampleObject {
    pub asset: String,
    pub source_log: String,
    pub source_track_id: String,
}

/// The encoded planes of a frame: image, depth, instance, ignore.
pub(super) fn encode_planes(
    frame: &RenderedFrame,
    ignore: Option<&[u8]>,
    planes: Planes,
) -> Result<[Bytes; 4]> {
    let (width, height) = (frame.width, frame.height);
    let depth = match planes.depth {
        true => depth_png(&frame.depth_z_m, width, height)?,
        false => Bytes::new(),
    };
    let instance = match planes.instance {
        true => instance_png(&frame.instance, width, height)?,
        false => Bytes::new(),
    };
    let ignore = match ignore {
        Some(mask) => grey_png(mask, width, height)?,
        None => Bytes::new(),
    };
    Ok([
        rgb_png(&frame.rgb8, width, height)?,
        depth,
        instance,
        ignore,
    ])
}

/// How objects' colours were changed, by instance id.
#[derive(Debug, Default)]
pub(super) struct Matched {
    pub tones: Vec<(u16, Tone)>,
    pub lights: Vec<ObjectLight>,
}

/// One frame of a sample as its boxes are gathered: the objects in it, the views of those that can be seen, and how their
/// colours were changed.
pub(super) struct FrameObjects<'a> {
    pub objects: &'a [PlacedObject],
    pub labels: &'a [FrameLabel],
    pub matched: &'a Matched,
}

/// The boxes of the objects in any frame, in the order in which they come; static ones only where a label says that they can be seen.
pub(super) fn boxes(
    frames: &[FrameObjects<'_>],
    world_from_local: &Rigid,
    object_of: impl Fn(usize) -> SampleObject,
) -> Vec<SampleBox> {
    let mut boxes: Vec<SampleBox> = Vec::new();
    for frame in frames {
        let is_labelled = |id: u16| frame.labels.iter().any(|label| label.instance_id == id);
        for o in frame.objects {
            if o.origin == Origin::Static && !is_labelled(o.instance_id) {
                continue;
            }
            if let Some(known) = boxes.iter_mut().find(|b| b.instance_id == o.instance_id) {
                known.beyond_coverage |= o.beyond_coverage;
                continue;
            }
            let Matched { tones, lights } = frame.matched;
            let tone = tones.iter().find(|(id, _)| *id == o.instance_id);
            let light = lights.iter().find(|l| l.instance_id == o.instance_id);
            boxes.push(SampleBox {
                instance_id: o.instance_id,
                origin: o.origin,
                class: o.class,
                world_from_object: *world_from_local * o.local_from_object,
                size_m: o.size_m,
                track_id: o.track_id.clone().unwrap_or_default(),
                beyond_coverage: o.beyond_coverage,
                tone: tone.map(|(_, tone)| *tone),
                relit: light.map(ObjectLight::relit),
                object: o.asset.map(&object_of),
            });
        }
    }
    boxes
}

/// Pixels are equal within one class: build, backend, and instruction set or GPU with its driver.
pub(super) fn render_class(backend: &dyn Backend) -> String {
    let version = env!("CARGO_PKG_VERSION");
    if backend.name() != "cpu" {
        return format!("backlot-{version} {} {}", backend.name(), backend.device());
    }
    let simd = match Simd::detect() {
        Simd::Baseline => "baseline",
        Simd::Avx2 => "avx2",
        Simd::Avx512 => "avx512",
    };
    format!("backlot-{version} cpu {} {simd}", std::env::consts::ARCH)
}
