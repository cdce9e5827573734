//! Depth maps from a folder beside a log, in the form of KITTI's depth data: 16-bit grey PNGs named by camera and frame.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use backlot_proto::v1;
use image::DynamicImage;
use rayon::prelude::*;

use crate::read_log::content::decode_image;
use crate::read_log::{Error, ReadLog, Result, blob_ref};

/// Metres in one unit of KITTI's depth maps.
pub const KITTI_UNIT_M: f64 = 1.0 / 256.0;

/// Where the maps are and what they hold.
#[derive(Clone, Debug)]
pub struct DepthMapInputs {
    /// Holds `CAMERA/FRAME.png`; FRAME is the frame's index, with or without leading zeros.
    pub folder: PathBuf,
    /// Metres of camera z in one unit.
    pub unit_m: f64,
    pub kind: v1::DepthMapKind,
}

/// Adds the folder's maps to the log's frames. Frames without a map and maps without a frame are counted in the log's notes.
///
/// # Errors
/// A unit that is not positive, a folder with no map of any frame, and maps that do not decode, are not 16-bit grey, have another size
/// than the camera or no known pixel, by file.
pub fn add_depth_maps(log: &mut ReadLog, inputs: &DepthMapInputs) -> Result<()> {
    if !(inputs.unit_m.is_finite() && inputs.unit_m > 0.0) {
        let what = format!("the unit of {} m is not finite and positive", inputs.unit_m);
        return Err(Error::choice(&inputs.folder, what));
    }
    let mut files = BTreeMap::new();
    for camera in &log.drive_log.cameras {
        let size = (camera.width, camera.height);
        for (index, path) in numbered_pngs(&inputs.folder.join(&camera.camera_id))? {
            files.insert((camera.camera_id.clone(), index), (path, size));
        }
    }
    let found: Vec<_> = log
        .drive_log
        .frames
        .iter()
        .enumerate()
        .filter_map(|(i, f)| Some((i, files.remove(&(f.camera_id.clone(), f.frame_index))?)))
        .collect();
    if found.is_empty() {
        return Err(Error::Missing {
            path: inputs.folder.join("CAMERA/FRAME.png"),
            hint: "no camera and frame of the log has a depth map there".to_owned(),
        });
    }
    let bare = log.drive_log.frames.len() - found.len();
    for (count, what) in [
        (bare, "images have no depth map"),
        (files.len(), "depth maps belong to no image and are ignored"),
    ] {
        if count > 0 {
            log.drive_log.notes.push(format!("{count} {what}"));
        }
    }
    let checked: Vec<(usize, PathBuf, v1::BlobRef)> = found
        .into_par_iter()
        .map(|(i, (path, size))| {
            let image = check_map(&path, size)?;
            Ok((i, path, image))
        })
        .collect::<Result<_>>()?;
    for (i, path, image) in checked {
        log.add_file(&path, &image);
        log.drive_log.frames[i].depth_map = Some(v1::DepthMap {
            image: Some(image),
            unit_m: inputs.unit_m,
            kind: inputs.kind.into(),
            weight: 0.0,
        });
    }
    Ok(())
}

fn check_map(path: &Path, size: (u32, u32)) -> Result<v1::BlobRef> {
    let content = std::fs::read(path).map_err(|e| Error::io(path, e, ""))?;
    let decoded =
        decode_image(&content, size, "the camera").map_err(|what| Error::malformed(path, what))?;
    let DynamicImage::ImageLuma16(units) = decoded else {
        let what = format!("the depth map is {:?}, not 16-bit grey", decoded.color());
        return Err(Error::malformed(path, what));
    };
    if units.as_raw().iter().all(|&unit| unit == 0) {
        return Err(Error::malformed(path, "the depth map has no known pixel"));
    }
    Ok(blob_ref(&content))
}

/// The PNGs of a folder that are named by numbers; none if it is not there.
fn numbered_pngs(folder: &Path) -> Result<BTreeMap<u32, PathBuf>> {
    let mut files = BTreeMap::new();
    if !folder.exists() {
        return Ok(files);
    }
    for entry in std::fs::read_dir(folder).map_err(|e| Error::io(folder, e, ""))? {
        let path = entry.map_err(|e| Error::io(folder, e, ""))?.path();
        let number = path
            .file_stem()
            .and_then(|stem| stem.to_str()?.parse().ok());
        if let Some(number) = number.filter(|_| path.extension().is_some_and(|e| e == "png")) {
            files.insert(number, path);
        }
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::{DepthRecording, StreetConfig, StreetWorld};

    /// A log without depth, and a folder of the depth maps of the same street.
    fn street() -> (ReadLog, tempfile::TempDir, f64) {
        let record = |depth| {
            let config = StreetConfig {
                frames: 3,
                width: 64,
                height: 48,
                travel_m: 4.0,
                supersample: 1,
                depth,
                ..StreetConfig::default()
            };
            StreetWorld::new(&config).unwrap().read_log().unwrap()
        };
        let with_maps = record(DepthRecording::Maps);
        let folder = tempfile::tempdir().unwrap();
        std::fs::create_dir(folder.path().join("front")).unwrap();
        let mut unit_m = 0.0;
        for frame in &with_maps.drive_log.frames {
            let map = frame.depth_map.as_ref().unwrap();
            let content = with_maps.read_blob(map.image.as_ref().unwrap()).unwrap();
            let name = format!("front/{:010}.png", frame.frame_index);
            std::fs::write(folder.path().join(name), content).unwrap();
            unit_m = map.unit_m;
        }
        (record(DepthRecording::None), folder, unit_m)
    }

    fn inputs(folder: &Path, unit_m: f64) -> DepthMapInputs {
        DepthMapInputs {
            folder: folder.to_owned(),
            unit_m,
            kind: v1::DepthMapKind::Monocular,
        }
    }

    #[test]
    fn maps_come_to_their_frames() {
        let (mut log, folder, unit_m) = street();
        let front = folder.path().join("front");
        std::fs::rename(front.join("0000000001.png"), front.join("7.png")).unwrap();
        add_depth_maps(&mut log, &inputs(folder.path(), unit_m)).unwrap();
        let frames = &log.drive_log.frames;
        let with_map: Vec<bool> = frames.iter().map(|f| f.depth_map.is_some()).collect();
        assert_eq!(with_map, [true, false, true]);
        let map = frames[2].depth_map.as_ref().unwrap();
        let content = log.read_blob(map.image.as_ref().unwrap()).unwrap();
        assert_eq!(
            content,
            std::fs::read(front.join("0000000002.png")).unwrap()
        );
        let notes = log.drive_log.notes.join("\n");
        assert!(notes.contains("1 images have no depth map"), "{notes}");
        assert!(notes.contains("1 depth maps belong to no image"), "{notes}");
    }

    #[test]
    fn what_cannot_be_used_is_named_by_file() {
        let grey8 = |path: &Path| image::GrayImage::new(64, 48).save(path).unwrap();
        let grey16 = |path: &Path, width: u32, unit: u16| {
            let pixels = vec![unit; 48 * width as usize];
            let map: image::ImageBuffer<image::Luma<u16>, _> =
                image::ImageBuffer::from_raw(width, 48, pixels).unwrap();
            map.save(path).unwrap();
        };
        type Break<'a> = &'a dyn Fn(&Path);
        let cases: [(&str, Break<'_>); 4] = [
            (
                "0000000000.png: the depth map is L8, not 16-bit grey",
                &grey8,
            ),
            ("the image has 32x48 pixels, the camera says 64x48", &|p| {
                grey16(p, 32, 9)
            }),
            ("0000000000.png: the depth map has no known pixel", &|p| {
                grey16(p, 64, 0)
            }),
            ("0000000000.png: the image is empty", &|p| {
                std::fs::write(p, b"").unwrap()
            }),
        ];
        for (named, break_it) in cases {
            let (mut log, folder, unit_m) = street();
            break_it(&folder.path().join("front/0000000000.png"));
            let error = add_depth_maps(&mut log, &inputs(folder.path(), unit_m)).unwrap_err();
            assert!(error.to_string().contains(named), "{error}");
        }
        let (mut log, folder, _) = street();
        let error = add_depth_maps(&mut log, &inputs(folder.path(), 0.0)).unwrap_err();
        assert!(
            error.to_string().contains("not finite and positive"),
            "{error}"
        );
        let error = add_depth_maps(&mut log, &inputs(&folder.path().join("front"), 1.0));
        assert!(
            error
                .unwrap_err()
                .to_string()
                .contains("no camera and frame")
        );
    }
}
