//! Training on dense grids on the device: the steps of a stage of [`crate::train::train_dvgo`].
//!
//! A step is some batches of rays: march, colour, lose, differentiate, scatter; then the sums and Adam on the bricks that move. Samples, their
//! weights and slots are decided once, by marching, and recorded. Nothing comes back to the host but [`GpuGrid::sums`] and what is fetched
//! between steps.

mod batch;
mod bindings;
#[cfg(test)]
mod inspect;
mod kernels;
mod nodes;
mod params;
mod submit;

use std::time::Duration;

use backlot_shaders::{grid_layout, layout};
use wgpu::BufferUsages;

use batch::{Batch, Capacity};
use bindings::{Bindings, Buffers};
use kernels::GridKernels;
use nodes::Nodes;
use params::{StepRates, batch_params, train_params};

use super::buffer::Buffer;
use super::device::Device;
use super::error::Error;
use super::network::{ResidentNetwork, weight_blocks};
use super::pace::Pace;
use super::sequence::Sequence;
use super::submissions::{Submissions, go_on};
use super::transfer::Transfer;
use crate::field::ColorMlp;
use crate::train::dvgo::{NodeMask, PixelRay, Stage};

/// Sums over the rays of the last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct GridSums {
    /// Sum of the rays' mean squared errors.
    pub(crate) squared_error: f64,
    /// Weighted sum of all losses.
    pub(crate) loss: f64,
    /// The step, counted from 0, whose loss was not finite; nothing has moved since.
    pub(crate) diverged_at: Option<u64>,
}

/// A stage's values on a device with their optimiser state and all buffers of a step.
#[derive(Debug)]
pub(crate) struct GpuGrid {
    device: Device,
    kernels: GridKernels,
    nodes: Nodes,
    step: StepBuffers,
    network: Option<GridNetwork>,
    batch: Batch,
    bindings: Bindings,
    submissions: Submissions,
    pace: Pace,
    /// Rays of the last batch and how long the device was busy with them.
    last_batch: (usize, Duration),
    rays: Vec<grid_layout::PixelRay>,
}

/// Small buffers that outlive a step.
#[derive(Debug)]
struct StepBuffers {
    params: Buffer<grid_layout::GridParams>,
    /// What kernels read that the other trainer has, too.
    train: Buffer<layout::TrainParams>,
    state: Buffer<layout::StepState>,
}

/// The colour network of a stage that has one.
#[derive(Debug)]
struct GridNetwork {
    resident: ResidentNetwork,
    moments: Buffer<layout::Moments>,
}

impl StepBuffers {
    fn new(device: &Device) -> Result<Self, Error> {
        let uniform = BufferUsages::UNIFORM;
        Ok(Self {
            params: Buffer::zeroed(device, "grid parameters", 1, uniform)?,
            train: Buffer::zeroed(device, "train parameters", 1, uniform)?,
            state: Buffer::zeroed(device, "step state", 1, BufferUsages::STORAGE)?,
        })
    }
}

impl GridNetwork {
    fn upload(device: &Device, mlp: &ColorMlp) -> Result<Self, Error> {
        let weights = weight_blocks(mlp.layout()) * backlot_shaders::BLOCK_FLOATS;
        Ok(Self {
            resident: ResidentNetwork::upload(device, mlp)?,
            moments: Buffer::zeroed(device, "network moments", weights, BufferUsages::STORAGE)?,
        })
    }
}

impl GpuGrid {
    /// Uploads a stage for a fresh optimiser. `cancelled` is asked between pieces.
    ///
    /// # Errors
    /// [`Error::TooLarge`] or [`Error::OutOfMemory`] where it does not fit, [`Error::Cancelled`], [`Error::Lost`] and [`Error::Rejected`].
    pub(super) fn open<const C: usize>(
        device: Device,
        stage: &Stage<C>,
        cancelled: &dyn Fn() -> bool,
    ) -> Result<Self, Error> {
        let nodes = Nodes::upload(Transfer::new(&device, cancelled), stage)?;
        let mlp = stage.mlp.as_ref();
        let layout = mlp.map(ColorMlp::layout);
        let kernels = GridKernels::new(&device, nodes.quads.len(), layout)?;
        let step = StepBuffers::new(&device)?;
        let network = mlp
            .map(|mlp| GridNetwork::upload(&device, mlp))
            .transpose()?;
        let capacity = Capacity::new(&device, stage, layout);
        let batch = Batch::new(&device, capacity, layout)?;
        let buffers = Buffers {
            nodes: &nodes,
            step: &step,
            network: network.as_ref(),
            batch: &batch,
        };
        let bindings = Bindings::new(&device, &kernels, buffers)?;
        Ok(Self {
            kernels,
            nodes,
            step,
            network,
            batch,
            bindings,
            submissions: Submissions::default(),
            pace: Pace::new(BATCH, LEAST_RAYS, capacity.rays as usize),
            last_batch: (0, Duration::ZERO),
            rays: Vec::new(),
            device,
        })
    }

    /// Takes an optimiser step on `rays`, the stage's next one, without waiting for its end. The stage's own values are not looked at, but
    /// for shape, shift, rates and age. `cancelled` is asked between submissions.
    ///
    /// # Errors
    /// [`crate::Error::Cancelled`], after which the grid is of no more use, and the device's.
    pub(crate) fn step<const C: usize>(
        &mut self,
        stage: &Stage<C>,
        rays: &[PixelRay],
        cancelled: &dyn Fn() -> bool,
    ) -> crate::Result<()> {
        assert!(
            rays.len() <= stage.recipe.rays,
            "losses have room for the recipe's rays"
        );
        let rates = StepRates::of(stage);
        let mut params = batch_params(stage, rates, self.batch.capacity.samples_per_ray);
        params.has_shares = u32::from(self.nodes.has_shares);
        let train = train_params(rates, rays.len());
        let mut first = 0;
        while first < rays.len() {
            let batch = &rays[first..rays.len().min(first + self.next_batch()?)];
            params.first_ray = first as u32;
            params.ray_count = batch.len() as u32;
            go_on(cancelled)?;
            self.submit_forward(batch, params, train)?;
            go_on(cancelled)?;
            self.submit_backward(params)?;
            self.last_batch = (batch.len(), self.submissions.take_busy());
            first += batch.len();
        }
        self.update(params, cancelled)?;
        self.submissions.take_busy();
        Ok(())
    }

    /// What the last step summed; waits for it.
    ///
    /// # Errors
    /// [`Error::Lost`] and [`Error::Rejected`].
    pub(crate) fn sums(&self) -> Result<GridSums, Error> {
        let state = self.step.state.read(&self.device, 1)?[0];
        Ok(GridSums {
            squared_error: state.squared_error.into(),
            loss: state.loss.into(),
            diverged_at: (state.diverged != 0).then_some(state.finite_steps.into()),
        })
    }

    /// Copies the densities back to the host. `cancelled` is asked between pieces.
    ///
    /// # Errors
    /// [`Error::Cancelled`], [`Error::Lost`] and [`Error::Rejected`].
    pub(crate) fn fetch_density(
        &self,
        density: &mut [f32],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<(), Error> {
        let upload = Transfer::new(&self.device, cancelled);
        self.nodes.fetch_density(upload, density)
    }

    /// Copies the colour values back to the host, as [`Self::fetch_density`].
    ///
    /// # Errors
    /// As [`Self::fetch_density`].
    pub(crate) fn fetch_colors<const C: usize>(
        &self,
        colors: &mut [[f32; C]],
        cancelled: &dyn Fn() -> bool,
    ) -> Result<(), Error> {
        let upload = Transfer::new(&self.device, cancelled);
        self.nodes.fetch_colors(upload, colors)
    }

    /// Copies the weights of the colour network back to the host, if there is one.
    ///
    /// # Errors
    /// [`Error::Lost`] and [`Error::Rejected`].
    pub(crate) fn fetch_network(&self, mlp: Option<&mut ColorMlp>) -> Result<(), Error> {
        match (&self.network, mlp) {
            (Some(network), Some(mlp)) => network.resident.fetch(&self.device, mlp),
            _ => Ok(()),
        }
    }

    /// Takes over a mask of the same shape.
    pub(crate) fn write_mask(&self, mask: &NodeMask) {
        self.nodes.write_mask(&self.device, mask);
    }

    /// Waits for the last batch and says how many rays the next one has.
    fn next_batch(&mut self) -> Result<usize, Error> {
        self.submissions.settle(&self.device)?;
        let (rays, busy) = self.last_batch;
        if rays > 0 {
            let busy = busy + self.submissions.take_busy();
            self.pace = self.pace.after(rays, busy);
            self.last_batch = (0, Duration::ZERO);
        }
        Ok(self.pace.rays().min(self.batch.capacity.rays as usize))
    }

    /// Hands over what `write` returns.
    fn submit(&mut self, write: impl FnOnce(&Self) -> Sequence<'_>) -> Result<(), Error> {
        let mut submissions = std::mem::take(&mut self.submissions);
        let done = submissions.run(&self.device, || write(self));
        self.submissions = submissions;
        done
    }
}

/// A batch is two submissions.
const BATCH: Duration = Duration::from_millis(40);
/// Rays of the first batch, and of every batch at least: 20 ms of a processor in software, a third of it whatever the rays show.
const LEAST_RAYS: usize = 64;
