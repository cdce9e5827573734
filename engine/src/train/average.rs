//! The mean of a field's parameters over the end of a run.

use rayon::prelude::*;

use crate::field::Field;

/// Moments that a mean is taken over. Their noise falls with the root of the number; each costs a copy of the field, and on a
/// GPU its way back.
const MOMENTS: u32 = 16;

/// Parameters averaged over moments of the last part of a run.
///
/// At constant rates single steps wander around what they have learned; the mean lies at its centre, as after a decay of the
/// rates, which would have stopped the learning meanwhile (Izmailov et al. 2018, "Averaging Weights Leads to Wider Optima and
/// Better Generalization").
#[derive(Debug)]
pub(super) struct Average {
    /// The part of the run at its end that is averaged; 0 averages nothing.
    last: f64,
    /// Moments that are over.
    over: u32,
    /// Of them, those in `means`.
    counted: u32,
    /// One for each of [`arrays`].
    means: Vec<Vec<f32>>,
}

impl Average {
    pub(super) fn of_last(last: f64) -> Self {
        Self {
            last,
            over: 0,
            counted: 0,
            means: Vec::new(),
        }
    }

    /// Whether the next moment has come once this fraction of the run is done.
    pub(super) fn is_due(&self, done: f64) -> bool {
        let next = f64::from(self.over) / f64::from(MOMENTS);
        self.last > 0.0 && done >= 1.0 - self.last * (1.0 - next)
    }

    /// Counts the parameters of this moment.
    pub(super) fn add(&mut self, field: &Field) {
        self.over += 1;
        self.counted += 1;
        if self.counted == 1 {
            self.means = arrays(field).map(<[f32]>::to_vec).collect();
            return;
        }
        let share = 1.0 / self.counted as f32;
        for (mean, values) in self.means.iter_mut().zip(arrays(field)) {
            debug_assert_eq!(mean.len(), values.len(), "bricks changed");
            mean.par_iter_mut()
                .zip(values)
                .for_each(|(mean, value)| *mean += share * (value - *mean));
        }
    }

    /// Forgets what was counted: bricks are about to come or go, and with them the places of parameters.
    pub(super) fn restart(&mut self) {
        self.counted = 0;
        self.means.clear();
    }

    /// The mean, if anything was counted since the last restart.
    pub(super) fn mean(self) -> Option<Mean> {
        (self.counted > 0).then_some(Mean(self.means))
    }
}

#[derive(Debug)]
pub(super) struct Mean(Vec<Vec<f32>>);

impl Mean {
    /// Replaces the parameters of the field that the moments were of.
    pub(super) fn replace(self, field: &mut Field) {
        for (values, mean) in arrays_mut(field).zip(self.0) {
            values.copy_from_slice(&mean);
        }
    }
}

/// Every array of trained parameters.
fn arrays(field: &Field) -> impl Iterator<Item = &[f32]> {
    let levels = field.levels.iter();
    let sky = field.sky.iter().flat_map(|sky| sky.grids());
    levels
        .flat_map(|level| [level.density(), level.features().as_flattened()])
        .chain([field.mlp.parameters()])
        .chain(sky.map(|grid| grid.logits().as_flattened()))
}

/// [`arrays`], in the same order.
fn arrays_mut(field: &mut Field) -> impl Iterator<Item = &mut [f32]> {
    let levels = field.levels.iter_mut();
    let sky = field.sky.iter_mut().flat_map(|sky| sky.grids_mut());
    levels
        .flat_map(|level| {
            let (density, features) = level.parameters_mut();
            [density, features.as_flattened_mut()]
        })
        .chain([field.mlp.parameters_mut()])
        .chain(sky.map(|grid| grid.logits_mut().as_flattened_mut()))
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::super::background::{empty_field, sky_map};
    use super::super::preset::{Budget, TrainPreset};
    use super::*;

    fn field() -> Field {
        let preset = TrainPreset::background(Budget::Quick);
        let mut field = empty_field(Vec3::ZERO, Vec3::splat(3.2), &preset, 1).unwrap();
        field.levels[0].allocate([0; 3]);
        field.sky = Some(sky_map());
        field
    }

    /// Parameter `n` of every array is `n + value`.
    fn set(field: &mut Field, value: f32) {
        for values in arrays_mut(field) {
            let numbered = values.iter_mut().enumerate();
            numbered.for_each(|(n, x)| *x = (n % 100) as f32 + value);
        }
    }

    #[test]
    fn the_mean_is_that_of_the_moments_since_the_last_restart() {
        let mut field = field();
        let mut average = Average::of_last(0.5);
        set(&mut field, 100.0);
        average.add(&field);
        average.restart();
        for value in [1.0, 2.0, 6.0] {
            set(&mut field, value);
            average.add(&field);
        }
        average.mean().unwrap().replace(&mut field);
        assert!(
            arrays(&field).count() > 2 * field.levels.len() + 1,
            "no sky"
        );
        for values in arrays(&field) {
            assert!(!values.is_empty());
            for (n, x) in values.iter().enumerate() {
                assert!((x - (n % 100) as f32 - 3.0).abs() < 1e-4, "{n}: {x}");
            }
        }
        assert!(Average::of_last(0.5).mean().is_none());
    }

    #[test]
    fn moments_are_spread_over_the_last_part() {
        let field = field();
        let mut average = Average::of_last(0.2);
        let moments: Vec<u32> = (0..1_000)
            .filter(|step| {
                let due = average.is_due(f64::from(*step) / 1_000.0);
                due.then(|| average.add(&field)).is_some()
            })
            .collect();
        assert_eq!(moments.len(), MOMENTS as usize);
        assert!(moments[0] == 800 && moments[15] == 988, "{moments:?}");
        assert!(!Average::of_last(0.0).is_due(1.0));
    }
}
