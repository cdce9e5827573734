//! A scene whose objects are given explicitly. No placement is checked besides finiteness.

use std::sync::Arc;

use backlot_engine::Asset;
use backlot_engine::asset::{AssetKind, Usage};
use backlot_engine::backend::Backend;
use backlot_engine::camera::{Camera, Rigid};
use backlot_engine::scene::{
    Composition, Daylight, MAX_OBJECTS, Origin, PlacedObject, Recording, RenderOptions, Scene,
    SceneObject, Tone, ValidRegion, cast_shadows, label, shadow_casters,
};
use glam::{DQuat, DVec2};

use super::cache::AssetCache;
use super::error::{Error, Result};
use super::library;
use super::recipe_samples::Planes;
use super::sample::{
    FrameObjects, Matched, Sample, SampleFrame, SampleObject, boxes, encode_planes, render_class,
};
use crate::domain::blob::Digest;
use crate::domain::ids::AssetId;

#[derive(Clone, Debug)]
pub struct SceneRequest {
    /// `None` renders the objects over transparent black.
    pub background: Option<AssetId>,
    pub objects: Vec<SceneObjectRequest>,
    pub camera: Camera,
    pub world_from_camera: Rigid,
    pub insert_shadows: bool,
    pub planes: Planes,
}

#[derive(Clone, Debug)]
pub struct SceneObjectRequest {
    pub asset: AssetId,
    pub world_from_object: Rigid,
}

/// Turns the camera frame (x right, y down, z forward) into one with x forward, y left, z up.
const CAMERA_FROM_FORWARD: DQuat = DQuat::from_xyzw(0.5, -0.5, 0.5, 0.5);

/// Renders the scene from the present library; returns the library's digest with the sample. Its ego frame is at the camera.
///
/// # Errors
/// Unknown assets, assets of the wrong kind, too many objects, a camera or pose out of range, cancellation.
pub fn render_scene(
    cache: &AssetCache,
    request: &SceneRequest,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<(Digest, Sample)> {
    if request.objects.len() > MAX_OBJECTS as usize {
        return Err(Error::Invalid {
            what: format!("{} objects, at most {MAX_OBJECTS}", request.objects.len()),
        });
    }
    let library = library::resolve(cache, None)?;
    let load = |id: &AssetId, kind: AssetKind| -> Result<Arc<Asset>> {
        let asset = library::load(cache, &library, id)?;
        if asset.header.kind == kind {
            return Ok(asset);
        }
        Err(Error::Invalid {
            what: format!("{id} is not of kind {kind:?}"),
        })
    };
    let background = match &request.background {
        Some(id) => Some(load(id, AssetKind::Background)?),
        None => None,
    };
    let assets = request
        .objects
        .iter()
        .map(|o| load(&o.asset, AssetKind::Object))
        .collect::<Result<Vec<_>>>()?;
    // Without a background the camera anchors the local frame, where f32 is exact.
    let local_from_world = match &background {
        Some(asset) => asset.header.local_from_world,
        None => Rigid::new(DQuat::IDENTITY, -request.world_from_camera.translation_m),
    };
    let composition = composition(request, background.as_deref(), &assets, &local_from_world);
    let eye = composition.local_from_camera.translation_m;
    let holds_camera = |object: &PlacedObject| object.occupied().contains(eye);
    if let Some(i) = composition.objects.iter().position(holds_camera) {
        return Err(Error::Invalid {
            what: format!(
                "objects[{i}] ({}): the camera is inside it",
                request.objects[i].asset
            ),
        });
    }
    let sample = finish(
        cache.backend(),
        request,
        background.as_deref(),
        &assets,
        &composition,
        &local_from_world,
        cancelled,
    )?;
    Ok((library.digest, sample))
}

fn composition(
    request: &SceneRequest,
    background: Option<&Asset>,
    assets: &[Arc<Asset>],
    local_from_world: &Rigid,
) -> Composition {
    let local_from_camera = *local_from_world * request.world_from_camera;
    let objects = request.objects.iter().zip(assets).enumerate();
    Composition {
        frame: 0,
        camera: request.camera,
        local_from_camera,
        local_from_ego: local_from_camera * Rigid::new(CAMERA_FROM_FORWARD, glam::DVec3::ZERO),
        objects: objects
            .map(|(i, (object, asset))| PlacedObject {
                instance_id: i as u16 + 1,
                origin: Origin::Inserted,
                class: asset.header.class,
                size_m: asset.header.size_m,
                local_from_object: *local_from_world * object.world_from_object,
                asset: Some(i),
                track_id: None,
                beyond_coverage: false,
                velocity_mps: None,
            })
            .collect(),
        left_out: Vec::new(),
        rejections: Default::default(),
        insert_shadows: request.insert_shadows,
        daylight: background
            .and_then(|asset| asset.header.recording.as_ref())
            .and_then(Recording::light),
    }
}

fn finish(
    backend: &dyn Backend,
    request: &SceneRequest,
    background: Option<&Asset>,
    assets: &[Arc<Asset>],
    composition: &Composition,
    local_from_world: &Rigid,
    cancelled: &(dyn Fn() -> bool + Sync),
) -> Result<Sample> {
    let scene = Scene {
        background: background.map(|asset| &asset.field),
        objects: composition
            .objects
            .iter()
            .zip(assets)
            .map(|(object, asset)| SceneObject {
                instance_id: object.instance_id,
                field: &asset.field,
                local_from_object: object.local_from_object,
                size_m: object.size_m,
                tone: Tone::IDENTITY,
            })
            .collect(),
        statics: Vec::new(),
        camera: composition.camera,
        local_from_camera: composition.local_from_camera,
    };
    let mut frame = backend.render(&scene, &RenderOptions::default(), cancelled)?;
    if request.insert_shadows {
        // All of them are inserts.
        let casters = shadow_casters(composition, false);
        let shown = vec![0.0; frame.placed_alpha.len()];
        let daylight = composition.daylight.as_ref();
        cast_shadows(&scene, &casters, daylight, &shown, &mut frame);
    }
    let nowhere = ValidRegion::unseen(DVec2::ZERO, 1.0, 0, 0);
    let region = background.and_then(|asset| asset.header.valid_region.as_ref());
    let labels = label(composition, region.unwrap_or(&nowhere), &frame);
    let [image_png, depth_png, instance_png, ignore_png] =
        encode_planes(&frame, None, request.planes)?;
    let world_from_local = local_from_world.inverse();
    let used = || assets.iter().map(Arc::as_ref).chain(background);
    let shown = FrameObjects {
        objects: &composition.objects,
        labels: &labels,
        matched: &Matched::default(),
    };
    let boxes = boxes(&[shown], &world_from_local, |i| SampleObject {
        asset: request.objects[i].asset.to_string(),
        source_log: assets[i].header.source_log.clone(),
        source_track_id: assets[i].header.source_track_id.clone(),
    });
    Ok(Sample {
        frames: vec![SampleFrame {
            camera_id: String::new(),
            timestamp_ns: 0,
            frame_index: 0,
            camera: composition.camera,
            world_from_camera: request.world_from_camera,
            world_from_ego: world_from_local * composition.local_from_ego,
            image_png,
            depth_png,
            instance_png,
            ignore_png,
            filled_px: 0,
            labels,
        }],
        world_from_local,
        boxes,
        daylight: composition.daylight.map(|day| Daylight {
            sun_direction_local: world_from_local.direction(day.sun_direction_local),
            ..day
        }),
        insert_shadows: request.insert_shadows,
        rejections: Default::default(),
        synthetic: used().any(|asset| asset.header.synthetic),
        has_replay_only: used().any(|asset| asset.header.usage == Usage::ReplayOnly),
        render_class: render_class(backend),
    })
}
