//! Merges the samples of several fields along one ray into one list of common intervals and composites it in sigma.

use crate::field::RaySample;

/// What a merged ray adds up to. Weights go to the caller's per-sample buffers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Merged {
    /// Light left behind the last sample.
    pub transmittance: f32,
    /// Distance at which half of the light is gone; `None` if more is left.
    pub half_t: Option<f32>,
}

const HALF_TAU: f32 = std::f32::consts::LN_2;

/// Composites `sources`, each ordered near to far and free of overlaps, whose samples stand for the interval
/// [t - dt/2, t + dt/2].
///
/// Where intervals of several sources overlap, densities add and the interval's weight is shared in proportion to density
/// (sigma-weighted colour), so that interpenetrating fields need no order. `weights[s]` is replaced by one weight per sample of
/// source s; `cursors` is scratch.
pub fn merge(
    sources: &[Vec<RaySample>],
    weights: &mut [Vec<f32>],
    cursors: &mut Vec<usize>,
) -> Merged {
    for (weights, samples) in weights.iter_mut().zip(sources) {
        weights.clear();
        weights.resize(samples.len(), 0.0);
    }
    cursors.clear();
    cursors.resize(sources.len(), 0);
    let mut light = Light::new();
    let mut t = f32::NEG_INFINITY;
    loop {
        let (sigma, next) = interval_from(sources, cursors, t);
        if next == f32::INFINITY {
            break;
        }
        if sigma > 0.0 {
            let share = light.absorb(sigma, t, next) / sigma;
            for (s, samples) in sources.iter().enumerate() {
                if let Some(sample) = samples.get(cursors[s]).filter(|x| start(x) <= t) {
                    weights[s][cursors[s]] += share * sample.sigma;
                }
            }
        }
        t = next;
        for (cursor, samples) in cursors.iter_mut().zip(sources) {
            while samples.get(*cursor).is_some_and(|x| end(x) <= t) {
                *cursor += 1;
            }
        }
    }
    light.merged()
}

/// [`merge`] of a single source.
pub fn composite(samples: &[RaySample], weights: &mut Vec<f32>) -> Merged {
    weights.clear();
    let mut light = Light::new();
    weights.extend(
        samples
            .iter()
            .map(|x| light.absorb(x.sigma, start(x), end(x))),
    );
    light.merged()
}

/// Total density just after `t` and where it changes next; infinite after the last sample.
fn interval_from(sources: &[Vec<RaySample>], cursors: &[usize], t: f32) -> (f32, f32) {
    let (mut sigma, mut next) = (0.0, f32::INFINITY);
    for (samples, cursor) in sources.iter().zip(cursors) {
        let Some(sample) = samples.get(*cursor) else {
            continue;
        };
        if start(sample) <= t {
            sigma += sample.sigma;
            next = next.min(end(sample));
        } else {
            next = next.min(start(sample));
        }
    }
    (sigma, next)
}

fn start(sample: &RaySample) -> f32 {
    sample.t - 0.5 * sample.dt
}

fn end(sample: &RaySample) -> f32 {
    sample.t + 0.5 * sample.dt
}

struct Light {
    tau: f32,
    half_t: Option<f32>,
}

impl Light {
    fn new() -> Self {
        Self {
            tau: 0.0,
            half_t: None,
        }
    }

    /// Weight of an interval of constant density.
    fn absorb(&mut self, sigma: f32, from: f32, to: f32) -> f32 {
        let step = sigma * (to - from);
        if self.half_t.is_none() && self.tau + step >= HALF_TAU {
            self.half_t = Some(from + (HALF_TAU - self.tau) / sigma);
        }
        let weight = (-self.tau).exp() * -(-step).exp_m1();
        self.tau += step;
        weight
    }

    fn merged(&self) -> Merged {
        Merged {
            transmittance: (-self.tau).exp(),
            half_t: self.half_t,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample(from: f32, to: f32, sigma: f32) -> RaySample {
        RaySample {
            t: 0.5 * (from + to),
            dt: to - from,
            sigma,
        }
    }

    fn run(sources: &[Vec<RaySample>]) -> (Merged, Vec<Vec<f32>>) {
        let mut weights = vec![Vec::new(); sources.len()];
        let merged = merge(sources, &mut weights, &mut Vec::new());
        (merged, weights)
    }

    /// Sums over steps of 0.1 mm: knows nothing of boundaries.
    fn brute_force(sources: &[Vec<RaySample>]) -> (f64, Vec<f64>) {
        let mut tau = 0.0f64;
        let mut totals = vec![0.0; sources.len()];
        let step = 1e-4;
        for i in 0..60_000 {
            let t = (f64::from(i) + 0.5) * step;
            let density = |samples: &Vec<RaySample>| {
                let inside = |x: &&RaySample| (t as f32) >= start(x) && (t as f32) < end(x);
                samples
                    .iter()
                    .find(inside)
                    .map_or(0.0, |x| f64::from(x.sigma))
            };
            let each: Vec<f64> = sources.iter().map(density).collect();
            let sigma: f64 = each.iter().sum();
            if sigma > 0.0 {
                let weight = (-tau).exp() * (1.0 - (-sigma * step).exp());
                for (total, own) in totals.iter_mut().zip(&each) {
                    *total += weight * own / sigma;
                }
            }
            tau += sigma * step;
        }
        ((-tau).exp(), totals)
    }

    fn intervals() -> impl Strategy<Value = Vec<RaySample>> {
        prop::collection::vec((0.01f32..0.6, 0.05f32..0.5, 0.0f32..4.0), 0..6).prop_map(|steps| {
            let mut t = 0.0;
            let mut out = Vec::new();
            for (gap, length, sigma) in steps {
                // Half of the gaps are closed, so that adjacent samples share a boundary.
                let from = if gap < 0.3 { t } else { t + gap };
                t = from + length;
                out.push(sample(from, t, sigma));
            }
            out
        })
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn agrees_with_fine_steps(a in intervals(), b in intervals(), c in intervals()) {
            let sources = [a, b, c];
            let (merged, weights) = run(&sources);
            let (transmittance, totals) = brute_force(&sources);
            prop_assert!((f64::from(merged.transmittance) - transmittance).abs() < 2e-3);
            for (own, expected) in weights.iter().zip(totals) {
                let total: f32 = own.iter().sum();
                prop_assert!((f64::from(total) - expected).abs() < 2e-3, "{total} {expected}");
            }
            let all: f32 = weights.iter().flatten().sum();
            prop_assert!((all + merged.transmittance - 1.0).abs() < 1e-5);
        }

        #[test]
        fn one_source_needs_no_merging(a in intervals()) {
            let mut weights = Vec::new();
            let single = composite(&a, &mut weights);
            let (merged, merged_weights) = run(&[a, Vec::new()]);
            prop_assert!((single.transmittance - merged.transmittance).abs() < 1e-6);
            for (x, y) in weights.iter().zip(&merged_weights[0]) {
                prop_assert!((x - y).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn the_nearer_surface_hides_the_further_one() {
        let near = vec![sample(1.0, 2.0, 50.0)];
        let far = vec![sample(3.0, 4.0, 50.0)];
        let (merged, weights) = run(&[far, near]);
        assert!(weights[1][0] > 0.999 && weights[0][0] < 1e-6);
        assert!((merged.half_t.unwrap() - (1.0 + HALF_TAU / 50.0)).abs() < 1e-5);
        let thin = run(&[vec![sample(1.0, 2.0, 0.1)]]);
        assert_eq!(thin.0.half_t, None);
    }

    #[test]
    fn alpha_over_would_be_wrong_where_fields_interpenetrate() {
        let same = vec![sample(1.0, 2.0, 3.0)];
        let (_, weights) = run(&[same.clone(), same]);
        assert_eq!(weights[0][0], weights[1][0]);
        let over = 1.0 - (-3.0f32).exp();
        assert!(
            (weights[0][0] - over).abs() > 0.1,
            "alpha-over would give {over}"
        );
    }
}
