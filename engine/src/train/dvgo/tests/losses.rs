//! Gradients of a ray's loss against central differences of the loss written out in f64.

use crate::train::dvgo::losses::{LossSetting, RayColors, differentiate_ray};

const TAUS: [f64; 5] = [0.3, 0.05, 0.9, 0.2, 0.4];
/// The second sample is too light to be shown.
const SHOWN: [bool; 5] = [true, false, true, true, true];
const COLORS: [[f64; 3]; 5] = [
    [0.2, 0.7, 0.4],
    [0.0; 3],
    [0.9, 0.1, 0.5],
    [0.3, 0.3, 0.8],
    [0.6, 0.2, 0.1],
];
const TARGET: [f64; 3] = [0.4, 0.6, 0.3];
const BACKDROP: f64 = 1.0;
const SETTING: LossSetting = LossSetting {
    ray_share: 1.0 / 64.0,
    entropy: 0.01,
    sample_color: 0.1,
    backdrop: [BACKDROP as f32; 3],
};

fn weights(taus: &[f64; 5]) -> ([f64; 5], f64) {
    let mut light = 1.0;
    let mut out = [0.0; 5];
    for (tau, w) in taus.iter().zip(&mut out) {
        *w = light * (1.0 - (-tau).exp());
        light *= (-tau).exp();
    }
    (out, light)
}

/// The loss as the recipe writes it: mean squared error over the channels, entropy of the light left, and every sample's own
/// squared error by its weight, `held` constant.
fn loss(taus: &[f64; 5], colors: &[[f64; 3]; 5], held: &[f64; 5], setting: &LossSetting) -> f64 {
    let (w, end) = weights(taus);
    let mut total = 0.0;
    for c in 0..3 {
        let lit = (0..5).filter(|i| SHOWN[*i]);
        let color: f64 = lit.map(|i| w[i] * colors[i][c]).sum::<f64>() + end * BACKDROP;
        total += (color - TARGET[c]).powi(2) / 3.0;
    }
    total -= f64::from(setting.entropy) * (end * end.ln() + (1.0 - end) * (1.0 - end).ln());
    for i in (0..5).filter(|i| SHOWN[*i]) {
        let own: f64 = (0..3).map(|c| (colors[i][c] - TARGET[c]).powi(2)).sum();
        total += f64::from(setting.sample_color) * held[i] * own;
    }
    total * f64::from(setting.ray_share)
}

/// Largest error of all gradients relative to the largest gradient, and the error of the value.
fn worst(computed_with: &LossSetting) -> f64 {
    let (w, end) = weights(&TAUS);
    let weights32 = w.map(|w| w as f32);
    let rows: Vec<[f64; 3]> = (0..5).filter(|i| SHOWN[*i]).map(|i| COLORS[i]).collect();
    let flat = |row: &[f64; 3]| [row[0] as f32, row[1] as f32, row[2] as f32, 0.0];
    let colors: Vec<f32> = rows.iter().flat_map(flat).collect();
    let mut color_gradients = vec![0.0; colors.len()];
    let (mut by_weight, mut by_tau) = ([0.0; 5], [0.0; 5]);
    let batch = RayColors {
        slots: 0..4,
        colors: &colors,
        gradients: &mut color_gradients,
        stride: 4,
    };
    let one = differentiate_ray(
        computed_with,
        TARGET.map(|c| c as f32),
        (&weights32, &SHOWN, end as f32),
        batch,
        &mut by_weight,
        &mut by_tau,
    );
    let value = loss(&TAUS, &COLORS, &w, &SETTING);
    let mut pairs = vec![(f64::from(one.loss), value)];
    let h = 1e-5;
    for i in 0..5 {
        let at = |d: f64| {
            let mut taus = TAUS;
            taus[i] += d;
            loss(&taus, &COLORS, &w, &SETTING)
        };
        pairs.push((f64::from(by_tau[i]), (at(h) - at(-h)) / (2.0 * h)));
    }
    for (slot, i) in (0..5).filter(|i| SHOWN[*i]).enumerate() {
        for c in 0..3 {
            let at = |d: f64| {
                let mut colors = COLORS;
                colors[i][c] += d;
                loss(&TAUS, &colors, &w, &SETTING)
            };
            let exact = (at(h) - at(-h)) / (2.0 * h);
            pairs.push((f64::from(color_gradients[slot * 4 + c]), exact));
        }
    }
    let largest = pairs.iter().map(|p| p.1.abs()).fold(0.0, f64::max);
    let off = pairs.iter().map(|p| (p.0 - p.1).abs());
    off.fold(0.0, f64::max) / largest
}

/// f32 arithmetic.
const TOLERANCE: f64 = 1e-4;

#[test]
fn gradients_are_those_of_the_written_loss() {
    let error = worst(&SETTING);
    assert!(error < TOLERANCE, "{error}");
}

#[test]
fn other_weights_are_noticed() {
    for wrong in [
        LossSetting {
            entropy: 0.001,
            ..SETTING
        },
        LossSetting {
            sample_color: 0.01,
            ..SETTING
        },
        LossSetting {
            ray_share: 1.0 / 192.0,
            ..SETTING
        },
        LossSetting {
            backdrop: [0.0; 3],
            ..SETTING
        },
    ] {
        assert!(worst(&wrong) > 10.0 * TOLERANCE, "{wrong:?}");
    }
}
