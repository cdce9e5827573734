//! Running `march_density`.

use std::sync::Arc;

use backlot_shaders::{kernels, layout};
use wgpu::BufferUsages;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::field::ResidentField;
use super::pipeline::Pipeline;
use super::turns::Priority;
use crate::backend::{LoadedField, MarchRay, Marched, RaySummary};
use crate::field::RaySample;

/// Rays of one dispatch: 10 to 40 ms in software, so that others get their turn and a cancel is heeded.
const RAYS_PER_DISPATCH: usize = 8192;
/// Bound on the sample buffer of one dispatch.
const SAMPLE_BYTES_MAX: usize = 32 << 20;

/// A field on the device together with the kernel that marches it.
#[derive(Debug)]
pub(super) struct GpuField {
    device: Device,
    kernel: Arc<Pipeline>,
    resident: ResidentField,
}

impl GpuField {
    pub(super) fn new(device: Device, resident: ResidentField) -> Result<Self, Error> {
        let kernel = march_kernel(&device, &resident)?;
        Ok(Self {
            device,
            kernel,
            resident,
        })
    }

    /// Marches `rays` in one dispatch and appends them to `marched`.
    fn dispatch(
        &self,
        buffers: &DispatchBuffers,
        rays: &[MarchRay],
        marched: &mut Marched,
    ) -> crate::Result<()> {
        let device = &self.device;
        let groups = self.kernel.groups(device, rays.len() as u32);
        let params = layout::MarchParams {
            ray_count: rays.len() as u32,
            sample_capacity: buffers.samples_per_ray,
            groups_x: groups.x,
            ..self.resident.params
        };
        let device_rays: Vec<layout::Ray> = rays.iter().map(to_device).collect();
        buffers.params.write(device, &[params]);
        buffers.rays.write(device, &device_rays);
        let resident = &self.resident;
        let buffers_of_call = [
            &buffers.params.raw,
            &buffers.rays.raw,
            &buffers.summaries.raw,
            &buffers.samples.raw,
        ];
        let bound = march_buffers(resident, buffers_of_call);
        self.kernel.dispatch(device, groups, &bound)?;
        let stride = buffers.samples_per_ray as usize;
        let summaries = buffers.summaries.read(device, rays.len())?;
        let samples: Vec<RaySample> = buffers
            .samples
            .read(device, rays.len() * stride)?
            .iter()
            .map(from_device)
            .collect();
        for (summary, own) in summaries.iter().zip(samples.chunks_exact(stride)) {
            marched.push(to_host(summary), own, buffers.samples_per_ray)?;
        }
        Ok(())
    }
}

/// `march_density` as a field's densities need it.
pub(super) fn march_kernel(device: &Device, field: &ResidentField) -> Result<Arc<Pipeline>, Error> {
    field.kernel(
        device,
        &kernels::MARCH_DENSITY,
        &kernels::MARCH_DENSITY_SPLIT,
    )
}

/// The kernel's buffers, given parameters, rays, summaries and samples.
pub(super) fn march_buffers<'a>(
    field: &'a ResidentField,
    [params, rays, summaries, samples]: [&'a wgpu::Buffer; 4],
) -> Vec<&'a wgpu::Buffer> {
    let mut buffers = vec![
        params,
        &field.levels.raw,
        &field.brick_index.raw,
        field.first_density(),
        &field.block_index.raw,
        &field.blocks.raw,
        rays,
        summaries,
        samples,
    ];
    buffers.extend(field.other_densities());
    buffers
}

impl LoadedField for GpuField {
    fn resident_bytes(&self) -> u64 {
        self.resident.bytes
    }

    fn march(
        &self,
        rays: &[MarchRay],
        samples_per_ray: u32,
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<Marched> {
        let mut marched = Marched::with_capacity(rays.len());
        let bytes_per_ray = size_of::<layout::RaySample>() * samples_per_ray.max(1) as usize;
        let rays_per_dispatch = RAYS_PER_DISPATCH
            .min(SAMPLE_BYTES_MAX / bytes_per_ray)
            .clamp(1, rays.len().max(1));
        let buffers =
            DispatchBuffers::new(&self.device, rays_per_dispatch, samples_per_ray.max(1))?;
        for rays in rays.chunks(rays_per_dispatch) {
            let _turn = self.device.turn(Priority::Render);
            if cancelled() {
                return Err(crate::Error::Cancelled);
            }
            self.dispatch(&buffers, rays, &mut marched)?;
        }
        Ok(marched)
    }
}

/// Buffers of one call, reused by its dispatches.
struct DispatchBuffers {
    params: Buffer<layout::MarchParams>,
    rays: Buffer<layout::Ray>,
    summaries: Buffer<layout::RaySummary>,
    samples: Buffer<layout::RaySample>,
    samples_per_ray: u32,
}

impl DispatchBuffers {
    fn new(device: &Device, rays: usize, samples_per_ray: u32) -> Result<Self, Error> {
        let storage = BufferUsages::STORAGE;
        Ok(Self {
            params: Buffer::zeroed(device, "march parameters", 1, BufferUsages::UNIFORM)?,
            rays: Buffer::zeroed(device, "rays", rays, storage)?,
            summaries: Buffer::zeroed(device, "ray summaries", rays, storage)?,
            samples: Buffer::zeroed(
                device,
                "ray samples",
                rays * samples_per_ray as usize,
                storage,
            )?,
            samples_per_ray,
        })
    }
}

pub(super) fn to_device(MarchRay { ray, range }: &MarchRay) -> layout::Ray {
    layout::Ray {
        origin_m: ray.origin.to_array(),
        t_min: range.t_min,
        direction: ray.direction.to_array(),
        t_max: range.t_max,
        stop_tau: range.stop_tau,
        phase: range.phase,
        padding: [0; 2],
    }
}

fn from_device(sample: &layout::RaySample) -> RaySample {
    let layout::RaySample { t, dt, sigma } = *sample;
    RaySample { t, dt, sigma }
}

fn to_host(summary: &layout::RaySummary) -> RaySummary {
    let layout::RaySummary {
        tau,
        accumulation,
        weighted_distance_m,
        sample_count,
    } = *summary;
    RaySummary {
        tau,
        accumulation,
        weighted_distance_m,
        sample_count,
    }
}
