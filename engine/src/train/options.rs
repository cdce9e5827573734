//! Settings that few presets use. All off by default.

/// What a preset may ask for besides its figures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrainOptions {
    /// Backgrounds: one level, every voxel of a flat box stored, at most this many; the voxel size is the least in
    /// `dense_voxel_m` for which the box fits, and the box shrinks towards the path if none does. 0 stores bricks.
    pub dense_voxels: u64,
    /// Least and greatest voxel edge of a dense box in metres.
    pub dense_voxel_m: (f64, f64),
    /// `(fraction of the run, weight)`, ascending: from then on, lighter samples take no part in colour. Before the first entry
    /// [`super::ray::RayLosses::min_weight`] holds. Untouched space is coloured at first and must not stay so, and a
    /// threshold that is high from the start would keep it from ever being coloured.
    pub min_weights: Vec<(f64, f32)>,
    /// Fraction of the run from which poses are refined: before there is a shape, there is nothing to align with.
    pub poses_from: f64,
    /// The part of the run at its end over which parameters are averaged; holds a copy of them. 0 takes those of the last step.
    pub average_last: f64,
}

impl TrainOptions {
    /// The weight below which samples are not coloured once the fraction `done` of the run is.
    pub fn min_weight(&self, done: f64) -> Option<f32> {
        let begun = self.min_weights.iter().rev().find(|(at, _)| done >= *at);
        begun.map(|(_, weight)| *weight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thresholds_follow_the_run() {
        let options = TrainOptions {
            min_weights: vec![(0.1, 1e-5), (0.2, 1e-4)],
            ..TrainOptions::default()
        };
        let at = [0.0, 0.1, 0.19, 0.2, 1.0].map(|done| options.min_weight(done));
        assert_eq!(at, [None, Some(1e-5), Some(1e-5), Some(1e-4), Some(1e-4)]);
        assert_eq!(TrainOptions::default().min_weight(0.5), None);
    }
}
