//! The samples of a recipe: sample `index` is a pure function of (library snapshot, recipe, seed, index).

use std::sync::Arc;

use backlot_engine::asset::AssetKind;
use backlot_engine::scene::{
    Candidate, Composition, Daylight, Draws, InstanceMask, Recipe, RecordedImage, RecordedTrack,
    RenderOptions, Scene, Stage, SunSource, compose, compose_clip, finish, label, match_tones,
    needs_recorded, object_lights, relight,
};
use backlot_engine::{Asset, Error as EngineError};
use glam::DVec3;

use super::cache::AssetCache;
use super::error::{Error, Result};
use super::library::{self, Objects};
use super::plan::{SamplePlan, plan_of};
use super::sample::{
    FrameObjects, Matched, Sample, SampleFrame, SampleObject, boxes, encode_planes, render_class,
};
use crate::domain::blob::Digest;
use crate::domain::ids::AssetId;
use crate::ingest::{decode_instance_mask, decode_rgb};

/// Draws of attempt numbers that no placement reaches; later frames of a clip count down from it.
const GRAIN: u32 = u32::MAX;

/// A sample is one message of at most 64 MiB; rendered frames take about four bytes a pixel, image, depth and instances together.
const MAX_CLIP_PIXELS: usize = 12_000_000;

/// Which planes are wanted besides the image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Planes {
    pub depth: bool,
    pub instance: bool,
}

/// What a client asks for; trajectories are in the log's world frame.
#[derive(Clone, Debug)]
pub struct RecipeRequest {
    /// `None` means the present library.
    pub snapshot: Option<Digest>,
    pub background: AssetId,
    /// Assets to draw from; empty means every library object.
    pub objects: Vec<AssetId>,
    /// `recipe.objects` holds the same names.
    pub recipe: Recipe,
    /// Towards the sun; `None` means as the background knows it.
    pub sun_direction_world: Option<DVec3>,
    pub planes: Planes,
    pub seed: u64,
}

/// A recipe with its library resolved: later changes of the library do not reach it.
#[derive(Debug)]
pub struct RecipeSamples {
    cache: Arc<AssetCache>,
    request: RecipeRequest,
    snapshot: Digest,
    background: Arc<Asset>,
    objects: Objects,
}

impl RecipeSamples {
    /// Resolves the snapshot, decodes the background and reads the objects' headers.
    ///
    /// # Errors
    /// Unknown snapshot, background or object; a background that is none; a recipe out of range.
    pub fn prepare(cache: Arc<AssetCache>, mut request: RecipeRequest) -> Result<Self> {
        request.recipe.validate()?;
        let library = library::resolve(&cache, request.snapshot.as_ref())?;
        let background = library::load(&cache, &library, &request.background)?;
        if background.header.kind != AssetKind::Background {
            return Err(Error::Invalid {
                what: format!("{} is an object, not a background", request.background),
            });
        }
        let objects = library::objects(&cache, &library, &request.objects)?;
        let local_from_world = &background.header.local_from_world;
        request.recipe.transform_trajectories(local_from_world);
        Ok(Self {
            cache,
            request,
            snapshot: library.digest,
            background,
            objects,
        })
    }

    /// Digest of the library the samples are made from.
    pub fn snapshot(&self) -> Digest {
        self.snapshot
    }

    /// Composes one sample without rendering it: the poses that [`Self::sample`] renders.
    ///
    /// # Errors
    /// Why the sample cannot be made.
    pub fn plan(&self, index: u64) -> Result<SamplePlan> {
        let header = &self.background.header;
        let stage = Stage::from_header(&self.request.background.to_string(), header)?;
        let candidates = &self.objects.candidates;
        let request = &self.request;
        let composition = compose(&stage, candidates, &request.recipe, request.seed, index)?;
        let world_from_local = header.local_from_world.inverse();
        Ok(plan_of(&stage, composition, candidates, &world_from_local))
    }

    /// Makes one sample. `cancelled` is asked often.
    ///
    /// # Errors
    /// [`EngineError::Cancelled`] in the engine's error, or why the sample cannot be made.
    pub fn sample(&self, index: u64, cancelled: &(dyn Fn() -> bool + Sync)) -> Result<Sample> {
        let header = &self.background.header;
        let stage = Stage::from_header(&self.request.background.to_string(), header)?;
        let candidates = &self.objects.candidates;
        let seed = self.request.seed;
        let recipe = &self.request.recipe;
        let mut compositions = compose_clip(&stage, candidates, recipe, seed, index)?;
        for composition in &mut compositions {
            composition.daylight = self.daylight(composition);
        }
        check_pixels(&compositions)?;
        let frames = compositions
            .iter()
            .enumerate()
            .map(|(k, composition)| {
                let grain = Draws::new(seed, index, GRAIN - k as u32);
                self.frame(&stage, composition, grain, cancelled)
            })
            .collect::<Result<Vec<_>>>()?;
        let shown = compositions.iter().zip(&frames);
        let shown: Vec<_> = shown
            .map(|(composition, (frame, matched))| FrameObjects {
                objects: &composition.objects,
                labels: &frame.labels,
                matched,
            })
            .collect();
        let world_from_local = header.local_from_world.inverse();
        let boxes = boxes(&shown, &world_from_local, |i| object_of(&candidates[i]));
        let placed = || {
            let objects = compositions.iter().flat_map(|c| &c.objects);
            objects.filter_map(|o| o.asset)
        };
        Ok(Sample {
            boxes,
            world_from_local,
            insert_shadows: compositions[0].insert_shadows,
            daylight: compositions[0].daylight.map(|day| Daylight {
                sun_direction_local: world_from_local.direction(day.sun_direction_local),
                ..day
            }),
            synthetic: header.synthetic || placed().any(|i| self.objects.objects[i].synthetic),
            has_replay_only: placed().any(|i| !candidates[i].library),
            render_class: render_class(self.cache.backend()),
            rejections: compositions[0].rejections.clone(),
            frames: frames.into_iter().map(|(frame, _)| frame).collect(),
        })
    }

    /// Renders and labels one frame; returns how its objects' colours were changed with it.
    fn frame(
        &self,
        stage: &Stage<'_>,
        composition: &Composition,
        grain: Draws,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<(SampleFrame, Matched)> {
        let header = &self.background.header;
        let candidates = &self.objects.candidates;
        let assets = self.load_placed(composition, cancelled)?;
        let field = |i: usize| assets[i].as_deref().map(|asset| &asset.field);
        let shape = |i: usize| field(i).map(Arc::as_ref);
        let backend = self.cache.backend();
        let mut scene = Scene::of_composition(&self.background.field, composition, field)?;
        let recorded = self.recorded_image(stage, composition)?;
        let tracks = &stage.recording.tracks;
        let recorded = recorded.as_ref().map(|decoded| decoded.image(tracks));
        let matched = recorded
            .as_ref()
            .filter(|_| self.request.recipe.match_tones);
        let tones = match matched {
            Some(image) => match_tones(
                backend,
                stage,
                &scene,
                composition,
                candidates,
                image,
                shape,
                cancelled,
            )?,
            None => Vec::new(),
        };
        scene.set_tones(&tones);
        let lights = match self.request.recipe.match_light {
            true => object_lights(stage, &scene, composition, candidates, &tones),
            false => Vec::new(),
        };
        let mut frame = backend.render(&scene, &RenderOptions::default(), cancelled)?;
        relight(&scene, composition.daylight.as_ref(), &lights, &mut frame);
        let finished = finish(
            stage,
            &scene,
            composition,
            recorded.as_ref(),
            shape,
            grain,
            &mut frame,
        );
        let labels = label(composition, stage.region, &frame);
        let [image_png, depth_png, instance_png, ignore_png] =
            encode_planes(&frame, finished.ignore.as_deref(), self.request.planes)?;
        let recorded = &stage.recording.frames[composition.frame];
        let world_from_local = header.local_from_world.inverse();
        let frame = SampleFrame {
            camera_id: recorded.camera_id.clone(),
            timestamp_ns: recorded.timestamp_ns,
            frame_index: recorded.frame_index,
            camera: composition.camera,
            world_from_camera: world_from_local * composition.local_from_camera,
            world_from_ego: world_from_local * composition.local_from_ego,
            image_png,
            depth_png,
            instance_png,
            ignore_png,
            filled_px: finished.filled_px,
            labels,
        };
        Ok((frame, Matched { tones, lights }))
    }

    /// The sunlight: the recipe's direction with what the background shows of its strength, or all as the background knows it.
    fn daylight(&self, composition: &Composition) -> Option<Daylight> {
        let Some(sun) = self.request.sun_direction_world else {
            return composition.daylight;
        };
        let sun = self.background.header.local_from_world.direction(sun);
        let given = Daylight::clear_sky(sun, SunSource::Recipe)?;
        let measured = composition.daylight.unwrap_or(given);
        Some(Daylight {
            sun_direction_local: given.sun_direction_local,
            source: given.source,
            ..measured
        })
    }

    /// The composition's frame as recorded; `None` if nothing of it is to be shown.
    fn recorded_image(
        &self,
        stage: &Stage<'_>,
        composition: &Composition,
    ) -> Result<Option<Decoded>> {
        let needed = needs_recorded(composition);
        if !needed && composition.left_out.is_empty() {
            return Ok(None);
        }
        let recorded = &stage.recording.frames[composition.frame];
        if !needed && recorded.image.is_none() {
            return Ok(None);
        }
        let unusable = |why: String| Error::Invalid {
            what: format!(
                "frame {} of {} shows original movers, and its image {why}; set drop_originals to leave them out",
                recorded.frame_index, stage.source_log
            ),
        };
        let digest = recorded.image.as_deref().map(str::parse::<Digest>);
        let Some(Ok(digest)) = digest else {
            return Err(unusable("is not recorded".to_owned()));
        };
        let camera = stage
            .recording
            .camera(&recorded.camera_id)
            .ok_or_else(|| unusable("has no camera".to_owned()))?;
        let bytes = self.cache.store().blobs().read(&digest)?;
        let (width, height) = (camera.width, camera.height);
        let rgb8 = decode_rgb(&bytes, (width, height)).map_err(|e| unusable(e.to_string()))?;
        let mask = match &recorded.instance_mask {
            None => None,
            Some(digest) => {
                let digest = digest
                    .parse::<Digest>()
                    .map_err(|_| unusable("has no mask of its name".to_owned()))?;
                let bytes = self.cache.store().blobs().read(&digest)?;
                let mask = decode_instance_mask(&bytes, (width, height));
                Some(mask.map_err(|e| unusable(e.to_string()))?)
            }
        };
        Ok(Some(Decoded {
            width,
            height,
            rgb8,
            instance: mask,
        }))
    }

    /// The decoded assets of the placed objects and of the left-out movers, by index into the candidates.
    fn load_placed(
        &self,
        composition: &Composition,
        cancelled: &(dyn Fn() -> bool + Sync),
    ) -> Result<Vec<Option<Arc<Asset>>>> {
        let mut assets = vec![None; self.objects.objects.len()];
        let placed = composition.objects.iter().map(|o| o.asset);
        let left_out = composition.left_out.iter().map(|o| o.asset);
        for index in placed.chain(left_out).flatten() {
            if cancelled() {
                return Err(EngineError::Cancelled.into());
            }
            if assets[index].is_none() {
                let payload = &self.objects.objects[index].payload;
                assets[index] = Some(self.cache.asset(payload)?);
            }
        }
        Ok(assets)
    }
}

/// A recorded image in memory.
struct Decoded {
    width: u32,
    height: u32,
    rgb8: Vec<u8>,
    instance: Option<Vec<u16>>,
}

impl Decoded {
    fn image<'a>(&'a self, tracks: &'a [RecordedTrack]) -> RecordedImage<'a> {
        RecordedImage {
            width: self.width,
            height: self.height,
            rgb8: &self.rgb8,
            masks: self
                .instance
                .as_ref()
                .map(|values| InstanceMask { values, tracks }),
        }
    }
}

fn check_pixels(frames: &[Composition]) -> Result<()> {
    let pixels: usize = frames.iter().map(|f| f.camera.pixel_count()).sum();
    if frames.len() == 1 || pixels <= MAX_CLIP_PIXELS {
        return Ok(());
    }
    Err(Error::Invalid {
        what: format!(
            "a clip of {} frames has {pixels} pixels, at most {MAX_CLIP_PIXELS}; lower clip.frame_count or longer_side_px",
            frames.len()
        ),
    })
}

pub(super) fn object_of(candidate: &Candidate) -> SampleObject {
    SampleObject {
        asset: candidate.name.clone(),
        source_log: candidate.source_log.clone(),
        source_track_id: candidate.source_track_id.clone(),
    }
}
