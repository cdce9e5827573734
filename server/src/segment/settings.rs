//! What the configuration says about a segmenter, as written and checked.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};

use super::instance::RoadUser;

/// Sides of a model's input in pixels: below, nothing can be told; above, one image takes minutes.
const INPUT_PX: std::ops::RangeInclusive<u32> = 32..=4096;
/// Boxes that overlap more are one object seen twice. The value that Ultralytics uses.
const MOST_IOU: f64 = 0.7;
/// Below this a detection is more likely wrong than right. The value that Ultralytics uses.
const LEAST_SCORE: f64 = 0.25;

/// A segmenter, its values checked but its files not yet opened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SegmenterSettings {
    /// The ONNX file.
    #[serde(skip)]
    pub model: PathBuf,
    pub layout: Layout,
    /// Width and height of the model's input.
    pub input_px: (u32, u32),
    /// Road user of each of the model's classes; others are left out.
    pub classes: BTreeMap<u32, RoadUser>,
    pub least_score: f64,
    /// Non-maximum suppression takes boxes that overlap more for one.
    pub most_iou: f64,
    pub channels: ChannelOrder,
    /// A channel's number is (value / 255 - mean) / deviation, in the model's channel order.
    pub mean: [f64; 3],
    pub deviation: [f64; 3],
    pub runtime: RuntimeKind,
    /// The shared library of ONNX Runtime; `None` takes `ORT_DYLIB_PATH`, else the system's.
    #[serde(skip)]
    pub library: Option<PathBuf>,
}

/// What a model's outputs mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    YoloSeg,
    MaskRcnn,
}

impl Layout {
    /// Name in configurations.
    pub fn name(self) -> &'static str {
        match self {
            Self::YoloSeg => "yolo-seg",
            Self::MaskRcnn => "mask-rcnn",
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum ChannelOrder {
    #[default]
    Rgb,
    Bgr,
}

/// What runs a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum RuntimeKind {
    OnnxRuntime,
    Tract,
}

impl RuntimeKind {
    /// Name in configurations, and of the cargo feature.
    pub fn name(self) -> &'static str {
        match self {
            Self::OnnxRuntime => "onnxruntime",
            Self::Tract => "tract",
        }
    }

    /// Whether this build has it.
    pub fn is_built_in(self) -> bool {
        match self {
            Self::OnnxRuntime => cfg!(feature = "onnxruntime"),
            Self::Tract => cfg!(feature = "tract"),
        }
    }
}

/// A segmenter as written in the configuration; every value may be absent.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RawSegmenter {
    pub model: Option<PathBuf>,
    pub layout: Option<String>,
    pub input_px: Option<[u32; 2]>,
    pub classes: Option<BTreeMap<String, String>>,
    pub least_score: Option<f64>,
    pub most_iou: Option<f64>,
    pub channels: Option<String>,
    pub mean: Option<[f64; 3]>,
    pub deviation: Option<[f64; 3]>,
    pub runtime: Option<String>,
    pub library: Option<PathBuf>,
}

/// A value that cannot be used: its key and why.
pub(crate) type Refused = (&'static str, String);

impl RawSegmenter {
    /// Checks every value and fills the defaults in.
    pub(crate) fn check(self) -> Result<SegmenterSettings, Refused> {
        let needed = |key| (key, "is not set".to_owned());
        let runtime = runtime(self.runtime.as_deref())?;
        if self.library.is_some() && runtime != RuntimeKind::OnnxRuntime {
            let why = format!("is for runtime \"onnxruntime\", not \"{}\"", runtime.name());
            return Err(("segmenter.library", why));
        }
        Ok(SegmenterSettings {
            model: self.model.ok_or_else(|| needed("segmenter.model"))?,
            layout: layout(&self.layout.ok_or_else(|| needed("segmenter.layout"))?)?,
            input_px: input(self.input_px.ok_or_else(|| needed("segmenter.input_px"))?)?,
            classes: classes(self.classes.ok_or_else(|| needed("segmenter.classes"))?)?,
            least_score: share("segmenter.least_score", self.least_score, LEAST_SCORE)?,
            most_iou: share("segmenter.most_iou", self.most_iou, MOST_IOU)?,
            channels: channels(self.channels.as_deref())?,
            mean: finite("segmenter.mean", self.mean, [0.0; 3])?,
            deviation: deviation(self.deviation)?,
            runtime,
            library: self.library,
        })
    }
}

/// ONNX Runtime where it is built in, since it is the faster one.
fn runtime(written: Option<&str>) -> Result<RuntimeKind, Refused> {
    const KEY: &str = "segmenter.runtime";
    let all = [RuntimeKind::OnnxRuntime, RuntimeKind::Tract];
    let Some(written) = written else {
        let built = all.into_iter().find(|kind| kind.is_built_in());
        let why = "this build has neither of the cargo features \"onnxruntime\" and \"tract\"";
        return built.ok_or((KEY, why.to_owned()));
    };
    let kind = all.into_iter().find(|kind| kind.name() == written);
    let kind = kind.ok_or_else(|| {
        (
            KEY,
            format!("\"{written}\" is neither \"onnxruntime\" nor \"tract\""),
        )
    })?;
    if kind.is_built_in() {
        return Ok(kind);
    }
    let why = format!("this build does not have the cargo feature \"{written}\"");
    Err((KEY, why))
}

fn layout(written: &str) -> Result<Layout, Refused> {
    let all = [Layout::YoloSeg, Layout::MaskRcnn];
    let found = all.into_iter().find(|layout| layout.name() == written);
    let why = || format!("\"{written}\" is neither \"yolo-seg\" nor \"mask-rcnn\"");
    found.ok_or_else(|| ("segmenter.layout", why()))
}

fn input([width, height]: [u32; 2]) -> Result<(u32, u32), Refused> {
    if INPUT_PX.contains(&width) && INPUT_PX.contains(&height) {
        return Ok((width, height));
    }
    let (least, most) = (INPUT_PX.start(), INPUT_PX.end());
    let why = format!("{width} x {height}: width and height are {least} to {most}");
    Err(("segmenter.input_px", why))
}

fn classes(written: BTreeMap<String, String>) -> Result<BTreeMap<u32, RoadUser>, Refused> {
    const KEY: &str = "segmenter.classes";
    if written.is_empty() {
        return Err((KEY, "no class of the model is a road user".to_owned()));
    }
    let one = |(class, user): (String, String)| {
        let number = class.parse();
        let number =
            number.map_err(|_| (KEY, format!("\"{class}\" is not the number of a class")))?;
        let found = RoadUser::ALL.into_iter().find(|u| u.name() == user);
        let why = || format!("class {class}: \"{user}\" is none of vehicle, pedestrian, cyclist");
        Ok((number, found.ok_or_else(|| (KEY, why()))?))
    };
    written.into_iter().map(one).collect()
}

fn share(key: &'static str, value: Option<f64>, default: f64) -> Result<f64, Refused> {
    let value = value.unwrap_or(default);
    if value > 0.0 && value <= 1.0 {
        return Ok(value);
    }
    Err((key, format!("{value} is not between 0 and 1")))
}

fn channels(written: Option<&str>) -> Result<ChannelOrder, Refused> {
    match written {
        None | Some("rgb") => Ok(ChannelOrder::Rgb),
        Some("bgr") => Ok(ChannelOrder::Bgr),
        Some(other) => {
            let why = format!("\"{other}\" is neither \"rgb\" nor \"bgr\"");
            Err(("segmenter.channels", why))
        }
    }
}

fn finite(
    key: &'static str,
    written: Option<[f64; 3]>,
    default: [f64; 3],
) -> Result<[f64; 3], Refused> {
    let values = written.unwrap_or(default);
    if values.iter().all(|v| v.is_finite()) {
        return Ok(values);
    }
    Err((key, format!("{values:?} is not finite")))
}

fn deviation(written: Option<[f64; 3]>) -> Result<[f64; 3], Refused> {
    const KEY: &str = "segmenter.deviation";
    let values = finite(KEY, written, [1.0; 3])?;
    if values.iter().all(|v| *v > 0.0) {
        return Ok(values);
    }
    Err((KEY, format!("{values:?} is not positive")))
}

#[cfg(all(test, any(feature = "onnxruntime", feature = "tract")))]
mod tests {
    use super::*;

    const GOOD: &str = "model = \"m.onnx\"\nlayout = \"yolo-seg\"\ninput_px = [640, 384]\n";

    fn check(text: &str) -> Result<SegmenterSettings, Refused> {
        toml::from_str::<RawSegmenter>(text)
            .expect("the text is a table")
            .check()
    }

    #[test]
    fn a_short_configuration_is_enough() {
        let settings = check(&format!(
            "{GOOD}classes = {{ 0 = \"pedestrian\", 2 = \"vehicle\" }}"
        ));
        let settings = settings.unwrap();
        assert_eq!(settings.input_px, (640, 384));
        assert_eq!(settings.classes[&2], RoadUser::Vehicle);
        assert_eq!((settings.least_score, settings.most_iou), (0.25, 0.7));
        assert_eq!((settings.mean, settings.deviation), ([0.0; 3], [1.0; 3]));
    }

    #[test]
    fn every_wrong_value_is_named() {
        let refused = |text: &str| {
            let (key, why) = check(text).unwrap_err();
            format!("{key}: {why}")
        };
        let with = |line: &str| refused(&format!("{GOOD}classes = {{ 2 = \"vehicle\" }}\n{line}"));
        assert_eq!(refused(""), "segmenter.model: is not set");
        assert_eq!(refused(GOOD), "segmenter.classes: is not set");
        assert!(refused(&format!("{GOOD}classes = {{}}")).contains("no class"));
        let classes = refused(&format!("{GOOD}classes = {{ car = \"vehicle\" }}"));
        assert!(classes.contains("\"car\" is not the number"), "{classes}");
        let classes = refused(&format!("{GOOD}classes = {{ 2 = \"car\" }}"));
        assert!(classes.contains("class 2: \"car\""), "{classes}");
        assert!(with("least_score = 0.0").starts_with("segmenter.least_score: 0"));
        assert!(with("most_iou = nan").starts_with("segmenter.most_iou: NaN"));
        assert!(with("channels = \"rbg\"").contains("\"rbg\""));
        assert!(with("mean = [0.0, inf, 0.0]").starts_with("segmenter.mean"));
        assert!(with("deviation = [1.0, 0.0, 1.0]").starts_with("segmenter.deviation"));
        assert!(with("runtime = \"cuda\"").contains("\"cuda\" is neither"));
        let layout = refused("model = \"m\"\nlayout = \"sam\"");
        assert!(layout.contains("\"sam\" is neither"), "{layout}");
        let input = refused("model = \"m\"\nlayout = \"mask-rcnn\"\ninput_px = [8, 8]");
        assert!(input.contains("8 x 8"), "{input}");
        assert!(toml::from_str::<RawSegmenter>("weights = \"m\"").is_err());
    }
}
