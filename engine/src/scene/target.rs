//! What a slot of a sample is to be: drawn once, so that rejected attempts do not bend the wanted distributions.

use std::f64::consts::PI;

use super::arcs::Arcs;
use super::composition::{Candidate, Stage};
use super::coverage::{nearest_m, observed_headings};
use super::histogram::{Histogram, draw_weighted};
use super::random::Draws;
use super::recipe::Recipe;
use crate::{Error, Result};

/// What one slot is to be.
#[derive(Clone, Debug)]
pub(super) struct Target {
    /// Assets that can be it, by index into the library.
    pub(super) assets: Vec<usize>,
    /// Camera-relative headings wanted; `None` leaves them to the preset.
    pub(super) headings: Option<Arcs>,
    pub(super) distance_m: [f64; 2],
}

/// The distributions that targets are drawn from.
#[derive(Debug)]
pub(super) struct Targets<'a> {
    library: &'a [Candidate],
    recipe: &'a Recipe,
    /// Weight and assets of each class; one group of all assets if the recipe wants no shares.
    groups: Vec<(f64, Vec<usize>)>,
}

/// Arcs shorter than this would be drawn over and over at one angle.
const LEAST_ARC_RAD: f64 = 1e-3;

impl<'a> Targets<'a> {
    /// # Errors
    /// [`Error::Invalid`] if objects are asked for and no asset matches the recipe, or none that of a class or heading it wants.
    pub(super) fn new(
        stage: &Stage<'_>,
        library: &'a [Candidate],
        recipe: &'a Recipe,
    ) -> Result<Self> {
        let eligible: Vec<usize> = (0..library.len())
            .filter(|i| is_eligible(&library[*i], stage, recipe))
            .collect();
        if eligible.is_empty() && recipe.min_objects > 0 {
            return Err(Error::invalid(
                "recipe: no library object matches; train objects first or widen objects, classes and source_logs",
            ));
        }
        let mut targets = Self {
            library,
            recipe,
            groups: vec![(1.0, eligible)],
        };
        if !recipe.class_shares.is_empty() {
            targets.group_by_class()?;
        }
        targets.check_headings()?;
        Ok(targets)
    }

    /// Every asset that the recipe may draw, by index into the library.
    pub(super) fn assets(&self) -> Vec<usize> {
        let groups = self.groups.iter();
        groups.flat_map(|(_, assets)| assets.clone()).collect()
    }

    /// `None` if no asset can be what was drawn.
    pub(super) fn draw(&self, draws: &mut Draws) -> Option<Target> {
        let group = draw_weighted(self.groups.iter().map(|g| g.0), draws)?;
        let mut assets = self.groups[group].1.clone();
        let headings = match &self.recipe.heading {
            None => None,
            Some(histogram) => {
                let bin = self.draw_heading(histogram, &assets, draws)?;
                assets.retain(|asset| self.allows(*asset, &bin));
                Some(bin)
            }
        };
        let range = self.recipe.distance_m;
        let distance_m = match &self.recipe.distance {
            None => range,
            Some(histogram) => {
                let bin = draw_weighted(histogram.weights.iter().copied(), draws)?;
                histogram.bin(bin, range)
            }
        };
        assets.retain(|asset| nearest_m(&self.library[*asset].coverage) < distance_m[1]);
        (!assets.is_empty()).then_some(Target {
            assets,
            headings,
            distance_m,
        })
    }

    fn group_by_class(&mut self) -> Result<()> {
        let (_, eligible) = self.groups.remove(0);
        for share in self.recipe.class_shares.iter().filter(|s| s.weight > 0.0) {
            let of_class = |asset: &usize| self.library[*asset].class == share.class;
            let assets: Vec<usize> = eligible.iter().copied().filter(of_class).collect();
            if assets.is_empty() && self.recipe.min_objects > 0 {
                return Err(Error::invalid(format!(
                    "recipe: class_shares asks for {}, of which no library object matches",
                    share.class.name()
                )));
            }
            self.groups.push((share.weight, assets));
        }
        Ok(())
    }

    fn check_headings(&self) -> Result<()> {
        let Some(histogram) = &self.recipe.heading else {
            return Ok(());
        };
        let none = self
            .groups
            .iter()
            .any(|(_, assets)| self.allowed_weights(histogram, assets).all(|w| w == 0.0));
        if none && self.recipe.min_objects > 0 {
            return Err(Error::invalid(
                "recipe: heading_histogram has no weight where any of the objects was observed from",
            ));
        }
        Ok(())
    }

    fn draw_heading(
        &self,
        histogram: &Histogram,
        assets: &[usize],
        draws: &mut Draws,
    ) -> Option<Arcs> {
        let weights: Vec<f64> = self.allowed_weights(histogram, assets).collect();
        let bin = draw_weighted(weights.iter().copied(), draws)?;
        Some(arc_of(histogram, bin))
    }

    /// The histogram's weights, 0 where none of the assets was observed from.
    fn allowed_weights(
        &self,
        histogram: &Histogram,
        assets: &[usize],
    ) -> impl Iterator<Item = f64> {
        (0..histogram.weights.len()).map(move |bin| {
            let arc = arc_of(histogram, bin);
            match assets.iter().any(|asset| self.allows(*asset, &arc)) {
                true => histogram.weights[bin],
                false => 0.0,
            }
        })
    }

    fn allows(&self, asset: usize, arc: &Arcs) -> bool {
        let coverage = &self.library[asset].coverage;
        let seen = observed_headings(coverage, self.recipe.coverage_slack_rad).intersect(arc);
        // Without slack only single angles are observed.
        seen.measure_rad() > LEAST_ARC_RAD
            || (self.recipe.coverage_slack_rad == 0.0 && !seen.is_empty())
    }
}

fn arc_of(histogram: &Histogram, bin: usize) -> Arcs {
    let [from, to] = histogram.bin(bin, [-PI, PI]);
    Arcs::between(from, to.min(PI))
}

fn is_eligible(asset: &Candidate, stage: &Stage<'_>, recipe: &Recipe) -> bool {
    let logs = &recipe.source_logs;
    asset.library
        && (recipe.objects.is_empty() || recipe.objects.contains(&asset.name))
        && (recipe.classes.is_empty() || recipe.classes.contains(&asset.class))
        && (logs.is_empty() || logs.contains(&asset.source_log))
        && !(recipe.other_logs_only && asset.source_log == stage.source_log)
}
