//! Opens a configured segmenter: its model is read, run once and found to be of its layout before the server takes a call.

use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use super::detection::Decoding;
use super::error::SegmentError;
use super::instance::RoadUser;
use super::letterbox::Normalisation;
use super::model::ModelSegmenter;
use super::segmenter::{RgbImage, Segmenter};
use super::settings::{Refused, RuntimeKind, SegmenterSettings};
use super::tensor::Runtime;
use crate::domain::blob::Digest;
use crate::error::{ErrorKind, Kinded};

/// Segmentation models have some tens of megabytes, the largest some hundreds.
const MOST_MODEL_BYTES: u64 = 2 << 30;

/// Version of how outputs become masks: grows when the same outputs give other masks.
const DECODING_VERSION: u32 = 1;

/// A server with a segmenter that cannot be opened does not start.
#[derive(Debug, thiserror::Error)]
pub enum OpenError {
    #[error("read segmenter.model {path}: {source}")]
    Read {
        path: String,
        source: std::io::Error,
    },
    #[error("{key}: {why}")]
    Refused { key: &'static str, why: String },
    #[error("segmenter.layout: {path}: {source}")]
    Layout { path: String, source: SegmentError },
}

impl Kinded for OpenError {
    fn kind(&self) -> ErrorKind {
        ErrorKind::Invalid
    }
}

impl From<Refused> for OpenError {
    fn from((key, why): Refused) -> Self {
        Self::Refused { key, why }
    }
}

/// Opens the segmenter; `threads` run one image, 0 meaning one a core. Blocks for seconds.
///
/// # Errors
/// [`OpenError`] if the model or the runtime's library cannot be read, or if the model is not what the settings say.
pub fn open(settings: &SegmenterSettings, threads: usize) -> Result<Arc<dyn Segmenter>, OpenError> {
    let path = settings.model.display().to_string();
    let read = |source| OpenError::Read {
        path: path.clone(),
        source,
    };
    let model = read_model(&settings.model).map_err(read)?;
    let runtime = runtime(settings, &model, threads)?;
    let name = settings.model.file_name().unwrap_or_default();
    let segmenter = ModelSegmenter {
        name: name.to_string_lossy().into_owned(),
        digest: digest(settings, &model),
        runtime,
        layout: settings.layout,
        input_px: settings.input_px,
        normalisation: Normalisation {
            order: settings.channels,
            mean: settings.mean.map(|v| v as f32),
            deviation: settings.deviation.map(|v| v as f32),
        },
        decoding: decoding(settings),
    };
    let begun = Instant::now();
    let tried = try_out(&segmenter);
    tried.map_err(|source| OpenError::Layout { path, source })?;
    let seconds = begun.elapsed().as_secs_f64();
    tracing::info!(model = segmenter.name, digest = %segmenter.digest, runtime = settings.runtime.name(), seconds, "segmenter");
    Ok(Arc::new(segmenter))
}

fn read_model(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut model = Vec::new();
    let file = File::open(path)?;
    file.take(MOST_MODEL_BYTES + 1).read_to_end(&mut model)?;
    if model.len() as u64 > MOST_MODEL_BYTES {
        let why = "larger than 2 GiB; keep weights in the file itself and export a smaller model";
        return Err(std::io::Error::other(why));
    }
    Ok(model)
}

#[cfg_attr(
    not(feature = "onnxruntime"),
    allow(unused_variables, reason = "tract has no threads of its own")
)]
fn runtime(
    settings: &SegmenterSettings,
    model: &[u8],
    threads: usize,
) -> Result<Box<dyn Runtime>, OpenError> {
    match settings.runtime {
        #[cfg(feature = "onnxruntime")]
        RuntimeKind::OnnxRuntime => {
            let library = settings.library.as_deref();
            let input_px = settings.input_px;
            let opened = super::onnxruntime::OnnxRuntime::open(library, model, input_px, threads)?;
            Ok(Box::new(opened))
        }
        #[cfg(feature = "tract")]
        RuntimeKind::Tract => {
            let opened = super::tract::Tract::open(model, settings.input_px)?;
            Ok(Box::new(opened))
        }
        #[cfg(not(all(feature = "onnxruntime", feature = "tract")))]
        absent => Err(OpenError::Refused {
            key: "segmenter.runtime",
            why: format!(
                "this build does not have the cargo feature \"{}\"",
                absent.name()
            ),
        }),
    }
}

/// All that answers depend on: the model's bytes and how they are used.
fn digest(settings: &SegmenterSettings, model: &[u8]) -> Digest {
    let all = (DECODING_VERSION, Digest::of(model), settings);
    Digest::of(&serde_json::to_vec(&all).expect("plain structs serialise"))
}

fn decoding(settings: &SegmenterSettings) -> Decoding {
    let classes = settings.classes.iter();
    Decoding {
        classes: classes
            .map(|(class, user): (&u32, &RoadUser)| (*class, *user))
            .collect(),
        least_score: settings.least_score as f32,
        most_iou: settings.most_iou,
    }
}

/// Segments one grey image, which shows whether the outputs are of the layout.
fn try_out(segmenter: &ModelSegmenter) -> Result<(), SegmentError> {
    let size = segmenter.input_px;
    let grey = vec![114; size.0 as usize * size.1 as usize * 3];
    let image = RgbImage {
        size,
        pixels: &grey,
    };
    segmenter.segment(image).map(|_| ())
}
