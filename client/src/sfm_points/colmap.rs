//! COLMAP's sparse model as text: points3D.txt, and images.txt for which image saw which point.

use std::collections::{BTreeMap, HashMap};
use std::path::Path;

use backlot_proto::v1;
use glam::DVec3;

use super::{Cloud, content, point, require_room, text};
use crate::read_log::{Error, Result};

/// Of a line of points3D.txt before the track: id, x, y, z, three colours, error.
const LEAST_FIELDS: usize = 8;

/// The images that saw a point, by COLMAP's ids.
type Seen = Vec<(u32, u32)>;

pub(super) fn read(path: &Path, points: &str, log: &v1::DriveLog) -> Result<Cloud> {
    let (points, seen) = read_points(path, points)?;
    let images = path.with_file_name("images.txt");
    if !images.exists() {
        return Ok(Cloud {
            points,
            ..Cloud::default()
        });
    }
    let content = content(&images)?;
    let names = read_names(&images, text(&images, &content)?)?;
    let frames = frames_of(&names, log);
    if frames.is_empty() {
        let what = "none of its images is a frame of the log: their names are CAMERA/FRAME.png with the frame's index, or FRAME.png where the log has one camera; without the file it is guessed which image saw which point";
        return Err(Error::malformed(&images, what));
    }
    let known = |(point, image): &(u32, u32)| Some((*point, *frames.get(image)?));
    let mut notes = Vec::new();
    if frames.len() < names.len() {
        let count = names.len() - frames.len();
        notes.push(format!(
            "{count} images of images.txt are no frames of the log"
        ));
    }
    Ok(Cloud {
        points,
        observations: Some(seen.iter().filter_map(known).collect()),
        notes,
    })
}

/// Points in the order of the file, and which image saw which.
fn read_points(path: &Path, text: &str) -> Result<(Vec<DVec3>, Seen)> {
    let (mut points, mut seen) = (Vec::new(), Vec::new());
    for (number, line) in (1..).zip(text.lines()) {
        if line.trim().is_empty() || line.starts_with('#') {
            continue;
        }
        let bad = |what: String| Error::at_line(path, number, what);
        let fields: Vec<&str> = line.split_whitespace().collect();
        if fields.len() < LEAST_FIELDS || !fields.len().is_multiple_of(2) {
            let what =
                "a line of points3D.txt is ID X Y Z R G B ERROR and pairs of IMAGE_ID POINT2D_IDX";
            return Err(bad(format!("{} fields; {what}", fields.len())));
        }
        let index = points.len() as u32;
        points.push(point([1, 2, 3].map(|i| fields.get(i).copied())).map_err(bad)?);
        require_room(path, points.len())?;
        for pair in fields[LEAST_FIELDS..].chunks_exact(2) {
            let image = pair[0].parse();
            let image = image.map_err(|_| bad(format!("\"{}\" is not an image's id", pair[0])))?;
            seen.push((index, image));
        }
    }
    // An image may see a point twice.
    seen.sort_unstable();
    seen.dedup();
    Ok((points, seen))
}

/// Name of each image. Of an image's two lines, the second lists its points and may be empty.
fn read_names(path: &Path, text: &str) -> Result<BTreeMap<u32, String>> {
    let mut names = BTreeMap::new();
    let mut lines = (1..)
        .zip(text.lines())
        .filter(|(_, line)| !line.starts_with('#'));
    while let Some((number, line)) = lines.next() {
        if line.trim().is_empty() {
            continue;
        }
        let bad = |what: String| Error::at_line(path, number, what);
        let fields: Vec<&str> = line.split_whitespace().collect();
        let [id, .., name] = &fields[..] else {
            return Err(bad(
                "a line with an image's id and name is wanted".to_owned()
            ));
        };
        if fields.len() < 10 {
            let what = "an image is ID QW QX QY QZ TX TY TZ CAMERA_ID NAME";
            return Err(bad(format!("{} fields; {what}", fields.len())));
        }
        let id = id
            .parse()
            .map_err(|_| bad(format!("\"{id}\" is not an image's id")))?;
        names.insert(id, (*name).to_owned());
        lines.next();
    }
    Ok(names)
}

/// The frame of the log that each image is.
fn frames_of(names: &BTreeMap<u32, String>, log: &v1::DriveLog) -> HashMap<u32, u32> {
    let frames = (0..).zip(&log.frames);
    let by_name: HashMap<(&str, u32), u32> = frames
        .map(|(index, frame)| ((frame.camera_id.as_str(), frame.frame_index), index))
        .collect();
    let frame_of = |name: &str| {
        let path = Path::new(name);
        let number = path.file_stem()?.to_str()?.parse().ok()?;
        let folder = path.parent().and_then(Path::file_name);
        let camera = match (folder, &log.cameras[..]) {
            (Some(folder), _) => folder.to_str()?,
            (None, [camera]) => &camera.camera_id,
            (None, _) => return None,
        };
        by_name.get(&(camera, number)).copied()
    };
    names
        .iter()
        .filter_map(|(&id, name)| Some((id, frame_of(name)?)))
        .collect()
}
