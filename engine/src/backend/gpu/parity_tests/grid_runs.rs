//! Parity of a whole run of the recipe on dense grids.

use super::adapter::on_adapter;
use super::runs::{PSNR_DB, Unfused};
use crate::backend::Backend;
use crate::train::dvgo::StepRecipe;
use crate::train::dvgo::tests::whole::{ball, small};
use crate::train::{DvgoRecipe, NoControl, train_dvgo};

/// Both stages of a small scene, the fine one of so many steps: with renewals of the mask in both and two rescales.
fn recipe(fine_steps: u64) -> DvgoRecipe {
    let recipe = small();
    DvgoRecipe {
        coarse: StepRecipe {
            steps: 300,
            ..recipe.coarse
        },
        fine: StepRecipe {
            steps: fine_steps,
            mask_period: 20,
            ..recipe.fine
        },
        scale_steps: vec![8, 16],
        ..recipe
    }
}

#[test]
fn parity_dvgo_of_a_whole_run() {
    on_adapter("both stages of the recipe on dense grids", |gpu| {
        let input = ball();
        let psnr = |backend: &dyn Backend, fine_steps: u64| {
            let trained = train_dvgo(&input, &recipe(fine_steps), 1, backend, &NoControl);
            trained.unwrap().quality.psnr_held_out.unwrap()
        };
        let device = psnr(gpu, 50);
        let host = psnr(&Unfused, 50);
        println!("dvgo: {device:.3} dB on the device, {host:.3} dB on the processor");
        assert!(
            (device - host).abs() < PSNR_DB,
            "{device} against {host} dB"
        );
        let shorter = psnr(&Unfused, 25);
        assert!(
            (device - shorter).abs() > PSNR_DB,
            "half a run passes: {device} against {shorter} dB"
        );
    });
}
