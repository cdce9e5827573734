//! Samples as files: images, planes, labels and an index.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use backlot_proto::v1;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::labels::{
    CocoSet, NUSCENES_MAP, NUSCENES_VERSION, NuscenesTables, kitti_calibration, kitti_labels,
    kitti_tracking_labels, sample_record, waymo_components, waymo_segment,
};

/// Forms in which labels are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LabelFormat {
    /// `labels/*.txt` and `calib/`; for clips also `labels_tracking/`.
    Kitti,
    /// `labels/*.json`: everything a sample says.
    Json,
    /// `coco.json` for the whole set.
    Coco,
    /// `v1.0-backlot/` for the whole set: the folder is nuScenes' data root.
    Nuscenes,
    /// `waymo/COMPONENT/SEGMENT.parquet`, a segment a sample.
    Waymo,
}

/// Writes samples below a folder. The same samples make the same files, byte for byte.
#[derive(Debug)]
pub struct SampleFiles {
    out: PathBuf,
    formats: Vec<LabelFormat>,
    entries: Vec<IndexEntry>,
    coco: CocoSet,
    nuscenes: NuscenesTables,
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
            coco: CocoSet::default(),
            nuscenes: NuscenesTables::default(),
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
            let files = self.write_frame(sample, i, &stem)?;
            self.entries.push(IndexEntry {
                index: sample.index,
                camera_id: frame.camera_id.clone(),
                frame_index: frame.frame_index,
                files,
            });
        }
        self.write_sample_labels(sample)?;
        self.gather(sample, first)?;
        Ok(&self.entries[first..])
    }

    /// Labels that are one file a sample.
    fn write_sample_labels(&self, sample: &v1::Sample) -> Result<()> {
        if self.formats.contains(&LabelFormat::Kitti) && sample.frames.len() > 1 {
            let labels = kitti_tracking_labels(sample);
            let stem = format!("{:06}", sample.index);
            self.put_new("labels_tracking", &stem, "txt", labels.as_bytes())?;
        }
        if self.formats.contains(&LabelFormat::Waymo) {
            let components = waymo_components(sample).map_err(|e| Error::Protocol {
                doing: format!("writing labels of sample {}", sample.index),
                what: format!("Parquet: {e}"),
            })?;
            let segment = waymo_segment(sample);
            for (component, table) in components {
                self.put_new(&format!("waymo/{component}"), &segment, "parquet", &table)?;
            }
        }
        Ok(())
    }

    /// Labels that are one file for the set wait until the index is written.
    fn gather(&mut self, sample: &v1::Sample, first: usize) -> Result<()> {
        let image = |entry: &IndexEntry| entry.files["image"].clone();
        let images: Vec<String> = self.entries[first..].iter().map(image).collect();
        if self.formats.contains(&LabelFormat::Coco) {
            for (position, image) in images.iter().enumerate() {
                let added = self.coco.add(sample, position, image);
                added.map_err(|e| bad_mask(sample, &e))?;
            }
        }
        if self.formats.contains(&LabelFormat::Nuscenes) {
            self.nuscenes.add(sample, &images);
        }
        Ok(())
    }

    /// Writes `index.json`, and the labels that are one file a set, for the samples written so far; `provenance` is any sample's.
    pub fn write_index(&self, provenance: &v1::SampleProvenance) -> Result<()> {
        let index = Index {
            seed: provenance.seed,
            library_snapshot: &provenance.library_snapshot,
            background: &provenance.background,
            render_class: &provenance.render_class,
            samples: &self.entries,
        };
        self.put("index.json", pretty(&index).as_bytes())?;
        if self.formats.contains(&LabelFormat::Coco) {
            self.put("coco.json", self.coco.to_json(provenance).as_bytes())?;
        }
        if self.formats.contains(&LabelFormat::Nuscenes) {
            for (table, rows) in self.nuscenes.files() {
                let path = format!("{NUSCENES_VERSION}/{table}");
                self.put(&path, rows.as_bytes())?;
            }
            let mut map = std::io::Cursor::new(Vec::new());
            image::GrayImage::new(1, 1)
                .write_to(&mut map, image::ImageFormat::Png)
                .expect("one pixel encodes");
            self.put(NUSCENES_MAP, map.get_ref())?;
        }
        Ok(())
    }

    fn write_frame(
        &self,
        sample: &v1::Sample,
        position: usize,
        stem: &str,
    ) -> Result<BTreeMap<&'static str, String>> {
        let frame = &sample.frames[position];
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
            let labels = kitti_labels(sample, frame).map_err(|e| bad_mask(sample, &e))?;
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
            let record = pretty(&sample_record(sample, position));
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

fn bad_mask(sample: &v1::Sample, error: &image::ImageError) -> Error {
    Error::Protocol {
        doing: format!("writing labels of sample {}", sample.index),
        what: format!("the ignore mask does not decode: {error}"),
    }
}

fn pretty(value: &impl Serialize) -> String {
    let mut text = serde_json::to_string_pretty(value).expect("records have string keys");
    text.push('\n');
    text
}
