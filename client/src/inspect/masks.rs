//! What a decomposition makes of a frame, drawn over its image: which pixels an object is learned from, and why a track is not.

use std::io;

use backlot_engine::view::PixelLabel;
use backlot_proto::v1;
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::domain::drive_log::DriveLog;
use backlot_server::ingest::{
    FrameMasks, LogMasks, MaskMatching, MatchedMasks, ObjectMask, frame_masks, match_masks,
};
use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use crate::picture::{GLYPH_HEIGHT, draw_cuboid, draw_text};
use crate::read_log::ReadLog;

/// Colours of tracks, in turn.
const COLORS: [[u8; 3]; 6] = [
    [255, 90, 60],
    [60, 220, 90],
    [80, 150, 255],
    [255, 210, 50],
    [230, 90, 240],
    [70, 230, 230],
];
const REJECTED: Rgb<u8> = Rgb([235, 235, 235]);
const SKY: [u8; 3] = [120, 170, 255];
/// Of a tint over the image.
const TINT: f64 = 0.5;
const TEXT_SCALE: u32 = 2;
/// Room kept for a line of text at the right border.
const TEXT_PX: f64 = 200.0;

/// The log as the server decomposes it without a segmenter.
#[derive(Debug)]
pub struct MaskPictures<'a> {
    read: &'a ReadLog,
    log: DriveLog,
    masks: MatchedMasks,
}

impl<'a> MaskPictures<'a> {
    /// Matches masks that name no track, if the log brings such.
    ///
    /// # Errors
    /// A log that a server would refuse, and frames that cannot be read.
    pub fn new(read: &'a ReadLog) -> io::Result<Self> {
        let wire = v1::DriveLog {
            name: "driveLogs/inspected".to_owned(),
            ..read.drive_log.clone()
        };
        let log = drive_log_from_wire(wire).map_err(|e| unusable(format!("{e:?}")))?;
        let matching = MaskMatching::default();
        let masks = match_masks(&log, read, &LogMasks(read), &matching, |_, _| true);
        let masks = masks.map_err(|e| unusable(e.to_string()))?;
        Ok(Self {
            read,
            log,
            masks: masks.expect("nothing stops it"),
        })
    }

    /// The image of a frame: a track's object in its colour, what may be it in dots; what teaches the background nothing hatched, sky blue.
    /// Rejected tracks have a grey cuboid and the reason.
    ///
    /// # Errors
    /// A frame that is not the log's or cannot be read.
    pub fn draw(&self, frame: &v1::CameraFrame) -> io::Result<RgbImage> {
        let mut frames = self.log.frames.iter();
        let index = frames
            .position(|f| f.camera_id == frame.camera_id && f.frame_index == frame.frame_index);
        let index = index.ok_or_else(|| unusable("the frame is not of the log".to_owned()))?;
        let found = frame_masks(&self.log, self.read, &self.masks, index);
        let found = found.map_err(|e| unusable(e.to_string()))?;
        let image = frame.image.as_ref();
        let image = image.ok_or_else(|| unusable("the frame has no image".to_owned()))?;
        let image = image::load_from_memory(&self.read.read_blob(image)?);
        let mut image = image.map_err(|e| unusable(e.to_string()))?.into_rgb8();
        draw_background(&mut image, &found);
        for seen in &found.tracks {
            if let Ok(object) = &seen.found {
                draw_object(&mut image, object, color(seen.track));
            }
        }
        self.draw_cuboids(&mut image, index, &found);
        Ok(image)
    }

    fn draw_cuboids(&self, image: &mut RgbImage, index: usize, found: &FrameMasks) {
        let frame = &self.log.frames[index];
        let camera = self.log.camera(&frame.camera_id);
        let pose = self.log.world_from_camera(frame);
        let (Some(camera), Some(pose)) = (camera, pose) else {
            return;
        };
        let camera_from_world = pose.inverse();
        for seen in &found.tracks {
            let track = &self.log.tracks[seen.track];
            let Some(world_from_cuboid) = track.at(frame.timestamp_ns) else {
                continue;
            };
            let camera_from_cuboid = camera_from_world * world_from_cuboid;
            let (color, text) = match seen.found {
                Ok(_) => (color(seen.track), track.track_id.clone()),
                Err(reason) => (REJECTED, format!("{} {reason}", track.track_id)),
            };
            if seen.found == Err("outside_image") {
                continue;
            }
            draw_cuboid(
                image,
                &camera.camera,
                &camera_from_cuboid,
                track.size_m,
                color,
            );
            let top = camera_from_cuboid.point(DVec3::Z * (track.size_m.z / 2.0));
            let size = DVec2::new(image.width().into(), image.height().into());
            let height = f64::from(GLYPH_HEIGHT * TEXT_SCALE);
            let most = (size - DVec2::new(TEXT_PX, height)).max(DVec2::ZERO);
            let at = camera.camera.project(top).unwrap_or(size / 2.0);
            let at = (at - DVec2::new(0.0, height)).clamp(DVec2::ZERO, most);
            let text = text.replace('_', " ");
            draw_text(image, at.x as u32, at.y as u32, TEXT_SCALE, color, &text);
        }
    }
}

fn unusable(what: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, what)
}

fn color(track: usize) -> Rgb<u8> {
    Rgb(COLORS[track % COLORS.len()])
}

fn draw_background(image: &mut RgbImage, found: &FrameMasks) {
    for ((x, y, pixel), label) in image.enumerate_pixels_mut().zip(&found.background) {
        match label {
            PixelLabel::Unknown if (x + y) % 6 < 2 => *pixel = Rgb([0; 3]),
            PixelLabel::Sky => tint(pixel, Rgb(SKY)),
            _ => {}
        }
    }
}

fn draw_object(image: &mut RgbImage, object: &ObjectMask, color: Rgb<u8>) {
    for (i, label) in object.labels.iter().enumerate() {
        let (x, y) = (object.x + i % object.width, object.y + i / object.width);
        let pixel = image.get_pixel_mut(x as u32, y as u32);
        match label {
            PixelLabel::Foreground => tint(pixel, color),
            PixelLabel::Unknown if x % 3 == 0 && y % 3 == 0 => *pixel = color,
            _ => {}
        }
    }
}

fn tint(pixel: &mut Rgb<u8>, color: Rgb<u8>) {
    for (value, tint) in pixel.0.iter_mut().zip(color.0) {
        *value = (f64::from(*value) * (1.0 - TINT) + f64::from(tint) * TINT) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::{StreetConfig, StreetWorld};

    /// Without masks an object's tinted pixels lie in the mask that the generator draws of it, and most of it is tinted.
    #[test]
    fn objects_are_drawn_where_they_are() {
        let config = StreetConfig {
            frames: 4,
            width: 320,
            height: 192,
            travel_m: 4.0,
            supersample: 1,
            ..StreetConfig::default()
        };
        let truth = StreetWorld::new(&config).unwrap().read_log().unwrap();
        let mut log = ReadLog {
            drive_log: truth.drive_log.clone(),
            blobs: truth.blobs.clone(),
        };
        for frame in &mut log.drive_log.frames {
            frame.instance_mask = None;
        }
        let frame = &log.drive_log.frames[1];
        let pictures = MaskPictures::new(&log).unwrap();
        let found = frame_masks(&pictures.log, &log, &pictures.masks, 1).unwrap();
        let mask = truth.drive_log.frames[1].instance_mask.as_ref().unwrap();
        let mask = image::load_from_memory(&truth.read_blob(mask).unwrap());
        let mask = mask.unwrap().into_luma16();
        let plain = log.read_blob(frame.image.as_ref().unwrap()).unwrap();
        let plain = image::load_from_memory(&plain).unwrap().into_rgb8();
        let drawn = pictures.draw(frame).unwrap();
        let mut objects = 0;
        for seen in &found.tracks {
            let Ok(object) = &seen.found else { continue };
            let own = seen.track as u16 + 1;
            let (mut on, mut of, mut changed) = (0, 0, 0);
            for (i, label) in object.labels.iter().enumerate() {
                let (x, y) = (object.x + i % object.width, object.y + i / object.width);
                let (x, y) = (x as u32, y as u32);
                let is_own = mask.get_pixel(x, y).0[0] == own;
                if *label == PixelLabel::Foreground {
                    of += 1;
                    on += u32::from(is_own);
                    changed += u32::from(drawn.get_pixel(x, y) != plain.get_pixel(x, y));
                }
            }
            assert!(on * 10 > of * 8, "track {}: {on} of {of}", seen.track);
            assert!(
                changed * 10 > of * 9,
                "track {}: {changed} of {of}",
                seen.track
            );
            objects += 1;
        }
        assert!(objects > 0, "{found:?}");
    }
}
