//! The buffers of a batch. They grow to what batches need and stay.

use backlot_shaders::layout::{MarchParams, PartParams, Ray, RaySample, RaySummary, SlotSample};
use backlot_shaders::scene_layout::{
    EyeParams, ObjectBox, RayHit, RayPairs, RayRequest, SampleList, SceneParams, SlotRange,
    Weighted,
};
use wgpu::BufferUsages;

use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;

/// Samples an object holds on one ray at first: 6 m in steps of 5 cm.
const PAIR_SAMPLES: u32 = 128;
/// Samples with a colour on one ray at first; ten or twenty is usual.
const RAY_SAMPLES: u32 = 64;
/// Coloured samples a ray, on average over a batch, at first.
const SLOTS_PER_RAY: u32 = 24;

/// Room in each list. What a batch did not fit into is doubled and the batch runs again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Room {
    pub(super) pair_samples: u32,
    pub(super) ray_samples: u32,
    pub(super) slots_per_ray: u32,
}

impl Default for Room {
    fn default() -> Self {
        Self {
            pair_samples: PAIR_SAMPLES,
            ray_samples: RAY_SAMPLES,
            slots_per_ray: SLOTS_PER_RAY,
        }
    }
}

/// The most that any list of a batch asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Asked {
    pub(super) pair_samples: u32,
    pub(super) ray_samples: u32,
    pub(super) slots: u32,
}

impl Room {
    /// Rays and pairs of a batch whose buffers are all within the adapter's bindings.
    pub(super) fn most_lists(self, binding_bytes: u64) -> usize {
        let slots = self.slots_per_ray as usize * 3 * size_of::<[f32; 4]>();
        let pairs = self.pair_samples as usize * size_of::<RaySample>();
        let rays = self.ray_samples as usize * size_of::<Weighted>();
        let bytes = slots.max(pairs).max(rays).max(size_of::<Ray>());
        // Buffers grow to powers of two.
        (binding_bytes as usize / bytes / 2).max(1)
    }

    /// Slots of a batch of this many lists.
    pub(super) fn slots(self, lists: u32) -> u32 {
        self.slots_per_ray.saturating_mul(lists.max(1))
    }

    /// Enough room for what a batch of `lists` asked for; `None` if there was.
    pub(super) fn grown(self, asked: Asked, lists: u32) -> Option<Self> {
        let enough = |room: u32, asked: u32| {
            if asked > room {
                asked.next_power_of_two()
            } else {
                room
            }
        };
        let grown = Self {
            pair_samples: enough(self.pair_samples, asked.pair_samples),
            ray_samples: enough(self.ray_samples, asked.ray_samples),
            slots_per_ray: enough(self.slots_per_ray, asked.slots.div_ceil(lists.max(1))),
        };
        (grown != self).then_some(grown)
    }
}

/// What belongs to the lists of one kind: the rays' own, or the pairs'.
#[derive(Debug)]
pub(super) struct Lists {
    pub(super) requests: Buffer<RayRequest>,
    pub(super) rays: Buffer<Ray>,
    pub(super) hits: Buffer<RayHit>,
    pub(super) lists: Buffer<SampleList>,
    pub(super) weighted: Buffer<Weighted>,
    pub(super) slot_ranges: Buffer<SlotRange>,
    pub(super) colors: Buffer<[f32; 4]>,
}

impl Lists {
    fn new(device: &Device) -> Result<Self, Error> {
        Ok(Self {
            requests: storage(device, "ray requests")?,
            rays: storage(device, "scene rays")?,
            hits: storage(device, "ray hits")?,
            lists: storage(device, "sample lists")?,
            weighted: storage(device, "weighted samples")?,
            slot_ranges: storage(device, "slot ranges")?,
            colors: storage(device, "list colors")?,
        })
    }

    fn fit(&mut self, device: &Device, lists: usize, samples: u32) -> Result<(), Error> {
        self.requests.grow(device, lists)?;
        self.rays.grow(device, lists)?;
        self.hits.grow(device, lists)?;
        self.lists.grow(device, lists)?;
        self.weighted.grow(device, lists * samples as usize)?;
        self.slot_ranges.grow(device, lists)?;
        self.colors.grow(device, lists)
    }
}

#[derive(Debug)]
pub(super) struct Workspace {
    pub(super) eye: Buffer<EyeParams>,
    pub(super) march: Buffer<MarchParams>,
    pub(super) scene: Buffer<SceneParams>,
    pub(super) part: Buffer<PartParams>,
    pub(super) rays: Lists,
    pub(super) pairs: Lists,
    pub(super) ray_pairs: Buffer<RayPairs>,
    pub(super) pair_order: Buffer<u32>,
    pub(super) pair_summaries: Buffer<RaySummary>,
    pub(super) pair_samples: Buffer<RaySample>,
    pub(super) object_boxes: Buffer<ObjectBox>,
    pub(super) slot_samples: Buffer<SlotSample>,
    pub(super) slot_weights: Buffer<f32>,
    /// Three quads a slot.
    pub(super) slot_features: Buffer<[f32; 4]>,
    pub(super) slot_colors: Buffer<[f32; 4]>,
    pub(super) counters: Buffer<u32>,
    pub(super) worst: Buffer<u32>,
}

impl Workspace {
    pub(super) fn new(device: &Device) -> Result<Self, Error> {
        let uniform = BufferUsages::UNIFORM;
        Ok(Self {
            eye: Buffer::zeroed(device, "eye parameters", 1, uniform)?,
            march: Buffer::zeroed(device, "march parameters", 1, uniform)?,
            scene: Buffer::zeroed(device, "scene parameters", 1, uniform)?,
            part: Buffer::zeroed(device, "part parameters", 1, uniform)?,
            rays: Lists::new(device)?,
            pairs: Lists::new(device)?,
            ray_pairs: storage(device, "ray pairs")?,
            pair_order: storage(device, "pair order")?,
            pair_summaries: storage(device, "pair summaries")?,
            pair_samples: storage(device, "pair samples")?,
            object_boxes: storage(device, "object boxes")?,
            slot_samples: storage(device, "slot samples")?,
            slot_weights: storage(device, "slot weights")?,
            slot_features: storage(device, "slot features")?,
            slot_colors: storage(device, "slot colors")?,
            counters: Buffer::zeroed(device, "counters", COUNTERS, BufferUsages::STORAGE)?,
            worst: Buffer::zeroed(device, "most asked for", 3, BufferUsages::STORAGE)?,
        })
    }

    /// Makes room for a batch.
    pub(super) fn fit(
        &mut self,
        device: &Device,
        room: Room,
        rays: usize,
        pairs: usize,
        objects: usize,
    ) -> Result<(), Error> {
        self.rays.fit(device, rays, room.ray_samples)?;
        self.pairs.fit(device, pairs, room.pair_samples)?;
        self.ray_pairs.grow(device, rays)?;
        self.pair_order.grow(device, pairs)?;
        self.pair_summaries.grow(device, pairs)?;
        self.pair_samples
            .grow(device, pairs * room.pair_samples as usize)?;
        self.object_boxes.grow(device, objects)?;
        let slots = room.slots(rays.max(pairs) as u32) as usize;
        self.slot_samples.grow(device, slots)?;
        self.slot_weights.grow(device, slots)?;
        self.slot_features.grow(device, 3 * slots)?;
        self.slot_colors.grow(device, slots)
    }
}

/// Counters that the colour kernels share with training.
const COUNTERS: usize = 2;

fn storage<T: bytemuck::NoUninit + bytemuck::AnyBitPattern>(
    device: &Device,
    label: &'static str,
) -> Result<Buffer<T>, Error> {
    Buffer::zeroed(device, label, 1, BufferUsages::STORAGE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_grows_to_what_was_asked_for_and_no_further() {
        let room = Room::default();
        assert_eq!(room.grown(Asked::default(), 100), None);
        let asked = Asked {
            pair_samples: PAIR_SAMPLES + 1,
            ray_samples: RAY_SAMPLES,
            slots: room.slots(100) + 1,
        };
        let grown = room.grown(asked, 100).unwrap();
        assert_eq!(grown.pair_samples, 256);
        assert_eq!(grown.ray_samples, RAY_SAMPLES);
        assert_eq!(grown.slots_per_ray, 32);
        assert_eq!(grown.grown(asked, 100), None);
    }
}
