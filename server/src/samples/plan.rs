//! A sample that is composed and not rendered.

use std::collections::BTreeMap;

use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::scene::{Candidate, Composition, Stage};

use super::recipe_samples::object_of;
use super::sample::SampleBox;

/// Where things would stand, in the log's world frame.
#[derive(Clone, Debug)]
pub struct SamplePlan {
    pub camera_id: String,
    pub frame_index: u32,
    pub camera: Camera,
    pub world_from_camera: Rigid,
    pub world_from_ego: Rigid,
    /// Every object in view, whether or not the image would show it.
    pub boxes: Vec<SampleBox>,
    pub rejections: BTreeMap<String, u32>,
}

pub(super) fn plan_of(
    stage: &Stage<'_>,
    composition: Composition,
    candidates: &[Candidate],
    world_from_local: &Rigid,
) -> SamplePlan {
    let recorded = &stage.recording.frames[composition.frame];
    let boxes = composition.objects.iter().map(|object| SampleBox {
        instance_id: object.instance_id,
        origin: object.origin,
        class: object.class,
        world_from_object: *world_from_local * object.local_from_object,
        size_m: object.size_m,
        track_id: object.track_id.clone().unwrap_or_default(),
        beyond_coverage: object.beyond_coverage,
        tone: None,
        relit: None,
        object: object.asset.map(|asset| object_of(&candidates[asset])),
    });
    SamplePlan {
        camera_id: recorded.camera_id.clone(),
        frame_index: recorded.frame_index,
        camera: composition.camera,
        world_from_camera: *world_from_local * composition.local_from_camera,
        world_from_ego: *world_from_local * composition.local_from_ego,
        boxes: boxes.collect(),
        rejections: composition.rejections,
    }
}
