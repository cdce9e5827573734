//! Training settings.

/// How much time a training run may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// The demo's: minutes for everything on two cores.
    Quick,
    Standard,
    Paper,
}

/// Every setting of a training run. Fields are public so that an experiment can change one.
#[derive(Clone, Debug, PartialEq)]
pub struct TrainPreset {
    /// Voxel edge of each level in metres, coarse to fine.
    pub voxels_m: Vec<f32>,
    /// Opacity of untouched space over one finest voxel.
    pub alpha_init: f64,
    /// Hidden width of the colour network.
    pub mlp_width: usize,
    pub steps: u64,
    pub rays_per_step: usize,
    /// Ends training early, with the learning-rate schedule following the clock instead of the step; 0 is no limit.
    pub seconds: f64,
    /// Bound on the memory of parameters and optimiser state.
    pub memory_bytes: u64,
}

impl TrainPreset {
    pub fn background(budget: Budget) -> Self {
        let (steps, seconds) = match budget {
            Budget::Quick => (1_600, 110.0),
            Budget::Standard => (6_000, 600.0),
            Budget::Paper => (40_000, 0.0),
        };
        Self {
            voxels_m: vec![1.6, 0.4, 0.1],
            alpha_init: 1e-3,
            mlp_width: 64,
            steps,
            rays_per_step: 4_096,
            seconds,
            memory_bytes: 1 << 30,
        }
    }

    pub fn object(budget: Budget) -> Self {
        let (steps, seconds) = match budget {
            Budget::Quick => (800, 18.0),
            Budget::Standard => (3_000, 60.0),
            Budget::Paper => (10_000, 0.0),
        };
        Self {
            voxels_m: vec![0.4, 0.1, 0.05],
            alpha_init: 1e-3,
            mlp_width: 64,
            steps,
            rays_per_step: 4_096,
            seconds,
            memory_bytes: 256 << 20,
        }
    }
}
