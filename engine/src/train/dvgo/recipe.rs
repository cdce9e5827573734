//! Every constant of the recipe.

/// Both stages. [`Default`] is the published recipe for bounded scenes at 160^3 voxels.
#[derive(Clone, Debug, PartialEq)]
pub struct DvgoRecipe {
    pub coarse: StepRecipe,
    pub coarse_grid: GridRecipe,
    pub fine: StepRecipe,
    pub fine_grid: GridRecipe,
    /// Fine steps before which the number of voxels doubles; it starts at `voxels / 2^n`.
    pub scale_steps: Vec<u64>,
    /// Subtracted from the density's shift at every doubling, so that untouched space fades as samples multiply.
    pub shift_per_scale: f32,
    /// The fine box holds the coarse nodes of more than this opacity over one voxel, times `box_scale`.
    pub box_alpha: f32,
    pub box_scale: f64,
    /// Coarse opacity over one voxel, largest of 27 neighbours, from which the fine stage looks at a place.
    pub mask_alpha: f32,
    /// Coarse nodes seen by this many views or fewer are taken for empty.
    pub unseen_views: u32,
    /// Hidden width of the colour network.
    pub mlp_width: usize,
}

/// How a stage's grid is made and sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GridRecipe {
    pub voxels: u64,
    /// Opacity of untouched space over one base voxel.
    pub alpha_init: f64,
    /// Samples of no more opacity than this take no part, nor samples of no more weight.
    pub alpha_min: f64,
    /// Distance between samples in voxels.
    pub step_voxels: f64,
}

/// How a stage's steps are taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepRecipe {
    pub steps: u64,
    pub rays: usize,
    pub density_rate: f64,
    pub color_rate: f64,
    pub mlp_rate: f64,
    /// Steps over which the rates fall to a tenth.
    pub decay_steps: f64,
    /// Weight of the entropy of the transmittance left at the end of a ray.
    pub entropy: f32,
    /// Weight of every sample's own colour error.
    pub sample_color: f32,
    /// Values without gradient keep their moments and stay.
    pub masked: bool,
    /// The mask is renewed half a period into the run and every period from there on.
    pub mask_period: u64,
}

impl Default for DvgoRecipe {
    fn default() -> Self {
        Self {
            coarse: StepRecipe {
                steps: 5_000,
                rays: 8_192,
                density_rate: 0.1,
                color_rate: 0.1,
                mlp_rate: 1e-3,
                decay_steps: 20_000.0,
                entropy: 0.01,
                sample_color: 0.1,
                masked: false,
                mask_period: 1_000,
            },
            coarse_grid: GridRecipe {
                voxels: 1_024_000,
                alpha_init: 1e-6,
                alpha_min: 1e-7,
                step_voxels: 0.5,
            },
            fine: StepRecipe {
                steps: 20_000,
                rays: 8_192,
                density_rate: 0.1,
                color_rate: 0.1,
                mlp_rate: 1e-3,
                decay_steps: 20_000.0,
                entropy: 0.001,
                sample_color: 0.01,
                masked: true,
                mask_period: 1_000,
            },
            fine_grid: GridRecipe {
                voxels: 160 * 160 * 160,
                alpha_init: 1e-2,
                alpha_min: 1e-4,
                step_voxels: 0.5,
            },
            scale_steps: vec![1_000, 2_000, 3_000, 4_000],
            shift_per_scale: 1.0,
            box_alpha: 1e-3,
            box_scale: 1.05,
            mask_alpha: 1e-3,
            unseen_views: 2,
            mlp_width: 128,
        }
    }
}

impl DvgoRecipe {
    /// The recipe with `fine_steps` fine steps and everything else that counts steps scaled alike, for experiments and tests.
    pub fn scaled(fine_steps: u64) -> Self {
        let whole = Self::default();
        let ratio = fine_steps as f64 / whole.fine.steps as f64;
        let steps = |count: u64| ((count as f64 * ratio).round() as u64).max(1);
        Self {
            coarse: StepRecipe {
                steps: steps(whole.coarse.steps),
                decay_steps: whole.coarse.decay_steps * ratio,
                mask_period: steps(whole.coarse.mask_period),
                ..whole.coarse
            },
            fine: StepRecipe {
                steps: fine_steps,
                decay_steps: whole.fine.decay_steps * ratio,
                mask_period: steps(whole.fine.mask_period),
                ..whole.fine
            },
            scale_steps: whole.scale_steps.iter().map(|at| steps(*at)).collect(),
            ..whole
        }
    }
}
