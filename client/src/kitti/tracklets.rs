//! `tracklet_labels.xml` of KITTI raw drives.

use std::collections::BTreeMap;
use std::path::Path;

use backlot_engine::camera::Rigid;
use backlot_proto::v1::Occlusion;
use glam::{DQuat, DVec3};
use roxmltree::{Document, Node};

use super::boxes::{LabelledBox, LabelledTrack};
use super::text;
use crate::read_log::{Error, Result};

/// Reads every tracklet. Poses are bottom centres in the Velodyne frame with a heading about its z axis.
pub(super) fn read(path: &Path) -> Result<Vec<LabelledTrack>> {
    let content = text::read(path, "--tracks names a tracklet_labels.xml")?;
    let options = roxmltree::ParsingOptions {
        // The files of the data set open with `<!DOCTYPE boost_serialization>`.
        allow_dtd: true,
        ..Default::default()
    };
    let document = Document::parse_with_options(&content, options)
        .map_err(|e| Error::malformed(path, format!("not XML: {e}")))?;
    let tracklets = document
        .descendants()
        .find(|node| node.has_tag_name("tracklets"))
        .ok_or_else(|| Error::malformed(path, "no <tracklets> element"))?;
    items(tracklets)
        .enumerate()
        .map(|(i, item)| read_tracklet(&Element { path, node: item }, i))
        .collect()
}

fn items<'a>(node: Node<'a, 'a>) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children().filter(|child| child.has_tag_name("item"))
}

fn read_tracklet(item: &Element<'_>, index: usize) -> Result<LabelledTrack> {
    let size_m = DVec3::new(item.number("l")?, item.number("w")?, item.number("h")?);
    if size_m.min_element() <= 0.0 {
        return Err(item.error("h, w and l must be positive"));
    }
    let first_frame = item.number("first_frame")?;
    if !(0.0..1e9).contains(&first_frame) {
        return Err(item.error("first_frame is out of range"));
    }
    let poses = item.child("poses")?;
    let mut boxes = BTreeMap::new();
    for (i, pose) in items(poses.node).enumerate() {
        let pose = Element {
            path: item.path,
            node: pose,
        };
        boxes.insert(first_frame as u32 + i as u32, read_pose(&pose, size_m.z)?);
    }
    Ok(LabelledTrack {
        track_id: index.to_string(),
        source_class: item.text("objectType")?.to_owned(),
        size_m,
        boxes,
    })
}

fn read_pose(pose: &Element<'_>, height_m: f64) -> Result<LabelledBox> {
    let bottom = DVec3::new(pose.number("tx")?, pose.number("ty")?, pose.number("tz")?);
    // rx and ry are zero in the data set; the development kit rotates by rz alone.
    let rotation = DQuat::from_rotation_z(pose.number("rz")?);
    Ok(LabelledBox {
        velodyne_from_cuboid: Rigid::new(rotation, bottom + DVec3::Z * (height_m / 2.0)),
        occlusion: match pose.number("occlusion")? as i64 {
            0 => Occlusion::None,
            1 => Occlusion::Partly,
            2 => Occlusion::Largely,
            _ => Occlusion::Unspecified,
        },
        truncation: if pose.number("truncation")? == 0.0 {
            0.0
        } else {
            -1.0
        },
    })
}

/// An element and the file it is in, for messages.
struct Element<'a> {
    path: &'a Path,
    node: Node<'a, 'a>,
}

impl<'a> Element<'a> {
    fn error(&self, what: impl Into<String>) -> Error {
        let line = self
            .node
            .document()
            .text_pos_at(self.node.range().start)
            .row;
        Error::at_line(self.path, line as usize, what)
    }

    fn child(&self, tag: &str) -> Result<Element<'a>> {
        let node = self
            .node
            .children()
            .find(|child| child.has_tag_name(tag))
            .ok_or_else(|| self.error(format!("no <{tag}> in this element")))?;
        Ok(Element {
            path: self.path,
            node,
        })
    }

    fn text(&self, tag: &str) -> Result<&'a str> {
        let child = self.child(tag)?;
        let text = child.node.text().map(str::trim).unwrap_or_default();
        Ok(text)
    }

    fn number(&self, tag: &str) -> Result<f64> {
        let child = self.child(tag)?;
        let text = child.node.text().map(str::trim).unwrap_or_default();
        let value: f64 = text
            .parse()
            .map_err(|_| child.error(format!("<{tag}> is {text:?}, not a number")))?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(child.error(format!("<{tag}> is {text}; it must be finite")))
        }
    }
}
