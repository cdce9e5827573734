//! Samples as files: images, planes, labels and an index.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use backlot_proto::v1;
use serde::Serialize;

use crate::error::{Error, Result};
use crate::labels::{
    CocoSet, NUSCENES_MAP, NUSCENES_VERSION, NuscenesTables, kitti_calibration, kitti_labels,
    kitti_tracking_labels, pretty, sample_record, waymo_components, waymo_segment,
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

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use serde_json::Value;

    use super::*;
    use crate::geometry::{rigid_to_wire, vector_to_wire};
    use backlot_engine::camera::Rigid;
    use glam::DVec3;

    fn png(rgb: bool) -> bytes::Bytes {
        let mut out = std::io::Cursor::new(Vec::new());
        let format = image::ImageFormat::Png;
        let written = match rgb {
            true => image::RgbImage::new(4, 2).write_to(&mut out, format),
            false => image::GrayImage::new(4, 2).write_to(&mut out, format),
        };
        written.expect("eight pixels encode");
        out.into_inner().into()
    }

    /// A clip of two frames: a car drives through both, another is in the second alone.
    fn clip() -> v1::Sample {
        let at = |x: f64| rigid_to_wire(&Rigid::from_heading(0.0, DVec3::new(x, 0.0, 0.8)));
        let view = |instance_id: u32, x: f64| v1::SampleBox2D {
            instance_id,
            visible: Some(v1::Box2D {
                x_min: 1.0,
                y_min: 0.0,
                x_max: 2.0,
                y_max: 2.0,
            }),
            visible_pixels: 2,
            visible_fraction: 0.9,
            world_from_cuboid: Some(at(x)),
            ego_from_cuboid: Some(at(x)),
            velocity_mps: Some(vector_to_wire(DVec3::X * 5.0)),
            mask_runs: vec![2, 2, 4],
            ..Default::default()
        };
        let frame = |k: u32, boxes_2d| v1::SampleFrame {
            camera_id: "front".into(),
            timestamp_ns: 1_000_000_000 + i64::from(k) * 100_000_000,
            frame_index: k,
            view: Some(v1::CameraView {
                width: 4,
                height: 2,
                focal_x_px: 3.0,
                focal_y_px: 3.0,
                principal_x_px: 2.0,
                principal_y_px: 1.0,
                world_from_camera: Some(at(0.0)),
            }),
            image_png: png(true),
            ignore_png: png(false),
            boxes_2d,
            ..Default::default()
        };
        let car = |instance_id| v1::SampleBox {
            instance_id,
            object_class: v1::ObjectClass::Car.into(),
            cuboid: Some(v1::Cuboid {
                world_from_cuboid: Some(at(9.0)),
                size_m: Some(vector_to_wire(DVec3::new(4.0, 2.0, 1.5))),
            }),
            ..Default::default()
        };
        v1::Sample {
            index: 3,
            frames: vec![
                frame(0, vec![view(1, 9.0)]),
                frame(1, vec![view(1, 9.5), view(2, 20.0)]),
            ],
            boxes_3d: vec![car(1), car(2)],
            provenance: Some(v1::SampleProvenance {
                background: "assets/street".into(),
                seed: 7,
                ..Default::default()
            }),
            ..Default::default()
        }
    }

    fn write(folder: &Path, sample: &v1::Sample) {
        use LabelFormat::{Coco, Json, Kitti, Nuscenes, Waymo};
        let mut files = SampleFiles::new(folder, &[Kitti, Json, Coco, Nuscenes, Waymo]);
        files.write(sample).unwrap();
        let provenance = sample.provenance.clone().unwrap();
        files.write_index(&provenance).unwrap();
    }

    fn table(folder: &Path, name: &str) -> Vec<Value> {
        let text = fs::read_to_string(folder.join(NUSCENES_VERSION).join(name)).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// Tokens that name no record, whatever their column.
    fn dangling(folder: &Path) -> Vec<String> {
        let names: Vec<String> = fs::read_dir(folder.join(NUSCENES_VERSION))
            .unwrap()
            .map(|file| file.unwrap().file_name().into_string().unwrap())
            .collect();
        let rows: Vec<Value> = names.iter().flat_map(|name| table(folder, name)).collect();
        let text = |v: &Value| v.as_str().unwrap_or_default().to_owned();
        let known: BTreeSet<String> = rows.iter().map(|row| text(&row["token"])).collect();
        assert_eq!(known.len(), rows.len(), "tokens are unique");
        let mut found = Vec::new();
        for row in &rows {
            for (column, value) in row.as_object().unwrap() {
                let links = ["prev", "next"].contains(&column.as_str());
                if (column.ends_with("_token") || links) && !value.as_str().unwrap().is_empty() {
                    found.extend(Some(text(value)).filter(|token| !known.contains(token)));
                }
            }
        }
        found
    }

    #[test]
    fn every_form_of_a_clip_is_written_and_its_records_are_linked() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &clip());
        for file in [
            "index.json",
            "coco.json",
            "labels/000003_0.txt",
            "labels/000003_1.json",
            "labels_tracking/000003.txt",
            "maps/none.png",
            "waymo/lidar_box/assets_street_7_3.parquet",
        ] {
            assert!(folder.path().join(file).is_file(), "{file}");
        }
        assert_eq!(dangling(folder.path()), Vec::<String>::new());
        let annotations = table(folder.path(), "sample_annotation.json");
        assert_eq!(annotations.len(), 3);
        assert_eq!(annotations[0]["next"], annotations[1]["token"]);
        assert_eq!(annotations[2]["prev"], "");
        let tracking = folder.path().join("labels_tracking/000003.txt");
        let tracking = fs::read_to_string(tracking).unwrap();
        let starts: Vec<&str> = tracking.lines().map(|line| &line[..3]).collect();
        assert_eq!(starts, ["0 1", "1 1", "1 2"]);
    }

    #[test]
    fn a_lost_record_is_seen() {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &clip());
        let path = folder.path().join(NUSCENES_VERSION).join("ego_pose.json");
        let mut rows = table(folder.path(), "ego_pose.json");
        rows.remove(0);
        fs::write(&path, serde_json::to_string(&rows).unwrap()).unwrap();
        assert_eq!(dangling(folder.path()).len(), 1);
    }
}
