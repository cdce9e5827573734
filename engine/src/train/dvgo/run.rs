//! Both stages, one after the other.

use glam::{DVec3, UVec3};

use super::finish::{cubic_box, field_of};
use super::framing::Framing;
use super::grid::Shape;
use super::mask::NodeMask;
use super::network::initial_network;
use super::pixels::{Choice, PixelRay, Pixels};
use super::recipe::{DvgoRecipe, StepRecipe};
use super::stage::{Stage, resolution};
use super::steps::Steps;
use super::view_count::count_views;
use crate::backend::{Backend, GridDevice};
use crate::field::Field;
use crate::field::lattice::FEATURES;
use crate::quality::psnr_db;
use crate::scene::Draws;
use crate::train::control::{Progress, Stage as Phase, TrainControl};
use crate::train::fit::{Run, measured};
use crate::train::input::{BoundedInput, Trained};
use crate::train::validate::validate_bounded;
use crate::{Error, Result};

/// Colour values of a coarse node: three and one of padding.
const DIRECT: usize = 4;
/// Raw density of nodes too near to a camera: none, and no gradient will ever reach it.
const NO_DENSITY: f32 = -100.0;
/// Weight of the newest step in the running training error.
const ERROR_MOMENTUM: f64 = 0.05;
/// The field is shown to the caller this often in the fine stage: making it copies the grid.
const LOOKS: u64 = 4;

/// Trains a field by DVGO's recipe on the views whose split is `Train`, on a backend's device, and measures it on the held-out ones.
///
/// `input`'s box is the coarse stage's; [`super::frustum_box`] is the recipe's. Time plays no part: a run is a function of input,
/// recipe and seed. [`TrainControl::inspect`] is called at quarters of the fine stage.
///
/// # Errors
/// [`Error::Invalid`] naming frame and field before any step, or if the coarse stage finds nothing; [`Error::OutOfMemory`] where a grid
/// does not fit on the device, [`Error::Diverged`], [`Error::Cancelled`], or the device's.
pub fn train_dvgo(
    input: &BoundedInput,
    recipe: &DvgoRecipe,
    seed: u64,
    backend: &dyn Backend,
    control: &dyn TrainControl,
) -> Result<Trained> {
    validate_bounded(input)?;
    let bounds = (input.low_m, input.high_m);
    let mut session = Session {
        pixels: Pixels::new(&input.views, Framing::of(&input.views).near_m),
        recipe,
        seed,
        backdrop: input.backdrop,
        device: backend.grid_device()?,
        control,
        run: Run::default(),
        steps_before: 0,
        start_s: control.seconds(),
    };
    session.report(Phase::Prepare, 0);
    let coarse = session.coarse(bounds)?;
    session.steps_before = recipe.coarse.steps;
    let field = session.fine(coarse)?;
    let mut run = session.run;
    run.seconds = control.seconds() - session.start_s;
    Ok(measured(
        field,
        run,
        &input.views,
        Some(input.backdrop),
        control,
    ))
}

/// How a stage is trained.
struct Plan<const C: usize> {
    recipe: StepRecipe,
    choice: Choice,
    rescales: Vec<Rescale>,
    /// Makes the field that is shown at quarters of the stage, once it has its last scale.
    shown: Option<fn(&Stage<C>) -> Field>,
}

/// Another resolution from a step on, counted from 1.
struct Rescale {
    step: u64,
    nodes: UVec3,
    voxel_m: f64,
}

/// What both stages share.
struct Session<'a> {
    pixels: Pixels<'a>,
    recipe: &'a DvgoRecipe,
    seed: u64,
    backdrop: [f32; 3],
    device: GridDevice,
    control: &'a dyn TrainControl,
    run: Run,
    steps_before: u64,
    start_s: f64,
}

impl Session<'_> {
    /// Finds out where the scene is.
    fn coarse(&mut self, bounds: (DVec3, DVec3)) -> Result<Stage<DIRECT>> {
        let recipe = self.recipe;
        let (voxel_m, nodes) = resolution(bounds, recipe.coarse_grid.voxels);
        let shape = Shape::new(nodes, bounds);
        let everywhere = NodeMask::new(&shape, |_| true);
        let parts = (recipe.coarse_grid, recipe.coarse);
        let sizes = (voxel_m, voxel_m);
        let mut stage = Stage::<DIRECT>::new(parts, shape, sizes, everywhere, None, self.backdrop);
        self.clear_near_cameras(&mut stage);
        let counts = count_views(&self.pixels, &stage.medium());
        let most = counts.iter().copied().max().unwrap_or(0).max(1);
        let shares = counts.iter().map(|c| f32::from(*c) / f32::from(most));
        stage.density_shares = shares.collect();
        let unseen = recipe.unseen_views;
        let seen = NodeMask::new(&shape, |node| u32::from(counts[shape.at(node)]) > unseen);
        stage.mask = seen;
        let plan = Plan {
            recipe: recipe.coarse,
            choice: Choice::Random,
            rescales: Vec::new(),
            shown: None,
        };
        self.train(&mut stage, &plan)?;
        Ok(stage)
    }

    fn clear_near_cameras(&self, stage: &mut Stage<DIRECT>) {
        let eyes = self.pixels.views().iter();
        let eyes: Vec<DVec3> = eyes.map(|v| v.local_from_camera.translation_m).collect();
        let (shape, near_m) = (stage.shape, self.pixels.near_m());
        shape.for_each_node(|node, at| {
            let p = shape.place(node);
            if eyes.iter().any(|eye| eye.distance(p) <= near_m) {
                stage.density[at] = NO_DENSITY;
            }
        });
    }

    /// Fits density and features to the tight box.
    fn fine(&mut self, coarse: Stage<DIRECT>) -> Result<Field> {
        let recipe = self.recipe;
        let scales = recipe.scale_steps.len() as u32;
        let voxels = |done: u32| recipe.fine_grid.voxels >> (scales - done);
        let (low, high) = coarse
            .dense_box(f64::from(recipe.box_alpha))
            .ok_or_else(|| Error::invalid("scene: the coarse stage found nothing opaque"))?;
        let grow = (high - low) * (recipe.box_scale - 1.0) / 2.0;
        let tight = (low - grow, high + grow);
        let (base_voxel_m, last_nodes) = resolution(tight, voxels(scales));
        let (voxel_m, nodes) = resolution(tight, voxels(0));
        let shape = Shape::new(nodes, cubic_box(tight, last_nodes));
        let mask = coarse_mask(&coarse, &shape, f64::from(recipe.mask_alpha));
        drop(coarse);
        let mut draws = Draws::new(self.seed, u64::MAX, 0);
        let mlp = initial_network(recipe.mlp_width, || draws.unit());
        let parts = (recipe.fine_grid, recipe.fine);
        let sizes = (voxel_m, base_voxel_m);
        let mut stage = Stage::<FEATURES>::new(parts, shape, sizes, mask, Some(mlp), self.backdrop);
        let pixels = self.pixels.in_mask(&stage.medium());
        if pixels.is_empty() {
            return Err(Error::invalid(
                "scene: no training ray meets what the coarse stage found",
            ));
        }
        let rescales = recipe.scale_steps.iter().zip(1..).map(|(step, done)| {
            let (voxel_m, nodes) = resolution(tight, voxels(done));
            Rescale {
                step: *step,
                nodes,
                voxel_m,
            }
        });
        let plan = Plan {
            recipe: recipe.fine,
            choice: Choice::Shuffled(pixels),
            rescales: rescales.collect(),
            shown: Some(field_of),
        };
        self.train(&mut stage, &plan)?;
        let field = field_of(&stage);
        let progress = self.at_fine_step(recipe.fine.steps);
        if self.control.looks(progress) {
            self.control.inspect(progress, &field);
        }
        Ok(field)
    }

    /// All steps of a stage.
    fn train<const C: usize>(&mut self, stage: &mut Stage<C>, plan: &Plan<C>) -> Result<()> {
        let recipe = plan.recipe;
        let control = self.control;
        let cancelled = || control.cancelled();
        let mut steps = Steps::open(&self.device, stage, &cancelled)?;
        let mut rays: Vec<PixelRay> = Vec::new();
        let mut mean: Option<f64> = None;
        let mut scaled = 0;
        for step in 1..=recipe.steps {
            if cancelled() {
                return Err(Error::Cancelled);
            }
            if (step + recipe.mask_period / 2).is_multiple_of(recipe.mask_period) {
                steps.renew_mask(stage, &cancelled)?;
            }
            if let Some(rescale) = plan.rescales.get(scaled).filter(|r| r.step == step) {
                scaled += 1;
                steps.fetch(stage, &cancelled)?;
                // Dropped first, so that both need not fit on a device.
                drop(steps);
                let shift_by = self.recipe.shift_per_scale;
                stage.rescale(rescale.nodes, rescale.voxel_m, shift_by);
                steps = Steps::open(&self.device, stage, &cancelled)?;
            }
            if scaled == plan.rescales.len() {
                self.show(stage, &steps, plan, step)?;
            }
            // Stages draw from different sequences.
            let number = self.steps_before + step - 1;
            let key = match plan.choice {
                Choice::Random => (self.seed, number),
                Choice::Shuffled(_) => (self.seed, step - 1),
            };
            self.pixels.draw(&plan.choice, key, recipe.rays, &mut rays);
            if let Some(error) = steps.step(stage, &rays, number, &cancelled)? {
                let now = error.squared_error;
                mean = Some(mean.map_or(now, |mean| mean + ERROR_MOMENTUM * (now - mean)));
            }
            self.run.psnr_train = mean.map(psnr_db);
            self.run.rays += rays.len() as u64;
            self.run.steps = number + 1;
            self.report(Phase::Train, number + 1);
        }
        steps.fetch(stage, &cancelled)
    }

    /// Shows the field before a step at a quarter of the stage.
    fn show<const C: usize>(
        &self,
        stage: &mut Stage<C>,
        steps: &Steps<C>,
        plan: &Plan<C>,
        step: u64,
    ) -> Result<()> {
        let Some(shown) = plan.shown else {
            return Ok(());
        };
        let quarter = (plan.recipe.steps / LOOKS).max(1);
        let progress = self.at_fine_step(step - 1);
        if step > 1 && (step - 1).is_multiple_of(quarter) && self.control.looks(progress) {
            steps.fetch(stage, &|| self.control.cancelled())?;
            self.control.inspect(progress, &shown(stage));
        }
        Ok(())
    }

    fn at_fine_step(&self, step: u64) -> Progress {
        self.progress(Phase::Train, self.steps_before + step)
    }

    fn progress(&self, phase: Phase, step: u64) -> Progress {
        Progress {
            stage: phase,
            step,
            step_count: self.recipe.coarse.steps + self.recipe.fine.steps,
            psnr_train: self.run.psnr_train,
        }
    }

    fn report(&self, phase: Phase, step: u64) {
        self.control.progress(self.progress(phase, step));
    }
}

/// The coarse nodes that are opaque, or beside one, at the nodes of the fine grid.
fn coarse_mask(coarse: &Stage<DIRECT>, shape: &Shape, alpha: f64) -> NodeMask {
    let opaque = coarse.dense_nodes(alpha);
    let per_m = coarse.shape.spacing_m().recip();
    NodeMask::new(shape, |node: UVec3| {
        let q = (shape.place(node) - coarse.shape.low) * per_m;
        opaque.near(q.as_vec3())
    })
}
