//! Training on the device.
//!
//! A step is a few batches of rays, each one submission: march, composite, gather features, colour, lose, differentiate, scatter;
//! and one more that sums the losses and moves all parameters. Samples, their weights and what is coloured are decided once
//! and recorded. Nothing comes back to the host but [`GpuTrainer::sums`] and, before bricks change, [`GpuTrainer::fetch`].

mod batch;
mod bindings;
#[cfg(test)]
mod inspect;
mod kernels;
mod lattices;
pub(super) mod network;
mod rays;
mod sky;
mod state;

use std::sync::Arc;

use backlot_shaders::layout;
use wgpu::BufferUsages;

use batch::{Batch, Capacity, most_samples};
use bindings::{Bindings, Buffers};
pub(super) use kernels::KernelCache;
use kernels::TrainKernels;
use lattices::{Lattices, LevelSquares};
use network::{ResidentNetwork, gradient_tiles, layer_params};
use rays::{march_ray, step_params, target};
use sky::Sky;
use state::StepBuffers;

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::pipeline::Groups;
use super::sequence::Sequence;
use super::turns::Priority;
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
    kernels: Arc<TrainKernels>,
    /// As of the last [`Self::fetch`], but for the bricks, which are always up to date.
    field: Field,
    squares: Vec<LevelSquares>,
    march_params: Buffer<layout::MarchParams>,
    step: StepBuffers,
    network: ResidentNetwork,
    sky: Sky,
    /// `None` after bricks changed.
    lattices: Option<Lattices>,
    batch: Option<Batch>,
    /// Of the two above.
    bindings: Option<Bindings>,
    samples_per_ray: u32,
    steps: u64,
    /// The device may be one submission behind the host.
    pending: Option<wgpu::SubmissionIndex>,
    march_rays: Vec<layout::Ray>,
    targets: Vec<layout::RayTarget>,
}

impl GpuTrainer {
    /// Uploads a field.
    ///
    /// # Errors
    /// [`Error::TooLarge`] or [`Error::OutOfMemory`] where it does not fit, [`Error::Lost`] and [`Error::Rejected`].
    pub(super) fn new(device: Device, kernels: &KernelCache, field: Field) -> Result<Self, Error> {
        let kernels = kernels.get(&device, field.mlp.layout())?;
        Self::with_kernels(device, kernels, field)
    }

    /// [`Self::new`] whose colour network takes four samples a thread, or one, whatever suits the device.
    pub(super) fn with_variant(
        device: Device,
        field: Field,
        takes_four: bool,
    ) -> Result<Self, Error> {
        let kernels = TrainKernels::new(&device, field.mlp.layout(), takes_four)?;
        Self::with_kernels(device, Arc::new(kernels), field)
    }

    fn with_kernels(
        device: Device,
        kernels: Arc<TrainKernels>,
        field: Field,
    ) -> Result<Self, Error> {
        let network = field.mlp.layout();
        let mut trainer = Self {
            kernels,
            march_params: Buffer::zeroed(&device, "march parameters", 1, BufferUsages::UNIFORM)?,
            step: StepBuffers::new(&device, network)?,
            network: ResidentNetwork::upload(&device, &field.mlp)?,
            sky: Sky::upload(&device, &field)?,
            squares: vec![LevelSquares::default(); field.levels.len()],
            lattices: None,
            batch: None,
            bindings: None,
            samples_per_ray: 0,
            steps: 0,
            pending: None,
            march_rays: Vec::new(),
            targets: Vec::new(),
            field,
            device,
        };
        trainer.upload(1)?;
        Ok(trainer)
    }

    /// The field as of the last [`Self::fetch`].
    pub fn field(&self) -> &Field {
        &self.field
    }

    pub fn into_field(self) -> Field {
        self.field
    }

    /// Kernels dispatched on the device so far, by whomever.
    pub fn dispatch_count(&self) -> u64 {
        self.device.dispatch_count()
    }

    /// Brings the device's parameters and optimiser state to the host.
    ///
    /// # Errors
    /// [`Error::Lost`] and [`Error::Rejected`].
    pub fn fetch(&mut self) -> Result<(), Error> {
        if let Some(lattices) = &self.lattices {
            lattices.fetch(&self.device, &mut self.field, &mut self.squares)?;
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

    /// Takes one optimiser step on `rays`, without waiting for its end. `cancelled` is asked between batches.
    ///
    /// With `trim_quantile` above 0, rays whose range error exceeded that quantile of the previous step's are outliers, and
    /// [`RayLosses::depth_trim_m`] is ignored.
    ///
    /// # Errors
    /// [`crate::Error::Invalid`] for rates of exposures or poses, [`crate::Error::Cancelled`], after which the trainer is of no more
    /// use, and the device's.
    pub fn step(
        &mut self,
        rays: &[TrainRay],
        losses: &RayLosses,
        rates: Rates,
        trim_quantile: f64,
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<()> {
        if rates.exposure > 0.0 || rates.pose_m > 0.0 {
            return Err(crate::Error::invalid(
                "views' exposures and poses are learned on the processor only: choose device cpu",
            ));
        }
        self.upload(rays.len())?;
        let mut params = step_params(&self.field, losses, rates, self.steps);
        params.step_ray_count = rays.len() as u32;
        params.trim_quantile = trim_quantile as f32;
        let batch = self
            .batch
            .as_ref()
            .map_or(1, |batch| batch.capacity.rays as usize);
        for (number, rays) in rays.chunks(batch).enumerate() {
            if cancelled() {
                return Err(crate::Error::Cancelled);
            }
            params.first_ray = (number * batch) as u32;
            params.ray_count = rays.len() as u32;
            self.submit_batch(rays, params)?;
        }
        self.submit_update(params)?;
        self.steps += 1;
        Ok(())
    }

    /// The colours of all samples of `rays`, for timing; waits for them.
    ///
    /// # Errors
    /// The device's.
    #[doc(hidden)]
    pub fn forward(&mut self, rays: &[TrainRay], losses: &RayLosses) -> Result<(), Error> {
        self.upload(rays.len())?;
        let mut params = step_params(&self.field, losses, Rates::default(), 0);
        let batch = self
            .batch
            .as_ref()
            .map_or(1, |batch| batch.capacity.rays as usize);
        for rays in rays.chunks(batch) {
            params.ray_count = rays.len() as u32;
            self.submit_forward(rays, params)?;
        }
        self.device.wait()
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
    fn upload(&mut self, rays: usize) -> Result<(), Error> {
        if self.lattices.is_none() {
            let (field, squares) = (&self.field, &mut self.squares);
            self.lattices = Some(Lattices::upload(&self.device, field, squares)?);
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
            let buffers = Buffers {
                march_params: &self.march_params,
                lattices,
                network: &self.network,
                sky: &self.sky,
                batch,
                step: &self.step,
            };
            self.bindings = Some(Bindings::new(&self.device, &self.kernels, buffers)?);
        }
        Ok(())
    }

    /// What [`Self::upload`] made.
    fn resident(&self) -> (&Lattices, &Batch, &Bindings) {
        match (&self.lattices, &self.batch, &self.bindings) {
            (Some(lattices), Some(batch), Some(bindings)) => (lattices, batch, bindings),
            _ => unreachable!("a step uploads first"),
        }
    }

    /// Adds the gradients of a batch of rays to those of the step.
    fn submit_batch(
        &mut self,
        rays: &[TrainRay],
        params: layout::TrainParams,
    ) -> Result<(), Error> {
        self.submit_forward(rays, params)?;
        self.submit_backward(rays.len())
    }

    /// From rays to the colours of their samples.
    fn submit_forward(
        &mut self,
        rays: &[TrainRay],
        params: layout::TrainParams,
    ) -> Result<(), Error> {
        let gate = self.device.clone();
        let _turn = gate.turn(Priority::Training);
        self.march_rays.clear();
        self.march_rays.extend(rays.iter().map(march_ray));
        self.targets.clear();
        self.targets.extend(rays.iter().map(target));
        let (device, kernels) = (&self.device, &self.kernels);
        let (lattices, batch, bindings) = self.resident();
        let samples_per_ray = batch.capacity.samples_per_ray;
        let march_groups = kernels.march.groups(device, rays.len() as u32);
        let march = layout::MarchParams {
            ray_count: rays.len() as u32,
            sample_capacity: samples_per_ray,
            groups_x: march_groups.x,
            ..lattices.params
        };
        let params = layout::TrainParams {
            sample_capacity: samples_per_ray,
            ..params
        };
        batch.rays.write(device, &self.march_rays);
        batch.targets.write(device, &self.targets);
        self.march_params.write(device, &[march]);
        self.step.params.write(device, &[params]);
        let free = free_groups(device);
        let per_ray = kernels.composite.groups(device, rays.len() as u32);
        let mut sequence = Sequence::new(device, "training batch, forward");
        // The step's counts follow the batch's.
        let counters = if params.first_ray == 0 { 16 } else { 8 };
        sequence.clear(&batch.counters.raw, counters);
        sequence.run(&kernels.march, &bindings.march, march_groups);
        sequence.run(&kernels.composite, &bindings.composite, per_ray);
        sequence.run(&kernels.gather, &bindings.gather, free);
        sequence.run(&kernels.forward, &bindings.forward, free);
        let submission = sequence.submit()?;
        self.wait_for_last(submission)
    }

    /// From losses to gradients by all parameters.
    fn submit_backward(&mut self, rays: usize) -> Result<(), Error> {
        let gate = self.device.clone();
        let _turn = gate.turn(Priority::Training);
        let (device, kernels) = (&self.device, &self.kernels);
        let (_, batch, bindings) = self.resident();
        let per_ray = kernels.losses.groups(device, rays as u32);
        let free = free_groups(device);
        let mut sequence = Sequence::new(device, "training batch, backward");
        sequence.run(&kernels.losses, &bindings.losses, per_ray);
        sequence.run(&kernels.backward, &bindings.backward, free);
        let layers = layer_params(self.field.mlp.layout());
        for (layer, bound) in layers.iter().zip(&bindings.layer_gradients) {
            let threads = gradient_tiles(layer) * batch.capacity.shares;
            let groups = kernels.layer_gradients.groups(device, threads);
            sequence.run(&kernels.layer_gradients, bound, groups);
        }
        sequence.run(&kernels.scatter, &bindings.scatter, free);
        let submission = sequence.submit()?;
        self.wait_for_last(submission)
    }

    /// Sums the step's losses and moves all parameters against their gradients.
    fn submit_update(&mut self, params: layout::TrainParams) -> Result<(), Error> {
        let gate = self.device.clone();
        let _turn = gate.turn(Priority::Training);
        let (device, kernels) = (&self.device, &self.kernels);
        let (lattices, _, bindings) = self.resident();
        self.step.params.write(device, &[params]);
        let free = free_groups(device);
        let weights = self.network.weights.len() * backlot_shaders::BLOCK_FLOATS;
        let per_weight = kernels.step_network.groups(device, weights as u32);
        let mut sequence = Sequence::new(device, "training update");
        sequence.run(&kernels.sum, &bindings.sum, Groups { x: 1, y: 1 });
        sequence.run(&kernels.step_bricks, &bindings.step_bricks, free);
        if params.density_variation_rate > 0.0 || params.feature_variation_rate > 0.0 {
            sequence.run(&kernels.variation, &bindings.variation, free);
            sequence.run(&kernels.smooth, &bindings.smooth, free);
        }
        sequence.clear(&lattices.touched_bricks.raw, 4);
        sequence.run(&kernels.step_network, &bindings.step_network, per_weight);
        self.network.spread(&mut sequence);
        if params.sky_texel_count > 0 {
            sequence.run(&kernels.step_sky, &bindings.step_sky, free);
        }
        let submission = sequence.submit()?;
        self.wait_for_last(submission)
    }

    /// Lets the device be at most one submission behind, or a cancelled run would go on for long.
    fn wait_for_last(&mut self, submission: wgpu::SubmissionIndex) -> Result<(), Error> {
        match self.pending.replace(submission) {
            Some(last) => self.device.wait_for(last),
            None => Ok(()),
        }
    }
}

/// Workgroups of kernels that take items until there are no more.
fn free_groups(device: &Device) -> Groups {
    let x = if device.is_software() { 32 } else { 4096 };
    Groups { x, y: 1 }
}
