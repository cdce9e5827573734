//! Runs the kernels of one batch of pixels.

use std::ops::Range;

use backlot_shaders::kernels;
use backlot_shaders::layout::MarchParams;
use backlot_shaders::scene_layout::{EyeParams, ObjectBox, RayHit, SampleList, SceneParams};

use super::HALF_TAU;
use super::asset::ResidentAsset;
use super::eye::eye_params;
use super::kernels::SceneKernels;
use super::plan::Plan;
use super::workspace::{Asked, Lists, Room, Workspace};
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::march::{march_buffers, march_kernel};
use crate::backend::gpu::pipeline::Pipeline;
use crate::scene::{self, Prepared, Tone};

/// What a batch's rays and pairs show.
#[derive(Clone, Debug, Default)]
pub(super) struct Shown {
    pub(super) hits: Vec<RayHit>,
    /// sRGB of background and sky.
    pub(super) colors: Vec<[f32; 4]>,
    pub(super) pairs: Vec<SampleList>,
    pub(super) pair_colors: Vec<[f32; 4]>,
}

/// A scene on the device.
pub(super) struct Staged<'a> {
    pub(super) device: &'a Device,
    pub(super) kernels: &'a SceneKernels,
    pub(super) scene: &'a Prepared<'a>,
    /// An empty field where there is no background.
    pub(super) background: &'a ResidentAsset,
    /// In the order of the scene's objects.
    pub(super) objects: Vec<&'a ResidentAsset>,
}

impl Staged<'_> {
    /// Samples of every pair: whether its ray meets its object, and what the object would hide alone.
    pub(super) fn probe(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        plan: &Plan,
    ) -> Result<Vec<SampleList>, Error> {
        self.with_room(work, room, plan, |work, room| {
            self.march_pairs(work, room, plan)?;
            work.pairs.lists.read(self.device, plan.pair_requests.len())
        })
    }

    /// Everything that the batch shows. `cancelled` is asked between what is marched and what is coloured.
    pub(super) fn render(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        plan: &Plan,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Shown, Error> {
        let (rays, pairs) = (plan.requests.len(), plan.pair_requests.len());
        self.with_room(work, room, plan, |work, room| {
            self.march_pairs(work, room, plan)?;
            self.merge(work, room, plan)?;
            self.device.wait()?;
            if cancelled() {
                return Err(Error::Cancelled);
            }
            let slots = room.slots(rays.max(pairs) as u32);
            self.color_background(work, room, slots, rays as u32)?;
            for (object, range) in plan.object_pairs.iter().enumerate() {
                self.color_object(work, room, slots, object, range.clone())?;
            }
            Ok(Shown {
                hits: work.rays.hits.read(self.device, rays)?,
                colors: work.rays.colors.read(self.device, rays)?,
                pairs: work.pairs.lists.read(self.device, pairs)?,
                pair_colors: work.pairs.colors.read(self.device, pairs)?,
            })
        })
    }

    /// Runs a batch, and again with more room until everything fits.
    fn with_room<T>(
        &self,
        work: &mut Workspace,
        room: &mut Room,
        plan: &Plan,
        run: impl Fn(&mut Workspace, Room) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let (rays, pairs) = (plan.requests.len(), plan.pair_requests.len());
        loop {
            work.fit(self.device, *room, rays, pairs, self.objects.len())?;
            work.worst.write(self.device, &[0; 3]);
            let done = run(work, *room)?;
            let worst = work.worst.read(self.device, 3)?;
            let asked = Asked {
                pair_samples: worst[0],
                ray_samples: worst[1],
                slots: worst[2],
            };
            match room.grown(asked, rays.max(pairs) as u32) {
                None => return Ok(done),
                Some(grown) => *room = grown,
            }
        }
    }

    /// Rays of the pairs in their objects' frames, and what they meet there.
    fn march_pairs(&self, work: &Workspace, room: Room, plan: &Plan) -> Result<(), Error> {
        work.pairs.requests.write(self.device, &plan.pair_requests);
        for (object, range) in plan.object_pairs.iter().enumerate() {
            if range.is_empty() {
                continue;
            }
            let placed = &self.scene.objects[object];
            let camera = placed.object_from_local * self.scene.local_from_camera;
            let eye = eye_params(&self.scene.camera, &camera, scene::STOP_TAU);
            self.cast(work, &work.pairs, eye, range.clone())?;
            self.march(work, room, self.objects[object], range.clone())?;
            let own = SceneParams {
                object: object as u32,
                lowest_m: placed.lowest_m(),
                capacity: room.pair_samples,
                ..self.params(room)
            };
            let pairs = &work.pairs;
            let buffers = [
                &work.scene.raw,
                &pairs.rays.raw,
                &work.pair_summaries.raw,
                &work.pair_samples.raw,
                &pairs.lists.raw,
                &pairs.weighted.raw,
                &work.worst.raw,
            ];
            self.over(
                work,
                &self.kernels.object_samples,
                own,
                range.clone(),
                &buffers,
            )?;
        }
        Ok(())
    }

    /// Casts a range of requested rays.
    fn cast(
        &self,
        work: &Workspace,
        lists: &Lists,
        eye: EyeParams,
        range: Range<u32>,
    ) -> Result<(), Error> {
        let count = range.len() as u32;
        let groups = self.kernels.eye_rays.groups(self.device, count);
        let params = EyeParams {
            first_ray: range.start,
            ray_count: count,
            groups_x: groups.x,
            ..eye
        };
        work.eye.write(self.device, &[params]);
        let buffers = [
            &work.eye.raw,
            &lists.requests.raw,
            &lists.rays.raw,
            &lists.hits.raw,
        ];
        self.kernels
            .eye_rays
            .dispatch(self.device, groups, &buffers)
    }

    /// Marches the pairs of one object.
    fn march(
        &self,
        work: &Workspace,
        room: Room,
        object: &ResidentAsset,
        range: Range<u32>,
    ) -> Result<(), Error> {
        let count = range.len() as u32;
        let shape = &object.shape;
        let kernel = march_kernel(self.device, shape)?;
        let groups = kernel.groups(self.device, count);
        let params = MarchParams {
            first_ray: range.start,
            ray_count: count,
            sample_capacity: room.pair_samples,
            groups_x: groups.x,
            ..shape.params
        };
        work.march.write(self.device, &[params]);
        let own = [
            &work.march.raw,
            &work.pairs.rays.raw,
            &work.pair_summaries.raw,
            &work.pair_samples.raw,
        ];
        kernel.dispatch(self.device, groups, &march_buffers(shape, own))
    }

    /// Marches the background and merges it with the pairs' samples.
    fn merge(&self, work: &Workspace, room: Room, plan: &Plan) -> Result<(), Error> {
        let rays = plan.requests.len() as u32;
        work.rays.requests.write(self.device, &plan.requests);
        work.ray_pairs.write(self.device, &plan.ray_pairs);
        work.pair_order.write(self.device, &plan.pair_order);
        let boxes = self.scene.objects.iter().map(|object| ObjectBox {
            half_m: object.half_m.to_array(),
            floor_m: object.floor_m(),
        });
        work.object_boxes
            .write(self.device, &boxes.collect::<Vec<_>>());
        let camera = &self.scene.local_from_camera;
        let eye = eye_params(&self.scene.camera, camera, scene::STOP_TAU);
        self.cast(work, &work.rays, eye, 0..rays)?;
        let shape = &self.background.shape;
        let kernel = shape.kernel(
            self.device,
            &kernels::MERGE_SCENE,
            &kernels::MERGE_SCENE_SPLIT,
        )?;
        let groups = kernel.groups(self.device, rays);
        let march = MarchParams {
            ray_count: rays,
            groups_x: groups.x,
            ..shape.params
        };
        work.march.write(self.device, &[march]);
        let params = SceneParams {
            capacity: room.pair_samples,
            ..self.params(room)
        };
        work.scene.write(self.device, &[params]);
        let (own, pairs) = (&work.rays, &work.pairs);
        let mut buffers = vec![
            &work.march.raw,
            &work.scene.raw,
            &shape.levels.raw,
            &shape.brick_index.raw,
            shape.first_density(),
            &shape.block_index.raw,
            &shape.blocks.raw,
            &own.rays.raw,
            &work.ray_pairs.raw,
            &work.pair_order.raw,
            &pairs.rays.raw,
            &work.object_boxes.raw,
            &work.pair_samples.raw,
            &pairs.lists.raw,
            &pairs.weighted.raw,
            &own.lists.raw,
            &own.weighted.raw,
            &own.hits.raw,
            &work.worst.raw,
        ];
        buffers.extend(shape.other_densities());
        kernel.dispatch(self.device, groups, &buffers)
    }

    /// Runs a kernel over a range of lists.
    pub(super) fn over(
        &self,
        work: &Workspace,
        kernel: &Pipeline,
        params: SceneParams,
        range: Range<u32>,
        buffers: &[&wgpu::Buffer],
    ) -> Result<(), Error> {
        let count = range.len() as u32;
        let groups = kernel.groups(self.device, count);
        let params = SceneParams {
            first: range.start,
            count,
            groups_x: groups.x,
            ..params
        };
        work.scene.write(self.device, &[params]);
        kernel.dispatch(self.device, groups, buffers)
    }

    pub(super) fn params(&self, room: Room) -> SceneParams {
        SceneParams {
            tone_gain: Tone::IDENTITY.gain,
            tone_offset: Tone::IDENTITY.offset,
            min_weight: scene::MIN_WEIGHT,
            ray_capacity: room.ray_samples,
            stop_tau: scene::STOP_TAU,
            stop_tau_through_object: scene::STOP_TAU_THROUGH_OBJECT,
            half_tau: HALF_TAU,
            ..Default::default()
        }
    }
}
