//! Sets of angles on the circle.

use std::f64::consts::{PI, TAU};

use super::random::Draws;

/// Disjoint arcs of the circle, cut at -pi; an arc may be a single angle.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Arcs {
    /// (from, to) with `-pi <= from <= to <= pi`, ascending.
    arcs: Vec<(f64, f64)>,
}

impl Arcs {
    pub(super) fn all() -> Self {
        Self {
            arcs: vec![(-PI, PI)],
        }
    }

    /// The union of arcs given as (centre, half width).
    pub(super) fn around(centres: impl Iterator<Item = (f64, f64)>) -> Self {
        let mut arcs = Vec::new();
        for (centre, half) in centres {
            if half >= PI {
                return Self::all();
            }
            let centre = wrap(centre);
            let (from, to) = (centre - half, centre + half);
            if from < -PI {
                arcs.extend([(from + TAU, PI), (-PI, to)]);
            } else if to > PI {
                arcs.extend([(from, PI), (-PI, to - TAU)]);
            } else {
                arcs.push((from, to));
            }
        }
        Self::union(arcs)
    }

    /// The arc between two angles with `-pi <= from <= to <= pi`.
    pub(super) fn between(from: f64, to: f64) -> Self {
        Self {
            arcs: vec![(from, to)],
        }
    }

    pub(super) fn turned(&self, by: f64) -> Self {
        Self::around(
            self.arcs
                .iter()
                .map(|(from, to)| (0.5 * (from + to) + by, 0.5 * (to - from))),
        )
    }

    pub(super) fn intersect(&self, other: &Self) -> Self {
        let pairs = self
            .arcs
            .iter()
            .flat_map(|a| other.arcs.iter().map(move |b| (a.0.max(b.0), a.1.min(b.1))));
        Self::union(pairs.filter(|(from, to)| from <= to).collect())
    }

    pub(super) fn is_empty(&self) -> bool {
        self.arcs.is_empty()
    }

    pub(super) fn measure_rad(&self) -> f64 {
        self.arcs.iter().map(|(from, to)| to - from).sum()
    }

    #[cfg(test)]
    pub(super) fn contains(&self, angle: f64) -> bool {
        let angle = wrap(angle);
        self.arcs
            .iter()
            .any(|(from, to)| (*from..=*to).contains(&angle))
    }

    /// An angle drawn evenly by length, or among the single angles if there is nothing longer; `None` from the empty set.
    pub(super) fn draw(&self, draws: &mut Draws) -> Option<f64> {
        let total = self.measure_rad();
        if total == 0.0 {
            return (!self.is_empty()).then(|| self.arcs[draws.below(self.arcs.len())].0);
        }
        let mut left = draws.unit() * total;
        for (from, to) in &self.arcs {
            if left < to - from {
                return Some(from + left);
            }
            left -= to - from;
        }
        self.arcs.last().map(|(_, to)| *to)
    }

    fn union(mut arcs: Vec<(f64, f64)>) -> Self {
        arcs.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut merged: Vec<(f64, f64)> = Vec::with_capacity(arcs.len());
        for (from, to) in arcs {
            match merged.last_mut() {
                Some(last) if from <= last.1 => last.1 = last.1.max(to),
                _ => merged.push((from, to)),
            }
        }
        Self { arcs: merged }
    }
}

/// Wraps an angle to (-pi, pi].
pub(super) fn wrap(angle_rad: f64) -> f64 {
    angle_rad - TAU * libm::ceil((angle_rad - PI) / TAU)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn set(centres: &[(f64, f64)]) -> Arcs {
        Arcs::around(centres.iter().copied())
    }

    proptest! {
        #[test]
        fn sets_behave_like_their_members(
            a in prop::collection::vec((-4.0f64..4.0, 0.0f64..1.2), 0..5),
            b in prop::collection::vec((-4.0f64..4.0, 0.0f64..1.2), 0..5),
            angle in -3.1f64..3.1, turn in -7.0f64..7.0,
        ) {
            let near = |set: &[(f64, f64)], at: f64, slack: f64| {
                set.iter().any(|(centre, half)| wrap(at - centre).abs() <= half + slack)
            };
            // Between the two, rounding decides.
            let agrees = |has: bool, loose: bool, strict: bool| (has && loose) || (!has && !strict);
            prop_assert!(agrees(set(&a).contains(angle), near(&a, angle, 1e-9), near(&a, angle, -1e-9)));
            let both = set(&a).intersect(&set(&b));
            let in_both = |slack: f64| near(&a, angle, slack) && near(&b, angle, slack);
            prop_assert!(agrees(both.contains(angle), in_both(1e-9), in_both(-1e-9)));
            prop_assert!((set(&a).turned(turn).measure_rad() - set(&a).measure_rad()).abs() < 1e-9);
            if let Some(drawn) = both.draw(&mut Draws::new(1, 2, 3)) {
                prop_assert!(near(&a, drawn, 1e-9) && near(&b, drawn, 1e-9));
            } else {
                prop_assert!(both.is_empty());
            }
        }
    }

    #[test]
    fn draws_are_even_by_length_and_single_angles_are_found() {
        let mut draws = Draws::new(5, 6, 7);
        let arcs = set(&[(3.0, 0.3), (0.0, 0.1)]);
        let near_zero = (0..4_000).filter(|_| arcs.draw(&mut draws).unwrap().abs() < 1.0);
        assert!(near_zero.count().abs_diff(1_000) < 120);
        let single = set(&[(0.5, 0.0), (0.7, 0.0)]);
        assert_eq!(single.measure_rad(), 0.0);
        let drawn = single.draw(&mut draws).unwrap();
        assert!(drawn == 0.5 || drawn == 0.7);
        assert_eq!(Arcs::default().draw(&mut draws), None);
    }

    #[test]
    fn wrap_stays_in_range() {
        for (angle, expected) in [(3.5 * PI, -0.5 * PI), (PI, PI), (-PI, PI), (0.2, 0.2)] {
            assert!((wrap(angle) - expected).abs() < 1e-12, "{angle}");
        }
    }
}
