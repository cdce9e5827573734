//! What is corrected about views, with its optimiser state, on the device.

use backlot_shaders::{VIEW_SUMS, VIEW_VALUES, layout};
use glam::{Quat, Vec3};
use wgpu::BufferUsages;

use super::rays::adam_rate;
use crate::backend::cpu::{PoseCorrection, ViewCorrection};
use crate::backend::gpu::buffer::Buffer;
use crate::backend::gpu::device::Device;
use crate::backend::gpu::error::Error;
use crate::backend::gpu::sequence::Sequence;
use crate::train::ray::{Rates, RayLosses, TrainRay};
use crate::volume::Exposure;

/// Corrections by the views' numbers; none until a rate asks for them.
#[derive(Debug)]
pub(super) struct Views {
    count: usize,
    on_device: OnDevice,
    exposure_steps: u64,
    pose_steps: u64,
}

/// One view at least, as bindings cannot be empty.
#[derive(Debug)]
pub(super) struct OnDevice {
    pub(super) views: Buffer<layout::View>,
    /// [`VIEW_SUMS`] a view.
    pub(super) sums: Buffer<u32>,
    /// [`VIEW_VALUES`] a view.
    pub(super) moments: Buffer<layout::Moments>,
}

impl Views {
    pub(super) fn new(device: &Device) -> Result<Self, Error> {
        Ok(Self {
            count: 0,
            on_device: OnDevice::new(device, 1)?,
            exposure_steps: 0,
            pose_steps: 0,
        })
    }

    pub(super) fn on_device(&self) -> &OnDevice {
        &self.on_device
    }

    /// Makes room for the views of `rays` if any rate asks for it, or did. Returns whether the buffers are new.
    pub(super) fn prepare(
        &mut self,
        device: &Device,
        rays: &[TrainRay],
        rates: Rates,
    ) -> Result<bool, Error> {
        if self.count == 0 && rates.exposure <= 0.0 && rates.pose_m <= 0.0 {
            return Ok(false);
        }
        let most = rays.iter().map(|ray| ray.view as usize + 1).max();
        let wanted = most.unwrap_or(0).max(self.count);
        if wanted == self.count {
            return Ok(false);
        }
        self.resize(device, wanted)?;
        Ok(true)
    }

    fn resize(&mut self, device: &Device, count: usize) -> Result<(), Error> {
        let grown = OnDevice::new(device, count)?;
        if self.count > 0 {
            let old = &self.on_device;
            let mut sequence = Sequence::new(device, "more views");
            sequence.copy(&old.views.raw, 0, &grown.views.raw, old.views.bytes());
            sequence.copy(&old.sums.raw, 0, &grown.sums.raw, old.sums.bytes());
            sequence.copy(&old.moments.raw, 0, &grown.moments.raw, old.moments.bytes());
            sequence.submit()?;
        }
        self.on_device = grown;
        self.count = count;
        Ok(())
    }

    /// What a step's kernels need to know; counts the step.
    pub(super) fn begin_step(
        &mut self,
        losses: &RayLosses,
        rates: Rates,
        params: &mut layout::TrainParams,
    ) {
        params.view_count = self.count as u32;
        if rates.exposure > 0.0 {
            self.exposure_steps += 1;
            params.exposure_rate = adam_rate(rates.exposure, self.exposure_steps);
            params.exposure_prior = losses.exposure_prior;
        }
        if rates.pose_m > 0.0 {
            self.pose_steps += 1;
            params.pose_rate = adam_rate(rates.pose_m, self.pose_steps);
            params.pose_prior = losses.pose_prior;
        }
    }

    /// The corrections; waits for them.
    pub(super) fn fetch(&self, device: &Device) -> Result<Vec<ViewCorrection>, Error> {
        let views = self.on_device.views.read(device, self.count)?;
        Ok(views.iter().map(to_host).collect())
    }

    /// Takes corrections over as they are.
    #[cfg(test)]
    pub(super) fn set(&mut self, device: &Device, views: &[ViewCorrection]) -> Result<(), Error> {
        self.resize(device, views.len())?;
        let views: Vec<layout::View> = views.iter().map(to_device).collect();
        self.on_device.views.write(device, &views);
        Ok(())
    }
}

impl OnDevice {
    fn new(device: &Device, count: usize) -> Result<Self, Error> {
        let storage = BufferUsages::STORAGE;
        let as_recorded = vec![to_device(&ViewCorrection::default()); count];
        Ok(Self {
            views: Buffer::from_slice(device, "views", &as_recorded, storage)?,
            sums: Buffer::zeroed(device, "view sums", VIEW_SUMS * count, storage)?,
            moments: Buffer::zeroed(device, "view moments", VIEW_VALUES * count, storage)?,
        })
    }
}

fn to_device(view: &ViewCorrection) -> layout::View {
    let three = |[x, y, z]: [f32; 3]| [x, y, z, 0.0];
    layout::View {
        log_gain: three(view.exposure.log_gain),
        bias: three(view.exposure.bias),
        rotation: view.pose.rotation.to_array(),
        translation_m: three(view.pose.translation_m.to_array()),
    }
}

fn to_host(view: &layout::View) -> ViewCorrection {
    let three = |[x, y, z, _]: [f32; 4]| [x, y, z];
    ViewCorrection {
        exposure: Exposure {
            log_gain: three(view.log_gain),
            bias: three(view.bias),
        },
        pose: PoseCorrection {
            rotation: Quat::from_array(view.rotation),
            translation_m: Vec3::from(three(view.translation_m)),
        },
    }
}
