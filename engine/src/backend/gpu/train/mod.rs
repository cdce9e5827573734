//! Training on the device.
//!
//! A step is some batches of rays: march, composite, gather features, colour, lose, differentiate, scatter; then an update that sums the
//! losses and moves all parameters. All of it is handed out in submissions of some tens of milliseconds. Samples, their weights and what
//! is coloured are decided once and recorded. Nothing comes back to the host but [`GpuTrainer::sums`] and, before bricks change,
//! [`GpuTrainer::fetch`].

mod batch;
mod bindings;
#[cfg(test)]
mod inspect;
mod kernels;
mod lattices;
mod part_bindings;
pub(super) mod rays;
mod sky;
mod squares;
mod state;
mod update;
mod views;

use std::sync::Arc;
use std::time::Duration;

use backlot_shaders::layout;
use wgpu::BufferUsages;

use batch::{Batch, Capacity, most_samples};
use bindings::{Bindings, Buffers};
use kernels::TrainKernels;
use lattices::Lattices;
use rays::{march_ray, step_params, target};
use sky::Sky;
use squares::LevelSquares;
use state::StepBuffers;
use views::Views;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::free_groups;
use super::kernel_times::KernelTimes;
use super::network::{self, ResidentNetwork};
use super::pace::Pace;
use super::pipeline::Pipeline;
use super::sequence::Sequence;
use super::submissions::{Submissions, go_on};
use super::transfer::Transfer;
use crate::backend::cpu::ViewCorrection;
use crate::field::Field;
use crate::train::ray::{Rates, RayLosses, TrainRay};

/// Sums over the rays of the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GpuSums {
    pub color_rays: u64,
    /// Sum of the colour rays' mean squared errors.
    pub squared_error: f64,
    /// Weighted sum of all losses.
    pub loss: f64,
    /// Samples marched, and those coloured.
    pub samples: u64,
    pub colored: u64,
    /// The step, counted from 0, whose loss was not finite; nothing has moved since.
    pub diverged_at: Option<u64>,
}

/// A field on a device with its optimiser state and all buffers of a step. Mirrors [`crate::backend::cpu::CpuTrainer`], in f32.
#[derive(Debug)]
pub struct GpuTrainer {
    device: Device,
    kernels: TrainKernels,
    /// Whether the colour network takes four samples a thread.
    takes_four: bool,
    /// As of the last [`Self::fetch`], but for the bricks, which are always up to date.
    field: Field,
    squares: Vec<LevelSquares>,
    march_params: Buffer<layout::MarchParams>,
    step: StepBuffers,
    network: ResidentNetwork,
    sky: Sky,
    views: Views,
    /// `None` after bricks changed.
    lattices: Option<Lattices>,
    batch: Option<Batch>,
    /// Of the above.
    bindings: Option<Bindings>,
    /// Takes the place of the network's kernel where no backward pass follows.
    colors_alone: Option<(Arc<Pipeline>, wgpu::BindGroup)>,
    samples_per_ray: u32,
    steps: u64,
    submissions: Submissions,
    pace: Pace,
    /// Rays of the last batch and how long the device was busy with them.
    last_batch: (usize, Duration),
    march_rays: Vec<layout::Ray>,
    targets: Vec<layout::RayTarget>,
}

impl GpuTrainer {
    /// Uploads a field. `cancelled` is asked between pieces.
    ///
    /// # Errors
    /// [`Error::TooLarge`] or [`Error::OutOfMemory`] where it does not fit, [`Error::Cancelled`], [`Error::Lost`] and [`Error::Rejected`].
    pub(super) fn new(
        device: Device,
        field: Field,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, Error> {
        // Reading a weight is broadcast for free on a GPU, and dearer than using it in software.
        let takes_four = device.reads_together();
        Self::with_variant(device, field, takes_four, cancelled)
    }

    /// [`Self::new`] whose colour network takes four samples a thread, or one, whatever suits the device.
    pub(super) fn with_variant(
        device: Device,
        field: Field,
        takes_four: bool,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, Error> {
        let network = field.mlp.layout();
        let mut squares = vec![LevelSquares::default(); field.levels.len()];
        let lattices = Lattices::upload(Transfer::new(&device, cancelled), &field, &mut squares)?;
        let mut trainer = Self {
            kernels: TrainKernels::new(&device, &lattices.shape, network, takes_four)?,
            takes_four,
            march_params: Buffer::zeroed(&device, "march parameters", 1, BufferUsages::UNIFORM)?,
            step: StepBuffers::new(&device, network)?,
            network: ResidentNetwork::upload(&device, &field.mlp)?,
            sky: Sky::upload(&device, &field)?,
            views: Views::new(&device)?,
            squares,
            samples_per_ray: most_samples(&field),
            lattices: Some(lattices),
            batch: None,
            bindings: None,
            colors_alone: None,
            steps: 0,
            submissions: Submissions::default(),
            pace: Pace::new(BATCH, LEAST_RAYS, MOST_RAYS),
            last_batch: (0, Duration::ZERO),
            march_rays: Vec::new(),
            targets: Vec::new(),
            field,
            device,
        };
        trainer.upload(1, cancelled)?;
        Ok(trainer)
    }

    /// The field as of the last [`Self::fetch`].
    pub fn field(&self) -> &Field {
        &self.field
    }

    pub fn into_field(self) -> Field {
        self.field
    }

    /// Corrections of the views by number, for those that had a ray while their rates were not 0; waits for the device.
    ///
    /// # Errors
    /// [`Error::Lost`] and [`Error::Rejected`].
    pub fn view_corrections(&self) -> Result<Vec<ViewCorrection>, Error> {
        self.views.fetch(&self.device)
    }

    /// Kernels dispatched on the device so far, by whomever.
    pub fn dispatch_count(&self) -> u64 {
        self.device.dispatch_count()
    }

    /// Brings the device's parameters and optimiser state to the host. `cancelled` is asked between pieces; some have come by then.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Lost`] and [`Error::Rejected`].
    pub fn fetch(&mut self, cancelled: &dyn Fn() -> bool) -> Result<(), Error> {
        if let Some(lattices) = &self.lattices {
            let pieces = Transfer::new(&self.device, cancelled);
            lattices.fetch(pieces, &mut self.field, &mut self.squares)?;
            self.network.fetch(&self.device, &mut self.field.mlp)?;
            self.sky.fetch(&self.device, &mut self.field)?;
        }
        Ok(())
    }

    /// Changes the occupancy or adds bricks between steps, after [`Self::fetch`]; the next step uploads the field. Removing bricks
    /// is [`Self::retain_bricks`].
    pub fn field_mut(&mut self) -> &mut Field {
        self.lattices = None;
        &mut self.field
    }

    /// Drops the bricks of a level for which `keep` does not hold, with their optimiser state, after [`Self::fetch`].
    pub fn retain_bricks(&mut self, level: usize, keep: impl Fn(u32) -> bool) {
        self.lattices = None;
        let old_of_new = self.field.levels[level].retain(keep);
        self.squares[level].retain(&old_of_new);
    }

    /// Takes one optimiser step on `rays`, without waiting for its end. `cancelled` is asked between submissions.
    ///
    /// With `trim_quantile` above 0, rays whose range error exceeded that quantile of the previous step's are outliers, and
    /// [`RayLosses::depth_trim_m`] is ignored.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], after which the trainer is of no more use, and the device's.
    pub fn step(
        &mut self,
        rays: &[TrainRay],
        losses: &RayLosses,
        rates: Rates,
        trim_quantile: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<()> {
        if self.views.prepare(&self.device, rays, rates)? {
            self.bindings = None;
        }
        self.upload(rays.len(), cancelled)?;
        let mut params = step_params(&self.field, losses, rates, self.steps);
        params.step_ray_count = rays.len() as u32;
        params.trim_quantile = trim_quantile as f32;
        self.views.begin_step(losses, rates, &mut params);
        let mut first = 0;
        while first < rays.len() {
            let batch = &rays[first..rays.len().min(first + self.next_batch()?)];
            params.first_ray = first as u32;
            params.ray_count = batch.len() as u32;
            go_on(cancelled)?;
            self.submit_forward(batch, params)?;
            go_on(cancelled)?;
            self.submit_backward(params)?;
            self.last_batch = (batch.len(), self.submissions.take_busy());
            first += batch.len();
        }
        self.update(params, cancelled)?;
        self.submissions.take_busy();
        self.steps += 1;
        Ok(())
    }

    /// What each kernel of a step takes on `clock`, for tuning: they run one by one.
    ///
    /// # Errors
    /// As [`Self::step`].
    #[doc(hidden)]
    pub fn kernel_times(
        &mut self,
        rays: &[TrainRay],
        losses: &RayLosses,
        rates: Rates,
        clock: fn() -> Duration,
    ) -> crate::Result<KernelTimes> {
        self.submissions.time_kernels(Some(KernelTimes::new(clock)));
        let stepped = self.step(rays, losses, rates, 0.0, &|| false);
        let times = self.submissions.time_kernels(None);
        stepped.map(|()| times.unwrap_or_else(|| KernelTimes::new(clock)))
    }

    /// Waits for the last batch and says how many rays the next one has.
    fn next_batch(&mut self) -> Result<usize, Error> {
        self.submissions.settle(&self.device)?;
        let (rays, busy) = self.last_batch;
        // Kernels that run one by one say nothing about those that do not.
        if rays > 0 && !self.submissions.times_kernels() {
            let busy = busy + self.submissions.take_busy();
            self.pace = self.pace.after(rays, busy);
            self.last_batch = (0, Duration::ZERO);
        }
        let room = self.resident().1.capacity.rays as usize;
        Ok(self.pace.rays().min(room))
    }

    /// The colours of all samples of `rays`, for timing; waits for them. Returns how many there are.
    ///
    /// # Errors
    /// The device's.
    #[doc(hidden)]
    pub fn forward(&mut self, rays: &[TrainRay], losses: &RayLosses) -> Result<u64, Error> {
        self.upload(rays.len(), &|| false)?;
        let network = self.field.mlp.layout();
        let kernel = network::kernels::forward(&self.device, network, self.takes_four, false)?;
        let (lattices, batch, _) = self.resident();
        let buffers = bindings::network(self.buffers(lattices, batch));
        let bound = network::bindings::forward(&self.device, &kernel, buffers)?;
        let room = batch.capacity.rays as usize;
        self.colors_alone = Some((kernel, bound));
        let mut params = step_params(&self.field, losses, Rates::default(), 0);
        for rays in rays.chunks(room) {
            params.ray_count = rays.len() as u32;
            self.submit_forward(rays, params)?;
            params.first_ray += params.ray_count;
        }
        self.colors_alone = None;
        self.submissions.settle(&self.device)?;
        let counters = self.resident().1.counters.read(&self.device, 4)?;
        Ok(counters[STEP_COLORED_COUNT].into())
    }

    /// What the last step summed; waits for it.
    ///
    /// # Errors
    /// [`Error::Lost`] and [`Error::Rejected`].
    pub fn sums(&self) -> Result<GpuSums, Error> {
        let state = self.step.state.read(&self.device, 1)?[0];
        Ok(GpuSums {
            color_rays: state.color_rays.into(),
            squared_error: state.squared_error.into(),
            loss: state.loss.into(),
            samples: state.samples.into(),
            colored: state.colored.into(),
            diverged_at: (state.diverged != 0).then_some(state.finite_steps.into()),
        })
    }

    /// Makes the field and room for `rays` rays a step resident, unless they are.
    fn upload(&mut self, rays: usize, cancelled: &dyn Fn() -> bool) -> Result<(), Error> {
        if self.lattices.is_none() {
            let (field, squares) = (&self.field, &mut self.squares);
            let upload = Transfer::new(&self.device, cancelled);
            let lattices = Lattices::upload(upload, field, squares)?;
            let network = field.mlp.layout();
            self.kernels =
                TrainKernels::new(&self.device, &lattices.shape, network, self.takes_four)?;
            self.lattices = Some(lattices);
            self.samples_per_ray = most_samples(field);
            self.bindings = None;
        }
        let wanted = Capacity::new(
            &self.device,
            self.field.mlp.layout(),
            self.samples_per_ray,
            rays,
        );
        if self
            .batch
            .as_ref()
            .is_none_or(|batch| !batch.capacity.holds(wanted))
        {
            // Dropped first, so that both need not fit.
            self.batch = None;
            self.batch = Some(Batch::new(&self.device, wanted, self.field.mlp.layout())?);
            self.bindings = None;
        }
        if self.bindings.is_none()
            && let (Some(lattices), Some(batch)) = (&self.lattices, &self.batch)
        {
            let buffers = self.buffers(lattices, batch);
            self.bindings = Some(Bindings::new(&self.device, &self.kernels, buffers)?);
        }
        Ok(())
    }

    fn buffers<'a>(&'a self, lattices: &'a Lattices, batch: &'a Batch) -> Buffers<'a> {
        Buffers {
            march_params: &self.march_params,
            lattices,
            network: &self.network,
            sky: &self.sky,
            views: self.views.on_device(),
            batch,
            step: &self.step,
        }
    }

    /// What [`Self::upload`] made.
    fn resident(&self) -> (&Lattices, &Batch, &Bindings) {
        match (&self.lattices, &self.batch, &self.bindings) {
            (Some(lattices), Some(batch), Some(bindings)) => (lattices, batch, bindings),
            _ => unreachable!("a step uploads first"),
        }
    }

    /// Hands over what `write` returns.
    fn submit(&mut self, write: impl FnOnce(&Self) -> Sequence<'_>) -> Result<(), Error> {
        let mut submissions = std::mem::take(&mut self.submissions);
        let done = submissions.run(&self.device, || write(self));
        self.submissions = submissions;
        done
    }

    /// From rays to the colours of their samples.
    fn submit_forward(
        &mut self,
        rays: &[TrainRay],
        params: layout::TrainParams,
    ) -> Result<(), Error> {
        self.march_rays.clear();
        self.march_rays.extend(rays.iter().map(march_ray));
        self.targets.clear();
        self.targets.extend(rays.iter().map(target));
        self.submit(|trainer| {
            let (device, kernels) = (&trainer.device, &trainer.kernels);
            let (lattices, batch, bindings) = trainer.resident();
            let march_groups = kernels.march.groups(device, params.ray_count);
            let march = layout::MarchParams {
                ray_count: params.ray_count,
                sample_capacity: batch.capacity.samples_per_ray,
                groups_x: march_groups.x,
                ..lattices.shape.params
            };
            batch.rays.write(device, &trainer.march_rays);
            batch.targets.write(device, &trainer.targets);
            trainer.march_params.write(device, &[march]);
            trainer.step.params.write(device, &[batch.params(params)]);
            let free = free_groups(device);
            let per_ray = kernels.composite.groups(device, params.ray_count);
            let mut sequence = Sequence::new(device, "training batch, forward");
            // The step's counts follow the batch's.
            let counters = if params.first_ray == 0 { 16 } else { 8 };
            sequence.clear(&batch.counters.raw, counters);
            if params.view_count > 0 {
                sequence.run(&kernels.correct, &bindings.correct, per_ray);
            }
            sequence.run(&kernels.march, &bindings.march, march_groups);
            sequence.run(&kernels.composite, &bindings.composite, per_ray);
            for part in &bindings.parts {
                sequence.run(&kernels.gather, &part.gather, free);
            }
            match &trainer.colors_alone {
                Some((kernel, bound)) => sequence.run(kernel, bound, free),
                None => {
                    let (kernel, bound) = (&kernels.network.forward, &bindings.network.forward);
                    sequence.run(kernel, bound, free);
                }
            }
            sequence
        })
    }

    /// From losses to gradients by all parameters.
    fn submit_backward(&mut self, params: layout::TrainParams) -> Result<(), Error> {
        self.submit(|trainer| {
            let (device, kernels) = (&trainer.device, &trainer.kernels);
            let (_, batch, bindings) = trainer.resident();
            let per_ray = kernels.losses.groups(device, params.ray_count);
            let free = free_groups(device);
            let mut sequence = Sequence::new(device, "training batch, backward");
            sequence.run(&kernels.losses, &bindings.losses, per_ray);
            let shares = batch.capacity.shares;
            kernels
                .network
                .run_backward(device, &mut sequence, &bindings.network, shares);
            for part in &bindings.parts {
                sequence.run(&kernels.scatter, &part.scatter, free);
                if params.pose_rate > 0.0 {
                    sequence.run(&kernels.poses, &part.poses, per_ray);
                }
            }
            sequence
        })
    }
}

/// Where the counters of a batch count what the whole step has coloured.
const STEP_COLORED_COUNT: usize = 2;
/// A batch is two submissions.
const BATCH: Duration = Duration::from_millis(40);
/// Rays of the first batch, and of every batch at least: 20 ms of a processor in software, a third of it whatever the rays show.
const LEAST_RAYS: usize = 64;
/// More than there is room for, or than a step has.
const MOST_RAYS: usize = 1 << 20;
