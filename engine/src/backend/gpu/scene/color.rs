//! Colours what a batch has listed, field by field.

use std::ops::Range;

use backlot_shaders::kernels;
use backlot_shaders::layout::PartParams;
use backlot_shaders::scene_layout::SceneParams;

use super::asset::ResidentAsset;
use super::batch::Staged;
use super::kernels::network;
use super::workspace::{Lists, Room, Workspace};
use crate::backend::gpu::error::Error;
use crate::backend::gpu::free_groups;
use crate::backend::gpu::pipeline::{Groups, Pipeline};
use crate::scene::Tone;

/// Coloured samples that one thread of the colour kernels takes, about.
const SLOTS_PER_THREAD: u32 = 4;

impl Staged<'_> {
    pub(super) fn color_background(
        &self,
        work: &Workspace,
        room: Room,
        slot_capacity: u32,
        rays: u32,
    ) -> Result<(), Error> {
        let params = SceneParams {
            capacity: room.ray_samples,
            slot_capacity,
            ..self.params(room)
        };
        self.color(work, &work.rays, params, self.background, 0..rays)?;
        let Some(sky) = &self.background.sky else {
            return Ok(());
        };
        let params = SceneParams {
            sky_grid_count: sky.grid_count,
            ..params
        };
        let buffers = [
            &work.scene.raw,
            &work.rays.rays.raw,
            &work.rays.hits.raw,
            &sky.grids.raw,
            &sky.logits.raw,
            &work.rays.colors.raw,
        ];
        self.over(work, &self.kernels.sky, params, 0..rays, &buffers)
    }

    pub(super) fn color_object(
        &self,
        work: &Workspace,
        room: Room,
        slot_capacity: u32,
        object: usize,
        range: Range<u32>,
    ) -> Result<(), Error> {
        if range.is_empty() {
            return Ok(());
        }
        let Tone { gain, offset } = self.scene.objects[object].tone;
        let params = SceneParams {
            tone_gain: gain,
            tone_offset: offset,
            capacity: room.pair_samples,
            slot_capacity,
            ..self.params(room)
        };
        self.color(work, &work.pairs, params, self.objects[object], range)
    }

    /// Colours a range of lists of one field.
    fn color(
        &self,
        work: &Workspace,
        lists: &Lists,
        params: SceneParams,
        asset: &ResidentAsset,
        range: Range<u32>,
    ) -> Result<(), Error> {
        work.counters.write(self.device, &[0; 2]);
        let buffers = [
            &work.scene.raw,
            &lists.lists.raw,
            &lists.weighted.raw,
            &work.slot_samples.raw,
            &work.slot_weights.raw,
            &lists.slot_ranges.raw,
            &work.counters.raw,
            &work.worst.raw,
        ];
        self.over(work, &self.kernels.slots, params, range.clone(), &buffers)?;
        self.gather(work, lists, asset, params.slot_capacity)?;
        let network = network(self.device, asset.network_layout)?;
        let [first, second, third] = &asset.network.layers;
        let buffers = [
            &first.raw,
            &second.raw,
            &third.raw,
            &lists.rays.raw,
            &work.slot_samples.raw,
            &work.slot_features.raw,
            &work.counters.raw,
            &work.slot_colors.raw,
        ];
        let groups = self.any_number(&network, params.slot_capacity);
        network.dispatch(self.device, groups, &buffers)?;
        let buffers = [
            &work.scene.raw,
            &lists.slot_ranges.raw,
            &work.slot_weights.raw,
            &work.slot_colors.raw,
            &lists.colors.raw,
        ];
        self.over(work, &self.kernels.colors, params, range, &buffers)
    }

    /// Features of the listed samples, in one go or part by part.
    fn gather(
        &self,
        work: &Workspace,
        lists: &Lists,
        asset: &ResidentAsset,
        slots: u32,
    ) -> Result<(), Error> {
        let level_count = asset.shape.params.level_count;
        let [a, b, c] = &asset.features;
        let parts = a.parts().iter().zip(b.parts()).zip(c.parts());
        let kernel = self.device.pipeline(&kernels::SCENE_FEATURES, &[])?;
        let groups = self.any_number(&kernel, slots);
        for (number, ((a, b), c)) in parts.enumerate() {
            let params = PartParams {
                level_count,
                first_node: (number * asset.features[0].nodes_per_part()) as u32,
                node_count: a.len() as u32,
                first_density: 0,
            };
            work.part.write(self.device, &[params]);
            let buffers = [
                &work.part.raw,
                &asset.shape.levels.raw,
                &asset.shape.brick_index.raw,
                &a.raw,
                &b.raw,
                &c.raw,
                &lists.rays.raw,
                &work.slot_samples.raw,
                &work.counters.raw,
                &work.slot_features.raw,
            ];
            kernel.dispatch(self.device, groups, &buffers)?;
        }
        Ok(())
    }

    /// Workgroups of a kernel whose threads take items until there are none.
    fn any_number(&self, kernel: &Pipeline, items: u32) -> Groups {
        if self.device.is_software() {
            return free_groups(self.device);
        }
        let most = self.device.limits.max_compute_workgroups_per_dimension;
        let groups = kernel.groups(self.device, items.div_ceil(SLOTS_PER_THREAD));
        Groups {
            x: (groups.x * groups.y).min(most),
            y: 1,
        }
    }
}
