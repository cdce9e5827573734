//! Training settings.

use super::options::TrainOptions;
use super::ray::{Rates, RayLosses};
use super::sampler::RayMix;

/// How much time a training run may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// The demo's: minutes for everything on two cores.
    Quick,
    Standard,
    /// The constants of the paper: [`TrainPreset::paper_background`] and [`TrainPreset::paper_object`], hours.
    Paper,
}

/// The moments of a run at which occupancy is surveyed.
#[derive(Clone, Debug, PartialEq)]
pub enum Surveys {
    /// Fractions of the run.
    AtFractions(Vec<f64>),
    /// Numbers of steps: growth does not wait for a run that is long.
    AtSteps(Vec<u64>),
}

impl Surveys {
    /// How many of them are due by this step and fraction of the run.
    pub fn due(&self, step: u64, done: f64) -> usize {
        match self {
            Self::AtFractions(at) => at.iter().filter(|at| done >= **at).count(),
            Self::AtSteps(at) => at.iter().filter(|at| step >= **at).count(),
        }
    }
}

/// Every setting of a training run. Fields are public so that an experiment can change one.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainPreset {
    /// Voxel edge of each level in metres, coarse to fine.
    pub voxels_m: Vec<f32>,
    /// The finest levels are stored only this near to the cameras' path in metres, coarse to fine; infinite is everywhere.
    pub level_reach_m: Vec<f32>,
    /// Backgrounds: how far the box reaches from the path, in metres.
    pub box_reach_m: f64,
    /// Opacity of untouched space over one finest voxel.
    pub alpha_init: f64,
    /// Density in 1/m put around LiDAR returns before the first step.
    pub seed_sigma: f32,
    /// Hidden width of the colour network.
    pub mlp_width: usize,
    /// Step along a ray in finest stored voxels. Training draws where in a step density is read, so whole voxels lose little.
    pub step_voxels: f32,
    /// Metres of step per metre of distance.
    pub step_growth: f32,
    pub steps: u64,
    /// Fewer steps are taken where they would pass over the training pixels more often than this: a small log is learned sooner.
    pub most_passes: f64,
    /// Ends training early; the schedule then follows the clock instead of the step. 0 is no limit, and the presets' value:
    /// a field is a function of its input and seed, not of the machine's load.
    pub seconds: f64,
    /// Bound on the memory of parameters and optimiser state.
    pub memory_bytes: u64,
    /// Learning rates of the first step.
    pub rates: Rates,
    /// What is left of them at the last step, but of the sky map's, which always decays.
    pub rate_decay: f32,
    /// Passes over the training pixels after which the rates fall by themselves, whatever the run's length, so that a field is
    /// good at any moment and not only at the end; infinite switches this off.
    pub settle_passes: f64,
    pub mix: RayMix,
    /// Steps take fewer rays while rays have so many coloured samples that they would exceed this number: the first steps, in
    /// still open space, then cost no more than later ones.
    pub most_colored: u64,
    /// Fraction of the run from which pixels that are not sky teach the sky map. The map learns faster than density does, and
    /// would explain a near bridge, blurred by its parallax, before any voxel could.
    pub solid_sky_from: f64,
    pub losses: RayLosses,
    /// When occupancy is surveyed and finer bricks are stored where something is.
    pub surveys: Surveys,
    /// Opacity over one finest voxel from which a cell counts as occupied.
    pub survey_alpha: f32,
    pub options: TrainOptions,
}

/// `fast`: finest voxel in pixels, and the most of them along an edge.
const FAST_PIXELS: f64 = 0.6;
const FAST_MOST_VOXELS: f64 = 256.0;

impl TrainPreset {
    pub fn background(budget: Budget) -> Self {
        // A mean over the end lets the rates stay high, for a copy of the field in memory, which the demo's 2 GiB do not hold.
        let (steps, most_passes, discovery, rate_decay, average_last) = match budget {
            Budget::Quick => (1_400, 8.0, 0.1, 0.1, 0.0),
            Budget::Standard => (8_000, 40.0, 0.04, 1.0, 0.2),
            Budget::Paper => return Self::paper_background(),
        };
        Self {
            voxels_m: vec![1.6, 0.4, 0.1],
            level_reach_m: vec![f32::INFINITY, f32::INFINITY, 30.0],
            box_reach_m: 100.0,
            alpha_init: 1e-4,
            seed_sigma: 3.0,
            mlp_width: 64,
            step_voxels: 1.0,
            step_growth: 0.004,
            steps,
            most_passes,
            seconds: 0.0,
            memory_bytes: 1 << 30,
            rates: Rates {
                density: 0.2,
                features: 0.1,
                mlp: 2e-3,
                sky: 0.1,
                ..Rates::default()
            },
            settle_passes: f64::INFINITY,
            rate_decay,
            mix: RayMix {
                pixel_rays: 3_584,
                depth_rays: 512,
                beam_rays: 256,
                color_weight: 1.0,
                depth_weight: 0.02,
                silhouette_weight: 0.0,
                sky_weight: 0.01,
                beam_weight: 0.01,
                mirror_share: 0.0,
                mirror_color: 0.0,
                depth_margin_m: 2.0,
                solid_teaches_sky: true,
            },
            most_colored: 100_000,
            solid_sky_from: 0.5,
            losses: RayLosses {
                sample_color: 0.05,
                entropy: 1e-3,
                depth_scale_m: 0.1,
                depth_cap_m: 2.0,
                min_weight: 3e-3,
                depth_trim_m: f32::INFINITY,
                ..RayLosses::default()
            },
            surveys: Surveys::AtSteps(vec![150, 400, 800, 1_600, 4_000]),
            survey_alpha: 5e-3,
            options: TrainOptions {
                // A coarse step through untouched space weighs 2e-3: it must be coloured until what is far from LiDAR is found.
                min_weights: vec![(0.0, 2e-4), (discovery, 3e-3)],
                average_last,
                ..TrainOptions::default()
            },
        }
    }

    /// The fastest way to a good field of a bounded scene whose box has this edge and whose pixels are `footprint_m` wide at its
    /// centre.
    pub fn fast(edge_m: f64, footprint_m: f64) -> Self {
        let finest = (FAST_PIXELS * footprint_m).max(edge_m / FAST_MOST_VOXELS) as f32;
        Self {
            voxels_m: vec![8.0 * finest, 2.0 * finest, finest],
            level_reach_m: vec![f32::INFINITY; 3],
            box_reach_m: 0.0,
            alpha_init: 3e-3,
            seed_sigma: 0.0,
            mlp_width: 32,
            step_voxels: 1.0,
            step_growth: 0.0,
            steps: 30_000,
            most_passes: f64::INFINITY,
            seconds: 0.0,
            memory_bytes: 1 << 29,
            rates: Rates {
                density: 0.2,
                features: 0.1,
                mlp: 2e-3,
                sky: 0.0,
                ..Rates::default()
            },
            settle_passes: 0.5,
            rate_decay: 0.3,
            mix: RayMix {
                pixel_rays: 2_048,
                depth_rays: 0,
                beam_rays: 0,
                color_weight: 1.0,
                depth_weight: 0.0,
                silhouette_weight: 0.0,
                sky_weight: 0.0,
                beam_weight: 0.0,
                mirror_share: 0.0,
                mirror_color: 0.0,
                depth_margin_m: 0.0,
                solid_teaches_sky: true,
            },
            most_colored: 24_576,
            solid_sky_from: 0.0,
            losses: RayLosses {
                sample_color: 0.01,
                entropy: 1e-3,
                depth_scale_m: 1.0,
                depth_cap_m: 1.0,
                min_weight: 3e-3,
                depth_trim_m: f32::INFINITY,
                ..RayLosses::default()
            },
            surveys: Surveys::AtSteps(vec![64, 128, 256, 512, 1024, 2048, 4096, 8192, 16384]),
            survey_alpha: 1e-2,
            options: TrainOptions::default(),
        }
    }

    pub fn object(budget: Budget) -> Self {
        let (steps, most_passes) = match budget {
            Budget::Quick => (600, 40.0),
            Budget::Standard => (3_000, 200.0),
            Budget::Paper => return Self::paper_object(),
        };
        Self {
            voxels_m: vec![0.2, 0.1, 0.05],
            level_reach_m: vec![f32::INFINITY; 3],
            box_reach_m: 0.0,
            alpha_init: 1e-3,
            seed_sigma: 5.0,
            mlp_width: 64,
            step_voxels: 0.5,
            step_growth: 0.002,
            steps,
            most_passes,
            seconds: 0.0,
            memory_bytes: 512 << 20,
            rates: Rates {
                density: 0.2,
                features: 0.1,
                mlp: 2e-3,
                sky: 0.0,
                ..Rates::default()
            },
            settle_passes: f64::INFINITY,
            rate_decay: 0.1,
            mix: RayMix {
                pixel_rays: 2_048,
                depth_rays: 128,
                beam_rays: 0,
                color_weight: 1.0,
                depth_weight: 0.02,
                silhouette_weight: 0.01,
                sky_weight: 0.0,
                beam_weight: 0.0,
                mirror_share: 0.0,
                mirror_color: 0.25,
                depth_margin_m: 0.5,
                solid_teaches_sky: true,
            },
            most_colored: u64::MAX,
            solid_sky_from: 0.0,
            losses: RayLosses {
                sample_color: 0.05,
                entropy: 1e-3,
                depth_scale_m: 0.05,
                depth_cap_m: 1.0,
                min_weight: 3e-3,
                depth_trim_m: f32::INFINITY,
                ..RayLosses::default()
            },
            surveys: Surveys::AtFractions(vec![0.15, 0.4, 0.7]),
            survey_alpha: 5e-3,
            options: TrainOptions::default(),
        }
    }
}
