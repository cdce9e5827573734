//! Both stages on the ball.

use glam::DVec3;

use super::scene::{DISTANCE_M, views};
use crate::backend::cpu::CpuBackend;
use crate::field::Field;
use crate::train::control::{Progress, TrainControl};
use crate::train::dvgo::framing::Framing;
use crate::train::dvgo::{DvgoRecipe, GridRecipe, StepRecipe, frustum_box, train_dvgo};
use crate::train::{BoundedInput, NoControl};
use crate::{Error, ErrorKind};

/// The recipe's rules with a few thousand voxels and rays.
pub(crate) fn small() -> DvgoRecipe {
    let recipe = DvgoRecipe::scaled(600);
    DvgoRecipe {
        coarse: StepRecipe {
            steps: 400,
            rays: 512,
            ..recipe.coarse
        },
        coarse_grid: GridRecipe {
            voxels: 24 * 24 * 24,
            ..recipe.coarse_grid
        },
        fine: StepRecipe {
            rays: 512,
            ..recipe.fine
        },
        fine_grid: GridRecipe {
            voxels: 32 * 32 * 32,
            ..recipe.fine_grid
        },
        scale_steps: vec![60, 120],
        mlp_width: 32,
        ..recipe
    }
}

pub(crate) fn ball() -> BoundedInput {
    let views = views(20, 4, 40);
    let (low_m, high_m) = frustum_box(&views).unwrap();
    BoundedInput {
        views,
        low_m,
        high_m,
        backdrop: [1.0; 3],
    }
}

/// Cancels at a step; remembers the last field shown.
struct Watch {
    stop_at: u64,
    looks: std::sync::Mutex<Vec<(u64, f32)>>,
    steps: std::sync::atomic::AtomicU64,
}

impl Watch {
    fn stopping_at(stop_at: u64) -> Self {
        Self {
            stop_at,
            looks: Default::default(),
            steps: Default::default(),
        }
    }
}

impl TrainControl for Watch {
    fn progress(&self, progress: Progress) {
        self.steps
            .store(progress.step, std::sync::atomic::Ordering::Relaxed);
    }

    fn looks(&self, _: Progress) -> bool {
        true
    }

    fn inspect(&self, progress: Progress, field: &Field) {
        let look = (progress.step, field.finest_voxel_m());
        self.looks.lock().unwrap().push(look);
    }

    fn cancelled(&self) -> bool {
        self.steps.load(std::sync::atomic::Ordering::Relaxed) >= self.stop_at
    }

    fn seconds(&self) -> f64 {
        0.0
    }
}

#[test]
fn a_small_scene_is_learned_and_is_an_ordinary_field() {
    let (input, recipe) = (ball(), small());
    let watch = Watch::stopping_at(u64::MAX);
    let trained = train_dvgo(&input, &recipe, 1, &CpuBackend, &watch).unwrap();
    let psnr = trained.quality.psnr_held_out.unwrap();
    assert!(psnr > 25.0, "{psnr}");
    let field = trained.field;
    assert_eq!(field.levels().len(), 1);
    let level = &field.levels()[0];
    let all = level.bricks_per_axis().element_product() as usize;
    assert_eq!(level.brick_count(), all + 1, "every brick is stored");
    let rays = (recipe.coarse.steps + recipe.fine.steps) * 512;
    assert_eq!(trained.quality.train_rays, rays);
    let looks = watch.looks.into_inner().unwrap();
    let last = recipe.coarse.steps + recipe.fine.steps;
    assert_eq!(looks.last().map(|look| look.0), Some(last));
    assert!(looks.len() > 2, "{looks:?}");
}

#[test]
fn the_same_seed_gives_the_same_field_on_any_number_of_threads() {
    let mut recipe = small();
    (recipe.coarse.steps, recipe.fine.steps) = (300, 70);
    let input = ball();
    let train = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().unwrap();
        pool.install(|| {
            train_dvgo(&input, &recipe, seed, &CpuBackend, &NoControl)
                .unwrap()
                .field
        })
    };
    let one = train(1, 5);
    assert_eq!(one, train(3, 5));
    assert_ne!(one, train(1, 6));
}

#[test]
fn bad_input_and_cancellation_end_with_their_errors() {
    let (input, recipe) = (ball(), small());
    let watch = Watch::stopping_at(5);
    let cancelled = train_dvgo(&input, &recipe, 1, &CpuBackend, &watch).unwrap_err();
    assert!(matches!(cancelled, Error::Cancelled));
    let mut flat = input.clone();
    flat.high_m.z = flat.low_m.z;
    let empty = train_dvgo(&flat, &recipe, 1, &CpuBackend, &NoControl).unwrap_err();
    assert_eq!(empty.kind(), ErrorKind::Invalid);
    let mut white = input;
    for view in &mut white.views {
        view.rgb.fill(255);
    }
    let nothing = train_dvgo(&white, &recipe, 1, &CpuBackend, &NoControl).unwrap_err();
    assert!(nothing.to_string().contains("found nothing"), "{nothing}");
}

#[test]
fn framing_is_that_of_the_reference_scenes() {
    let mut views = views(30, 0, 40);
    let scale = 16.25f64.sqrt() / DISTANCE_M;
    for view in &mut views {
        view.local_from_camera.translation_m *= scale;
    }
    let framing = Framing::of(&views);
    assert!((framing.near_m - 2.0).abs() < 1e-6, "{framing:?}");
    assert!((framing.far_m - 6.0).abs() < 1e-6, "{framing:?}");
    let (low, high) = frustum_box(&views).unwrap();
    // The far end of a corner ray: sideways by 6 sin, forward by 6 cos - 4.03 of its angle.
    let side = 6.0
        * (DVec3::new(0.5 / 1.4, 0.5 / 1.4, 1.0)
            .normalize()
            .truncate()
            .length());
    assert!(
        high.max_element() < side + 0.3 && high.max_element() > 2.0,
        "{low} {high}"
    );
    assert!(frustum_box(&[]).is_err());
}
