//! Choosing and opening a GPU adapter.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use backlot_shaders::Kernel;

use super::error::Error;
use super::pipeline::{Pipeline, PipelineCache};
use super::turns::{Gate, Priority, Turn};
use crate::backend::{AdapterChoice, AdapterKind, AdapterRecord};

/// An open device with its queue. Cloning shares it.
#[derive(Clone, Debug)]
pub(super) struct Device {
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) limits: wgpu::Limits,
    info: wgpu::AdapterInfo,
    /// Why the device was lost, once it is.
    lost: Arc<Mutex<Option<String>>>,
    dispatches: Arc<AtomicU64>,
    /// Bytes of the buffers that exist.
    held_bytes: Arc<AtomicU64>,
    gate: Arc<Gate>,
    pipelines: Arc<PipelineCache>,
}

impl Device {
    /// Opens an adapter.
    ///
    /// # Errors
    /// [`Error::NoAdapter`] where it is not there, [`Error::Open`] where the driver refuses.
    pub(super) fn open(choice: &AdapterChoice) -> Result<Self, Error> {
        let found = enumerate();
        let records: Vec<AdapterRecord> = found.iter().map(record).collect();
        let index = choice
            .find(&records)
            .map_err(|reason| Error::NoAdapter { reason })?;
        // The adapter's own limits: wgpu's defaults would cap a binding at 128 MiB on any card.
        Self::from_adapter(&found[index], found[index].limits())
    }

    /// Opens an adapter as if it bound no more than `binding_bytes`.
    #[cfg(test)]
    pub(super) fn open_narrow(choice: &AdapterChoice, binding_bytes: u64) -> Result<Self, Error> {
        let found = enumerate();
        let records: Vec<AdapterRecord> = found.iter().map(record).collect();
        let index = choice
            .find(&records)
            .map_err(|reason| Error::NoAdapter { reason })?;
        let mut limits = found[index].limits();
        limits.max_storage_buffer_binding_size = binding_bytes;
        Self::from_adapter(&found[index], limits)
    }

    fn from_adapter(adapter: &wgpu::Adapter, limits: wgpu::Limits) -> Result<Self, Error> {
        let info = adapter.get_info();
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("backlot"),
            required_features: features_of(adapter),
            required_limits: limits.clone(),
            ..Default::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| {
                Error::Open {
                    adapter: info.name.clone(),
                    reason: error.to_string(),
                }
            })?;
        let lost = Arc::new(Mutex::new(None));
        let record = Arc::clone(&lost);
        device.set_device_lost_callback(move |reason, message| {
            if let Ok(mut lost) = record.lock() {
                *lost = Some(format!("{reason:?}: {message}"));
            }
        });
        // Every call runs in an error scope; what escapes them is logged, where wgpu's default would panic.
        device.on_uncaptured_error(Arc::new(
            |error| tracing::error!(%error, "uncaptured device error"),
        ));
        Ok(Self {
            device,
            queue,
            limits,
            info,
            lost,
            dispatches: Arc::default(),
            held_bytes: Arc::default(),
            gate: Arc::default(),
            pipelines: Arc::default(),
        })
    }

    /// The adapter's name, driver and kind, for people and provenance.
    pub(super) fn description(&self) -> String {
        let wgpu::AdapterInfo {
            name,
            driver,
            driver_info,
            backend,
            device_type,
            ..
        } = &self.info;
        format!("{name} ({device_type:?}, {backend:?}, {driver} {driver_info})")
    }

    /// Largest buffer that a kernel can bind, bytes.
    pub(super) fn max_binding_bytes(&self) -> u64 {
        self.limits
            .max_storage_buffer_binding_size
            .min(self.limits.max_buffer_size)
    }

    /// Runs calls that record no error themselves and turns what the driver says about them into an error of `stage`.
    pub(super) fn checked<T>(
        &self,
        stage: &'static str,
        calls: impl FnOnce() -> T,
    ) -> Result<T, Error> {
        self.alive()?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let value = calls();
        // Scopes are a stack: pop in reverse.
        let validation = pollster::block_on(validation.pop());
        let internal = pollster::block_on(internal.pop());
        let memory = pollster::block_on(memory.pop());
        self.alive()?;
        if memory.is_some() {
            return Err(Error::OutOfMemory {
                stage,
                needed_bytes: 0,
                held_bytes: self.held_bytes.load(Ordering::Relaxed),
            });
        }
        match validation.or(internal) {
            Some(error) => Err(Error::Rejected {
                stage,
                reason: error.to_string(),
            }),
            None => Ok(value),
        }
    }

    /// A kernel compiled for this device, with values for its parameters.
    ///
    /// # Errors
    /// [`Error::Rejected`] where the driver does not take the kernel.
    pub(super) fn pipeline(
        &self,
        kernel: &Kernel,
        parameters: &[(&'static str, f64)],
    ) -> Result<Arc<Pipeline>, Error> {
        self.pipelines.get(self, kernel, parameters)
    }

    /// Waits until the device is the caller's for some tens of milliseconds of work.
    pub(super) fn turn(&self, priority: Priority) -> Turn<'_> {
        self.gate.turn(priority)
    }

    /// Hands what was written to the device, so that its staging memory is freed.
    ///
    /// # Errors
    /// [`Error::Lost`].
    pub(super) fn flush(&self) -> Result<(), Error> {
        self.queue.submit([]);
        self.wait()
    }

    /// Counts a buffer's bytes for as long as the result lives.
    pub(super) fn hold(&self, bytes: u64) -> Held {
        self.held_bytes.fetch_add(bytes, Ordering::Relaxed);
        Held {
            bytes,
            of: Arc::clone(&self.held_bytes),
        }
    }

    pub(super) fn count_dispatch(&self) {
        self.dispatches.fetch_add(1, Ordering::Relaxed);
    }

    /// Kernels dispatched so far.
    pub(super) fn dispatch_count(&self) -> u64 {
        self.dispatches.load(Ordering::Relaxed)
    }

    /// Waits until everything submitted so far is done.
    pub(super) fn wait(&self) -> Result<(), Error> {
        let polled = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.alive()?;
        polled.map(|_| ()).map_err(|error| Error::Rejected {
            stage: "wait",
            reason: error.to_string(),
        })
    }

    /// Whether the device is gone for good.
    pub(super) fn is_lost(&self) -> bool {
        self.alive().is_err()
    }

    /// Waits until a submission and all before it are done.
    pub(super) fn wait_for(&self, submission: wgpu::SubmissionIndex) -> Result<(), Error> {
        let polled = self.device.poll(wgpu::PollType::Wait {
            submission_index: Some(submission),
            timeout: None,
        });
        self.alive()?;
        polled.map(|_| ()).map_err(|error| Error::Rejected {
            stage: "wait",
            reason: error.to_string(),
        })
    }

    /// Whether kernels run on the processor: few threads and large caches, instead of many threads and small ones.
    pub(super) fn is_software(&self) -> bool {
        self.info.device_type == wgpu::DeviceType::Cpu
    }

    /// Processors that a software adapter runs kernels on; `None` on hardware.
    pub(super) fn processors(&self) -> Option<u32> {
        let count = std::thread::available_parallelism().map_or(1, |count| count.get() as u32);
        self.is_software().then_some(count)
    }

    /// Whether kernels run whose threads read together.
    pub(super) fn reads_together(&self) -> bool {
        self.device.features().contains(wgpu::Features::SUBGROUP)
    }

    fn alive(&self) -> Result<(), Error> {
        let lost = self.lost.lock().map_or_else(
            |poisoned| poisoned.into_inner().clone(),
            |lost| lost.clone(),
        );
        match lost {
            Some(reason) => Err(Error::Lost { reason }),
            None => Ok(()),
        }
    }

    /// Destroys the device, as a driver reset would.
    #[cfg(test)]
    pub(super) fn destroy(&self) {
        self.device.destroy();
    }
}

/// Subgroups where they are of use: in software, where threads do not read the same value at once, and wide enough.
fn features_of(adapter: &wgpu::Adapter) -> wgpu::Features {
    let info = adapter.get_info();
    let is_software = info.device_type == wgpu::DeviceType::Cpu;
    if is_software && info.subgroup_min_size >= backlot_shaders::SUBGROUP {
        adapter.features() & wgpu::Features::SUBGROUP
    } else {
        wgpu::Features::empty()
    }
}

/// A buffer's share of the bytes that a device holds.
#[derive(Debug)]
pub(super) struct Held {
    bytes: u64,
    of: Arc<AtomicU64>,
}

impl Drop for Held {
    fn drop(&mut self) {
        self.of.fetch_sub(self.bytes, Ordering::Relaxed);
    }
}

/// The adapters of this machine, best kind first.
pub fn adapters() -> Vec<AdapterRecord> {
    enumerate().iter().map(record).collect()
}

fn enumerate() -> Vec<wgpu::Adapter> {
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let mut adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    // Stable: drivers keep their order within a kind.
    adapters.sort_by_key(|adapter| preference(kind(adapter.get_info().device_type)));
    adapters
}

fn record(adapter: &wgpu::Adapter) -> AdapterRecord {
    let (info, limits) = (adapter.get_info(), adapter.limits());
    AdapterRecord {
        interface: format!("{:?}", info.backend),
        driver: format!("{} {}", info.driver, info.driver_info)
            .trim()
            .to_owned(),
        kind: kind(info.device_type),
        name: info.name,
        max_buffer_bytes: limits.max_buffer_size,
        max_binding_bytes: limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size),
        max_bindings: limits.max_storage_buffers_per_shader_stage,
    }
}

fn kind(device_type: wgpu::DeviceType) -> AdapterKind {
    match device_type {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        wgpu::DeviceType::Other => AdapterKind::Unknown,
    }
}

fn preference(kind: AdapterKind) -> u8 {
    match kind {
        AdapterKind::Discrete => 0,
        AdapterKind::Integrated => 1,
        AdapterKind::Virtual => 2,
        AdapterKind::Software => 3,
        AdapterKind::Unknown => 4,
    }
}
