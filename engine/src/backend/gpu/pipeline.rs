//! Kernels made runnable: explicit bind group layouts, pipelines, dispatches.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use backlot_shaders::{Access, Kernel};

use super::device::Device;
use super::error::Error;

/// A compiled kernel.
#[derive(Debug)]
pub(super) struct Pipeline {
    pipeline: wgpu::ComputePipeline,
    layout: wgpu::BindGroupLayout,
    kernel: Kernel,
}

/// Kernels that a device has compiled, by name and parameters: each is compiled once, when it is first used. Who needs one that is being
/// compiled waits for it, and nobody else does.
#[derive(Debug, Default)]
pub(super) struct PipelineCache {
    slots: Mutex<HashMap<Key, Arc<Slot>>>,
}

/// Empty until its kernel is compiled.
type Slot = Mutex<Option<Arc<Pipeline>>>;

/// A kernel's name and the bits of its parameters.
type Key = (&'static str, Vec<u64>);

impl PipelineCache {
    /// # Errors
    /// As [`Pipeline::with`].
    pub(super) fn get(
        &self,
        device: &Device,
        kernel: &Kernel,
        parameters: &[(&'static str, f64)],
    ) -> Result<Arc<Pipeline>, Error> {
        let values = parameters.iter().map(|(_, value)| value.to_bits());
        let key = (kernel.name, values.collect());
        let slot = {
            let mut slots = self.slots.lock().unwrap_or_else(PoisonError::into_inner);
            Arc::clone(slots.entry(key).or_default())
        };
        // A panic while compiling leaves the slot empty.
        let mut compiled = slot.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = &*compiled {
            return Ok(Arc::clone(found));
        }
        let pipeline = Arc::new(Pipeline::with(device, kernel, parameters)?);
        *compiled = Some(Arc::clone(&pipeline));
        Ok(pipeline)
    }
}

/// Workgroups of a dispatch over one thread an item, folded into two dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Groups {
    pub(super) x: u32,
    pub(super) y: u32,
}

impl Groups {
    /// Enough workgroups of `size` for `items`, at most `max_x` along x.
    pub(super) fn cover(items: u32, size: u32, max_x: u32) -> Self {
        let groups = items.div_ceil(size).max(1);
        let y = groups.div_ceil(max_x);
        Self {
            x: groups.div_ceil(y),
            y,
        }
    }
}

impl Pipeline {
    /// Compiles `kernel` with the layout that its table row states and values for its parameters.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take the kernel.
    fn with(
        device: &Device,
        kernel: &Kernel,
        parameters: &[(&'static str, f64)],
    ) -> Result<Self, Error> {
        let names = parameters.iter().map(|(name, _)| name);
        assert!(
            names.eq(kernel.parameters),
            "{}: its parameters are {:?}",
            kernel.name,
            kernel.parameters
        );
        let storage = kernel.bindings.iter();
        let needed = storage.filter(|b| b.access != Access::Uniform).count();
        let available = device.limits.max_storage_buffers_per_shader_stage as usize;
        if needed > available {
            return Err(Error::Rejected {
                stage: kernel.name,
                reason: format!("it binds {needed} buffers, the adapter binds {available}"),
            });
        }
        if kernel.uses_subgroup && !device.reads_together() {
            return Err(Error::Rejected {
                stage: kernel.name,
                reason: format!(
                    "it needs subgroups of {} threads or more",
                    backlot_shaders::SUBGROUP
                ),
            });
        }
        let entries: Vec<_> = (0..)
            .zip(kernel.bindings)
            .map(|(number, binding)| layout_entry(number, binding))
            .collect();
        let mut constants = kernel.constants();
        constants.extend_from_slice(parameters);
        let (pipeline, layout) = device.checked(kernel.name, || {
            let module = device
                .device
                .create_shader_module(wgpu::ShaderModuleDescriptor {
                    label: Some(kernel.name),
                    source: wgpu::ShaderSource::Wgsl(kernel.source.into()),
                });
            let layout = device
                .device
                .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                    label: Some(kernel.name),
                    entries: &entries,
                });
            let pipeline_layout =
                device
                    .device
                    .create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                        label: Some(kernel.name),
                        bind_group_layouts: &[Some(&layout)],
                        immediate_size: 0,
                    });
            let pipeline =
                device
                    .device
                    .create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                        label: Some(kernel.name),
                        layout: Some(&pipeline_layout),
                        module: &module,
                        entry_point: Some(kernel.entry),
                        compilation_options: wgpu::PipelineCompilationOptions {
                            constants: &constants,
                            ..Default::default()
                        },
                        cache: None,
                    });
            (pipeline, layout)
        })?;
        Ok(Self {
            pipeline,
            layout,
            kernel: *kernel,
        })
    }

    pub(super) fn name(&self) -> &'static str {
        self.kernel.name
    }

    pub(super) fn groups(&self, device: &Device, items: u32) -> Groups {
        Groups::cover(
            items,
            self.kernel.workgroup_size,
            device.limits.max_compute_workgroups_per_dimension,
        )
    }

    /// Runs the kernel over `groups` with `buffers` in the order of its bindings, and does not wait.
    ///
    /// # Errors
    /// [`Error::Lost`] or [`Error::Rejected`].
    pub(super) fn dispatch(
        &self,
        device: &Device,
        groups: Groups,
        buffers: &[&wgpu::Buffer],
    ) -> Result<(), Error> {
        let label = Some(self.kernel.name);
        device.checked(self.kernel.name, || {
            let group = self.group(device, buffers);
            let mut encoder = device
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor { label });
            self.encode(&mut encoder, &group, groups);
            device.queue.submit([encoder.finish()]);
        })?;
        device.count_dispatch();
        Ok(())
    }

    /// Puts `buffers`, in the order of the kernel's bindings, together for many dispatches.
    ///
    /// # Errors
    /// [`Error::Lost`] or [`Error::Rejected`].
    pub(super) fn bind(
        &self,
        device: &Device,
        buffers: &[&wgpu::Buffer],
    ) -> Result<wgpu::BindGroup, Error> {
        device.checked(self.kernel.name, || self.group(device, buffers))
    }

    fn group(&self, device: &Device, buffers: &[&wgpu::Buffer]) -> wgpu::BindGroup {
        assert_eq!(
            buffers.len(),
            self.kernel.bindings.len(),
            "{}: buffers and bindings",
            self.kernel.name
        );
        let entries: Vec<_> = (0..)
            .zip(buffers)
            .map(|(binding, buffer)| wgpu::BindGroupEntry {
                binding,
                resource: buffer.as_entire_binding(),
            })
            .collect();
        device.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(self.kernel.name),
            layout: &self.layout,
            entries: &entries,
        })
    }

    /// Adds the kernel's run to a list of commands.
    pub(super) fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        bound: &wgpu::BindGroup,
        groups: Groups,
    ) {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor {
            label: Some(self.kernel.name),
            timestamp_writes: None,
        });
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, bound, &[]);
        pass.dispatch_workgroups(groups.x, groups.y, 1);
    }
}

fn layout_entry(number: u32, binding: &backlot_shaders::Binding) -> wgpu::BindGroupLayoutEntry {
    let ty = match binding.access {
        Access::Uniform => wgpu::BufferBindingType::Uniform,
        Access::Read => wgpu::BufferBindingType::Storage { read_only: true },
        Access::ReadWrite => wgpu::BufferBindingType::Storage { read_only: false },
    };
    wgpu::BindGroupLayoutEntry {
        binding: number,
        visibility: wgpu::ShaderStages::COMPUTE,
        ty: wgpu::BindingType::Buffer {
            ty,
            has_dynamic_offset: false,
            min_binding_size: std::num::NonZeroU64::new(binding.min_bytes),
        },
        count: None,
    }
}

#[cfg(test)]
mod tests {
    use super::Groups;

    #[test]
    fn groups_cover_every_item_within_the_limit() {
        for items in [0, 1, 64, 65, 4096, 64 * 65_535, 64 * 65_535 + 1, u32::MAX] {
            let groups = Groups::cover(items, 64, 65_535);
            assert!(
                groups.x <= 65_535 && groups.y <= 65_535,
                "{items}: {groups:?}"
            );
            assert!(
                u64::from(groups.x) * u64::from(groups.y) * 64 >= u64::from(items),
                "{items}: {groups:?}"
            );
        }
    }
}
