//! The options that say what to make, and the recipe they are.

use anyhow::{Context, bail, ensure};
use backlot_client::names;
use backlot_proto::v1;
use clap::{Args, ValueEnum};

/// How objects are chosen and placed. What is not given is the preset's.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct RecipeOptions {
    #[arg(long, value_enum, default_value_t = Preset::Default)]
    pub preset: Preset,
    /// Library snapshot to draw from; by default the present library.
    #[arg(long, value_name = "SNAPSHOT")]
    pub snapshot: Option<String>,
    /// Objects inserted a sample; by default the preset's, mostly 1 to 3.
    #[arg(long, value_name = "N")]
    pub min_objects: Option<u32>,
    #[arg(long, value_name = "N")]
    pub max_objects: Option<u32>,
    /// Object assets to draw from; by default every one that passed the quality gate.
    #[arg(long, value_delimiter = ',', value_name = "ASSET")]
    pub objects: Vec<String>,
    /// Classes to draw from, e.g. car,cyclist; `vehicle` is car, van, truck, bus and tram.
    #[arg(long, value_delimiter = ',', value_name = "CLASS")]
    pub classes: Vec<String>,
    /// Share of each class, e.g. car=3,pedestrian=1; by default as there are assets.
    #[arg(long, value_delimiter = ',', value_name = "CLASS=WEIGHT")]
    pub class_shares: Vec<String>,
    /// Logs whose objects may be drawn; by default all.
    #[arg(long, value_delimiter = ',', value_name = "LOG")]
    pub source_logs: Vec<String>,
    /// Draw only objects of other logs than the background's.
    #[arg(long)]
    pub other_logs_only: bool,
    /// Shares of equal bins of camera-relative heading from -180 to 180 degrees; 0 drives away from the camera, 90 shows its left side.
    #[arg(long, value_delimiter = ',', value_name = "WEIGHT")]
    pub heading_histogram: Option<Vec<f64>>,
    /// Shares of equal bins of distance from --min-distance to --max-distance.
    #[arg(long, value_delimiter = ',', value_name = "WEIGHT")]
    pub distance_histogram: Option<Vec<f64>>,
    /// Distance from the camera to the objects' centres.
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub min_distance: Option<f64>,
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub max_distance: Option<f64>,
    /// Largest change of the heading, from the road's direction or the recorded one.
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    pub jitter_heading: Option<f64>,
    /// Slack beyond the views from which an object was observed.
    #[arg(long, value_name = "DEGREES", allow_negative_numbers = true)]
    pub coverage_slack: Option<f64>,
    /// Probability that an original object is replaced by one of the library.
    #[arg(long, value_name = "0..1", default_value_t = 0.0)]
    pub replace: f64,
    /// Leave the original moving objects out.
    #[arg(long)]
    pub drop_originals: bool,
    /// Camera of the log; by default the first.
    #[arg(long, default_value = "")]
    pub camera: String,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub(crate) enum Preset {
    /// Free places at all distances, along the road.
    #[default]
    Default,
    /// Recorded poses, jittered by 20 m, 5 m and 30 degrees as in the paper.
    Paper,
    /// Recorded poses as they are.
    PaperNoRt,
    /// Every 30 degrees of camera-relative heading equally often.
    BalancedHeading,
    /// 30 to 70 m away.
    Far,
    /// 6 to 12 objects.
    Dense,
    /// Partly hidden by the environment.
    Occluded,
    /// Across the road.
    StrangeHeading,
    /// Where the ground rises or falls by at least 3 %.
    OnSlope,
    /// Close ahead, turning into the ego's lane.
    CutIn,
    /// 4 to 8 objects bumper to bumper.
    DenseQueue,
}

const VEHICLES: [v1::ObjectClass; 5] = [
    v1::ObjectClass::Car,
    v1::ObjectClass::Van,
    v1::ObjectClass::Truck,
    v1::ObjectClass::Bus,
    v1::ObjectClass::Tram,
];

impl RecipeOptions {
    /// The recipe for a background's full name.
    pub(crate) fn recipe(&self, background: String) -> anyhow::Result<v1::Recipe> {
        ensure!(
            (0.0..=1.0).contains(&self.replace),
            "--replace must lie between 0 and 1"
        );
        let objects = self.objects.iter().map(|name| names::asset(name));
        let logs = self.source_logs.iter().map(|name| names::drive_log(name));
        let classes = self.classes.iter().map(|name| classes(name));
        let classes: Vec<_> = classes.collect::<anyhow::Result<_>>()?;
        let histogram = |weights: &Option<Vec<f64>>| {
            let weights = weights.clone();
            weights.map(|weights| v1::Histogram { weights })
        };
        Ok(v1::Recipe {
            library_snapshot: self.snapshot.clone().unwrap_or_default(),
            background,
            preset: self.preset.to_wire().into(),
            min_objects: self.min_objects,
            max_objects: self.max_objects,
            objects: objects.collect::<Result<_, _>>()?,
            classes: classes.concat().into_iter().map(Into::into).collect(),
            class_shares: class_shares(&self.class_shares)?,
            source_logs: logs.collect::<Result<_, _>>()?,
            other_logs_only: self.other_logs_only,
            heading_histogram: histogram(&self.heading_histogram),
            distance_histogram: histogram(&self.distance_histogram),
            min_distance_m: self.min_distance,
            max_distance_m: self.max_distance,
            jitter_heading_rad: self.jitter_heading.map(f64::to_radians),
            coverage_slack_rad: self.coverage_slack.map(f64::to_radians),
            replace_probability: self.replace,
            drop_originals: self.drop_originals,
            camera_id: self.camera.clone(),
            ..Default::default()
        })
    }
}

impl Preset {
    fn to_wire(self) -> v1::PlacementPreset {
        use v1::PlacementPreset as Wire;
        match self {
            Self::Default => Wire::Default,
            Self::Paper => Wire::Paper,
            Self::PaperNoRt => Wire::PaperNoRt,
            Self::BalancedHeading => Wire::BalancedHeading,
            Self::Far => Wire::Far,
            Self::Dense => Wire::Dense,
            Self::Occluded => Wire::Occluded,
            Self::StrangeHeading => Wire::StrangeHeading,
            Self::OnSlope => Wire::OnSlope,
            Self::CutIn => Wire::CutIn,
            Self::DenseQueue => Wire::DenseQueue,
        }
    }
}

fn classes(name: &str) -> anyhow::Result<Vec<v1::ObjectClass>> {
    if name.eq_ignore_ascii_case("vehicle") {
        return Ok(VEHICLES.to_vec());
    }
    let wire = format!("OBJECT_CLASS_{}", name.to_uppercase());
    match v1::ObjectClass::from_str_name(&wire) {
        Some(class) if class != v1::ObjectClass::Unspecified => Ok(vec![class]),
        _ => bail!(
            "{name:?} is not a class; use vehicle, car, van, truck, bus, tram, pedestrian, cyclist or other"
        ),
    }
}

fn class_shares(texts: &[String]) -> anyhow::Result<Vec<v1::ClassShare>> {
    let mut shares = Vec::new();
    for text in texts {
        let parts = text.split_once('=');
        let (name, weight) = parts.with_context(|| format!("{text:?} is not CLASS=WEIGHT"))?;
        let weight: f64 = weight
            .parse()
            .with_context(|| format!("{text:?}: the weight is not a number"))?;
        let classes = classes(name)?;
        ensure!(
            classes.len() == 1,
            "--class-shares wants single classes; {name:?} is several"
        );
        shares.push(v1::ClassShare {
            object_class: classes[0].into(),
            weight,
        });
    }
    Ok(shares)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(options: RecipeOptions) -> anyhow::Result<v1::Recipe> {
        options.recipe("assets/street".to_owned())
    }

    #[test]
    fn classes_and_shares_are_read_and_mistakes_named() {
        let made = recipe(RecipeOptions {
            classes: vec!["vehicle".into(), "Pedestrian".into()],
            class_shares: vec!["car=3".into(), "pedestrian=1".into()],
            ..Default::default()
        });
        let made = made.unwrap();
        assert_eq!(made.classes.len(), 6);
        assert_eq!(made.class_shares[0].weight, 3.0);
        assert_eq!(made.min_objects, None);
        for (options, part) in [
            (
                RecipeOptions {
                    classes: vec!["horse".into()],
                    ..Default::default()
                },
                "horse",
            ),
            (
                RecipeOptions {
                    class_shares: vec!["car".into()],
                    ..Default::default()
                },
                "CLASS=WEIGHT",
            ),
            (
                RecipeOptions {
                    class_shares: vec!["vehicle=2".into()],
                    ..Default::default()
                },
                "several",
            ),
            (
                RecipeOptions {
                    replace: 2.0,
                    ..Default::default()
                },
                "--replace",
            ),
        ] {
            let message = recipe(options).unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
