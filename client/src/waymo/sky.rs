//! Sky masks from the labelled images of a segment.

use std::io::Cursor;
use std::path::Path;

use backlot_proto::v1;
use image::{DynamicImage, GrayImage, ImageFormat, Luma};

use super::cameras::{CAMERA, FRAME_TIME, FrameKey};
use super::table::{Row, Table};
use crate::read_log::content::{decode_image, time_of_micros};
use crate::read_log::{ReadLog, Result, SpoolWriter};

const DIVISOR: &str = "[CameraSegmentationLabelComponent].panoptic_label_divisor";
const LABEL: &str = "[CameraSegmentationLabelComponent].panoptic_label";
/// `TYPE_SKY` of camera_segmentation.proto.
const SKY: u32 = 25;

/// Adds the sky of every labelled image; some segments have labels, on every few frames. `keys` belong to the log's frames.
pub(super) fn add_masks(
    log: &mut ReadLog,
    spool: &mut SpoolWriter,
    root: &Path,
    segment: &str,
    keys: &[FrameKey],
) -> Result<()> {
    let Some(table) = Table::open(root, "camera_segmentation", segment)? else {
        return Ok(());
    };
    let mut rows = table.rows(&[FRAME_TIME, CAMERA, DIVISOR, LABEL], &[])?;
    let mut labelled = 0;
    while let Some(row) = rows.next_row()? {
        let time = time_of_micros(row.integer(FRAME_TIME)?).map_err(|e| row.bad(e))?;
        let key = (time, row.integer(CAMERA)?);
        let Some(index) = keys.iter().position(|k| *k == key) else {
            return Err(row.bad("labels an image that camera_image lacks"));
        };
        let camera_id = &log.drive_log.frames[index].camera_id;
        let camera = log
            .drive_log
            .cameras
            .iter()
            .find(|c| c.camera_id == *camera_id);
        let mask = sky_mask(&row, camera.expect("a frame has a camera"))?;
        let blob = log.add_spooled(spool, &mask).map_err(|e| row.bad(e))?;
        log.drive_log.frames[index].sky_mask = Some(blob);
        labelled += 1;
    }
    log.drive_log.notes.push(format!(
        "{labelled} images have sky masks; their instances are not those of the boxes and are left out"
    ));
    Ok(())
}

fn sky_mask(row: &Row<'_>, camera: &v1::Camera) -> Result<Vec<u8>> {
    let divisor = row.integer(DIVISOR)?;
    let divisor = u32::try_from(divisor).ok().filter(|&d| d > 0);
    let divisor = divisor.ok_or_else(|| row.bad("the panoptic label's divisor is not positive"))?;
    let size = (camera.width, camera.height);
    let label = decode_image(row.bytes(LABEL)?, size, "camera_calibration");
    let label = label.map_err(|e| row.bad(format!("panoptic label: {e}")))?;
    let DynamicImage::ImageLuma16(label) = label else {
        return Err(row.bad("the panoptic label is not a 16-bit grey image"));
    };
    let sky = |x, y| u32::from(label.get_pixel(x, y).0[0]) / divisor == SKY;
    let mask = GrayImage::from_fn(size.0, size.1, |x, y| {
        Luma([if sky(x, y) { 255 } else { 0 }])
    });
    let mut png = Cursor::new(Vec::new());
    mask.write_to(&mut png, ImageFormat::Png)
        .map_err(|e| row.bad(e))?;
    Ok(png.into_inner())
}
