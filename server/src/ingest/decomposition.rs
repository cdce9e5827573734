//! The stored form of a decomposition: what each pixel of each frame is to the training sets of a log.
//!
//! A JSON manifest names label images, 8-bit grey PNGs: docs/decomposition.md. It is a function of its inputs alone, whose digest it
//! carries: a decomposition of other inputs is never used.

use std::collections::BTreeMap;
use std::io::Cursor;

use backlot_engine::view::PixelLabel;
use image::{ColorType, ImageEncoder, codecs::png};
use serde::{Deserialize, Serialize};

use super::image::{ImageError, decode_sky_mask};
use super::mask_match::MaskMatching;
use super::object_labels::Crop;
use super::object_plan::Rejection;
use super::segmented::{Segmentation, SegmentedFrame};
use super::tied_masks::TiedMask;
use crate::domain::blob::{BlobRef, Digest};

/// Version of the form, and of the rules by which labels are made: grows with either, so that what older servers decided is not reused.
pub(crate) const DECOMPOSITION_VERSION: u32 = 3;

/// All that a decomposition depends on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(crate) struct DecompositionInputs {
    pub version: u32,
    /// The log's manifest, which names every image, mask and sweep by digest.
    pub manifest: BlobRef,
    pub matching: MaskMatching,
    /// Of the segmenter, where there is one and the log has frames without masks.
    pub segmenter: Option<Digest>,
    /// Frames that show the whole object without which a track is not looked at.
    pub least_frames: u32,
}

impl DecompositionInputs {
    /// Equal inputs have equal digests.
    pub(crate) fn digest(&self) -> Digest {
        Digest::of(&serde_json::to_vec(self).expect("plain structs serialise"))
    }
}

/// The manifest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Decomposition {
    pub version: u32,
    /// [`DecompositionInputs::digest`].
    pub inputs: Digest,
    /// The log, `driveLogs/{id}`.
    pub drive_log: String,
    /// What a segmenter found in frames without masks.
    pub segmentation: Option<StoredSegmentation>,
    /// What became of masks that named no track: count per outcome.
    pub free_masks: BTreeMap<String, u32>,
    /// The masks of frames in which the log names no tracks, tied to the tracks that they were matched to.
    pub tied_masks: Vec<TiedMask>,
    /// The background's training set.
    pub background: Vec<LabelledFrame>,
    /// The training set of every track with enough frames.
    pub objects: Vec<LabelledTrack>,
}

/// What a segmenter found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct StoredSegmentation {
    /// The model's file name.
    pub model: String,
    /// Of the model and how it was used.
    pub digest: Digest,
    /// The frames that brought no masks.
    pub frames: Vec<SegmentedFrame>,
}

impl StoredSegmentation {
    pub(super) fn of(segmentation: &Segmentation) -> Self {
        Self {
            model: segmentation.name.clone(),
            digest: segmentation.digest,
            frames: segmentation.frames.values().cloned().collect(),
        }
    }
}

/// A frame of the background's training set.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LabelledFrame {
    pub camera_id: String,
    pub frame_index: u32,
    /// Label image of the camera's size.
    pub labels: BlobRef,
}

/// The frames of one track that geometry did not reject.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct LabelledTrack {
    pub track_id: String,
    pub moving: bool,
    pub frames: Vec<ObjectFrame>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct ObjectFrame {
    pub camera_id: String,
    pub frame_index: u32,
    #[serde(flatten)]
    pub found: ObjectPixels,
}

/// What a frame gives of an object.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ObjectPixels {
    Kept {
        /// The object and its surroundings in the image, in pixels.
        crop: Crop,
        /// Label image of the crop's size.
        labels: BlobRef,
    },
    Rejected(Rejection),
}

/// A stored decomposition cannot be used; it is made again.
#[derive(Debug, thiserror::Error)]
pub(crate) enum DecompositionError {
    #[error("the decomposition is not readable")]
    Unreadable(#[from] serde_json::Error),
    #[error("the decomposition is one of other inputs")]
    OtherInputs,
}

impl Decomposition {
    /// The stored form.
    pub(crate) fn to_json(&self) -> Vec<u8> {
        serde_json::to_vec(self).expect("plain structs with text keys serialise")
    }

    /// Reads what [`Self::to_json`] wrote of the same inputs.
    ///
    /// # Errors
    /// [`DecompositionError`] if it is anything else.
    pub(crate) fn from_json(bytes: &[u8], inputs: &Digest) -> Result<Self, DecompositionError> {
        let read: Self = serde_json::from_slice(bytes)?;
        if read.version != DECOMPOSITION_VERSION || read.inputs != *inputs {
            return Err(DecompositionError::OtherInputs);
        }
        Ok(read)
    }
}

/// The grey value of a label in a label image: apart enough to be seen.
fn grey(label: PixelLabel) -> u8 {
    match label {
        PixelLabel::Unknown => 0,
        PixelLabel::Background => 85,
        PixelLabel::Sky => 170,
        PixelLabel::Foreground => 255,
    }
}

/// A label image, `labels` row-major of `size`, (width, height).
pub(super) fn encode_labels(labels: &[PixelLabel], size: (u32, u32)) -> Vec<u8> {
    let bytes: Vec<u8> = labels.iter().map(|&label| grey(label)).collect();
    let mut out = Cursor::new(Vec::new());
    png::PngEncoder::new(&mut out)
        .write_image(&bytes, size.0, size.1, ColorType::L8.into())
        .expect("grey images of their size encode in memory");
    out.into_inner()
}

/// The inverse of [`encode_labels`].
///
/// # Errors
/// [`ImageError`] if the image is of another form or size, or has other values.
pub(super) fn decode_labels(bytes: &[u8], size: (u32, u32)) -> Result<Vec<PixelLabel>, ImageError> {
    let known = [
        PixelLabel::Unknown,
        PixelLabel::Background,
        PixelLabel::Sky,
        PixelLabel::Foreground,
    ];
    let grey_of = |value: &u8| {
        let found = known.iter().find(|&&label| grey(label) == *value);
        found.copied().ok_or(ImageError::Label { value: *value })
    };
    decode_sky_mask(bytes, size)?.iter().map(grey_of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inputs() -> DecompositionInputs {
        DecompositionInputs {
            version: DECOMPOSITION_VERSION,
            manifest: BlobRef::of(b"log"),
            matching: MaskMatching::default(),
            segmenter: None,
            least_frames: 8,
        }
    }

    #[test]
    fn every_input_changes_the_digest() {
        let digest = inputs().digest();
        assert_eq!(digest, inputs().digest());
        let mut matching = MaskMatching::default();
        matching.least_iou += 1e-9;
        let others = [
            DecompositionInputs {
                version: DECOMPOSITION_VERSION + 1,
                ..inputs()
            },
            DecompositionInputs {
                manifest: BlobRef::of(b"other log"),
                ..inputs()
            },
            DecompositionInputs {
                matching,
                ..inputs()
            },
            DecompositionInputs {
                segmenter: Some(Digest::of(b"model")),
                ..inputs()
            },
            DecompositionInputs {
                least_frames: 20,
                ..inputs()
            },
        ];
        for other in others {
            assert_ne!(other.digest(), digest, "{other:?}");
        }
    }

    #[test]
    fn only_a_decomposition_of_the_same_inputs_is_read() {
        let made = Decomposition {
            version: DECOMPOSITION_VERSION,
            inputs: inputs().digest(),
            drive_log: "driveLogs/street".into(),
            segmentation: Some(StoredSegmentation {
                model: "model.onnx".into(),
                digest: Digest::of(b"model"),
                frames: Vec::new(),
            }),
            free_masks: BTreeMap::from([("matched".into(), 3)]),
            tied_masks: vec![TiedMask {
                camera_id: "front".into(),
                frame_index: 2,
                mask: BlobRef::of(b"mask"),
            }],
            background: Vec::new(),
            objects: vec![LabelledTrack {
                track_id: "7".into(),
                moving: true,
                frames: vec![ObjectFrame {
                    camera_id: "front".into(),
                    frame_index: 2,
                    found: ObjectPixels::Rejected(Rejection::FewReturns),
                }],
            }],
        };
        let bytes = made.to_json();
        assert_eq!(
            Decomposition::from_json(&bytes, &inputs().digest()).unwrap(),
            made
        );
        assert!(Decomposition::from_json(&bytes, &Digest::of(b"other")).is_err());
        assert!(Decomposition::from_json(&bytes[1..], &inputs().digest()).is_err());
        let older = Decomposition {
            version: DECOMPOSITION_VERSION - 1,
            ..made
        };
        assert!(Decomposition::from_json(&older.to_json(), &inputs().digest()).is_err());
    }

    #[test]
    fn label_images_keep_labels_and_refuse_other_images() {
        use PixelLabel::{Background, Foreground, Sky, Unknown};
        let labels = [Unknown, Background, Sky, Foreground, Foreground, Unknown];
        let bytes = encode_labels(&labels, (3, 2));
        assert_eq!(decode_labels(&bytes, (3, 2)).unwrap(), labels);
        assert!(decode_labels(&bytes, (2, 3)).is_err());
        let mut other = Cursor::new(Vec::new());
        image::GrayImage::from_pixel(3, 2, image::Luma([7]))
            .write_to(&mut other, image::ImageFormat::Png)
            .unwrap();
        let error = decode_labels(other.get_ref(), (3, 2)).unwrap_err();
        assert!(error.to_string().contains('7'), "{error}");
    }
}
