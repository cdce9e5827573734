//! Samples as files: images, planes, labels and an index.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use backlot_proto::v1;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::labels::{kitti_calibration, kitti_labels, sample_record};

/// Forms in which labels are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LabelFormat {
    Kitti,
    Json,
}

/// Writes samples below a folder. The same samples make the same files, byte for byte.
#[derive(Debug)]
pub struct SampleFiles {
    out: PathBuf,
    formats: Vec<LabelFormat>,
    entries: Vec<IndexEntry>,
}

/// Where the files of one frame are, relative to the index.
#[derive(Clone, Debug, Serialize)]
pub struct IndexEntry {
    pub index: u64,
    pub camera_id: String,
    pub frame_index: u32,
    /// Path by kind: "image", "depth", "instance", "ignore", "label_kitti", "calibration", "label_json".
    pub files: BTreeMap<&'static str, String>,
}

/// What the whole set was made from.
#[derive(Debug, Serialize)]
struct Index<'a> {
    seed: u64,
    library_snapshot: &'a str,
    background: &'a str,
    render_class: &'a str,
    samples: &'a [IndexEntry],
}

impl SampleFiles {
    pub fn new(out: &Path, formats: &[LabelFormat]) -> Self {
        Self {
            out: out.to_owned(),
            formats: formats.to_vec(),
            entries: Vec::new(),
        }
    }

    /// Writes every frame of a sample and returns where.
    pub fn write(&mut self, sample: &v1::Sample) -> Result<&[IndexEntry]> {
        let first = self.entries.len();
        for (i, frame) in sample.frames.iter().enumerate() {
            let stem = match sample.frames.len() {
                0..=1 => format!("{:06}", sample.index),
                _ => format!("{:06}_{i}", sample.index),
            };
            let files = self.write_frame(sample, frame, &stem)?;
            self.entries.push(IndexEntry {
                index: sample.index,
                camera_id: frame.camera_id.clone(),
                frame_index: frame.frame_index,
                files,
            });
        }
        Ok(&self.entries[first..])
    }

    /// Writes `index.json` for the samples written so far; `provenance` is any sample's.
    pub fn write_index(&self, provenance: &v1::SampleProvenance) -> Result<()> {
        let index = Index {
            seed: provenance.seed,
            library_snapshot: &provenance.library_snapshot,
            background: &provenance.background,
            render_class: &provenance.render_class,
            samples: &self.entries,
        };
        self.put("index.json", pretty(&index).as_bytes())
    }

    fn write_frame(
        &self,
        sample: &v1::Sample,
        frame: &v1::SampleFrame,
        stem: &str,
    ) -> Result<BTreeMap<&'static str, String>> {
        let mut files = BTreeMap::new();
        let planes = [
            ("image", "images", &frame.image_png),
            ("depth", "depth", &frame.depth_png),
            ("instance", "instance", &frame.instance_png),
            ("ignore", "ignore", &frame.ignore_png),
        ];
        for (kind, folder, png) in planes {
            if !png.is_empty() {
                files.insert(kind, self.put_new(folder, stem, "png", png)?);
            }
        }
        if self.formats.contains(&LabelFormat::Kitti) {
            let labels = kitti_labels(sample, frame).map_err(|e| Error::Protocol {
                doing: format!("writing labels of sample {}", sample.index),
                what: format!("the ignore mask does not decode: {e}"),
            })?;
            files.insert(
                "label_kitti",
                self.put_new("labels", stem, "txt", labels.as_bytes())?,
            );
            let calibration = kitti_calibration(frame);
            files.insert(
                "calibration",
                self.put_new("calib", stem, "txt", calibration.as_bytes())?,
            );
        }
        if self.formats.contains(&LabelFormat::Json) {
            let record = pretty(&sample_record(sample, frame));
            files.insert(
                "label_json",
                self.put_new("labels", stem, "json", record.as_bytes())?,
            );
        }
        Ok(files)
    }

    fn put_new(&self, folder: &str, stem: &str, extension: &str, content: &[u8]) -> Result<String> {
        let relative = format!("{folder}/{stem}.{extension}");
        self.put(&relative, content)?;
        Ok(relative)
    }

    fn put(&self, relative: &str, content: &[u8]) -> Result<()> {
        let path = self.out.join(relative);
        let folder = path.parent().unwrap_or(&self.out);
        fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        fs::write(&path, content).map_err(|e| Error::io(&path, e))
    }
}

fn pretty(value: &impl Serialize) -> String {
    let mut text = serde_json::to_string_pretty(value).expect("records have string keys");
    text.push('\n');
    text
}
