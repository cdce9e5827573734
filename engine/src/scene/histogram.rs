//! Wanted shares of equal bins.

use serde::{Deserialize, Serialize};

use super::random::Draws;
use crate::{Error, Result};

/// Shares of equal bins over a range that its owner states. They need not sum to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    pub weights: Vec<f64>,
}

/// A bin of a heading histogram is then a degree wide.
const MAX_BINS: usize = 360;

impl Histogram {
    /// Equal shares.
    pub fn even(bins: usize) -> Self {
        Self {
            weights: vec![1.0; bins],
        }
    }

    /// # Errors
    /// [`Error::Invalid`] naming `field` if there is no bin, too many, or no share to draw by.
    pub fn validate(&self, field: &str) -> Result<()> {
        let count = self.weights.len();
        if count == 0 || count > MAX_BINS {
            return Err(Error::invalid(format!(
                "recipe: {field} has {count} bins, not 1 to {MAX_BINS}"
            )));
        }
        validate_weights(&self.weights, field)
    }

    /// Bin `index` of the range `low..high`.
    pub fn bin(&self, index: usize, [low, high]: [f64; 2]) -> [f64; 2] {
        let width = (high - low) / self.weights.len() as f64;
        let from = low + width * index as f64;
        [from, from + width]
    }
}

/// # Errors
/// [`Error::Invalid`] naming `field` unless the weights are finite, not negative and not all 0.
pub(super) fn validate_weights(weights: &[f64], field: &str) -> Result<()> {
    if let Some(bad) = weights.iter().find(|w| !w.is_finite() || **w < 0.0) {
        return Err(Error::invalid(format!(
            "recipe: {field} holds the weight {bad}; weights are finite and not negative"
        )));
    }
    if weights.iter().all(|w| *w == 0.0) {
        return Err(Error::invalid(format!("recipe: {field} has no weight")));
    }
    Ok(())
}

/// An index drawn by weight; `None` if there is no weight.
pub(super) fn draw_weighted(
    weights: impl Iterator<Item = f64> + Clone,
    draws: &mut Draws,
) -> Option<usize> {
    let total: f64 = weights.clone().sum();
    let mut left = draws.unit() * total;
    let mut last = None;
    for (i, weight) in weights.enumerate().filter(|(_, w)| *w > 0.0) {
        last = Some(i);
        if left < weight {
            break;
        }
        left -= weight;
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_drawn_by_their_weight() {
        let weights = [0.0, 1.0, 3.0, 0.0];
        let mut counts = [0u32; 4];
        let mut draws = Draws::new(1, 2, 3);
        for _ in 0..20_000 {
            counts[draw_weighted(weights.into_iter(), &mut draws).unwrap()] += 1;
        }
        assert_eq!((counts[0], counts[3]), (0, 0));
        assert!(counts[1].abs_diff(5_000) < 250, "{counts:?}");
        assert_eq!(draw_weighted([0.0, 0.0].into_iter(), &mut draws), None);
    }

    #[test]
    fn bins_tile_the_range() {
        let histogram = Histogram::even(4);
        assert_eq!(histogram.bin(0, [2.0, 10.0]), [2.0, 4.0]);
        assert_eq!(histogram.bin(3, [2.0, 10.0]), [8.0, 10.0]);
    }

    #[test]
    fn histograms_without_a_share_are_refused() {
        Histogram::even(12).validate("heading").unwrap();
        for (weights, part) in [
            (vec![], "0 bins"),
            (vec![1.0; 361], "361 bins"),
            (vec![0.0, 0.0], "no weight"),
            (vec![1.0, -1.0], "-1"),
            (vec![f64::NAN], "NaN"),
        ] {
            let error = Histogram { weights }.validate("heading").unwrap_err();
            let message = error.to_string();
            assert!(
                message.contains("heading") && message.contains(part),
                "{message}"
            );
        }
    }
}
