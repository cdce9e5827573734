//! A nuScenes folder of noise.

use std::io::Cursor;
use std::path::Path;

use anyhow::Result;
use image::codecs::jpeg::JpegEncoder;
use rayon::prelude::*;
use serde_json::{Value, json};

/// Time between frames in microseconds: nuScenes' cameras run at 12 Hz.
const FRAME_US: u64 = 83_000;
const START_US: u64 = 1_532_402_927_000_000;
/// At which noise of nuScenes' size takes 2 MB.
const QUALITY: u8 = 80;
/// Every sixth image is a keyframe.
const KEYFRAME_STEP: u32 = 6;
/// Of the camera ahead; the others are turned about the vertical.
const EGO_FROM_CAMERA: [f64; 4] = [0.5, -0.5, 0.5, -0.5];

pub(crate) struct Size {
    pub frames: u32,
    pub cameras: u32,
    pub width: u32,
    pub height: u32,
}

/// Writes images, and tables of one scene that knows of no LiDAR and no boxes.
pub(crate) fn write(folder: &Path, size: &Size) -> Result<()> {
    for camera in 0..size.cameras {
        std::fs::create_dir_all(folder.join(format!("samples/CAM_{camera}")))?;
    }
    let images: Vec<(u32, u32)> = (0..size.cameras)
        .flat_map(|camera| (0..size.frames).map(move |frame| (camera, frame)))
        .collect();
    images.par_iter().try_for_each(|&(camera, frame)| {
        let path = folder.join(file_name(camera, frame));
        std::fs::write(path, noise(size, camera * size.frames + frame)?)?;
        anyhow::Ok(())
    })?;
    let tables = folder.join("v1.0-mini");
    std::fs::create_dir_all(&tables)?;
    for (name, rows) in tables_of(size) {
        std::fs::write(
            tables.join(format!("{name}.json")),
            serde_json::to_vec(&rows)?,
        )?;
    }
    Ok(())
}

fn file_name(camera: u32, frame: u32) -> String {
    format!("samples/CAM_{camera}/{}.jpg", time_us(frame))
}

fn time_us(frame: u32) -> u64 {
    START_US + FRAME_US * u64::from(frame)
}

/// A JPEG of random pixels, a function of `seed`.
fn noise(size: &Size, seed: u32) -> Result<Vec<u8>> {
    let mut state = u64::from(seed) + 1;
    let pixels: Vec<u8> = (0..3 * size.width * size.height)
        .map(|_| {
            // Marsaglia's xorshift.
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 32) as u8
        })
        .collect();
    let mut bytes = Cursor::new(Vec::new());
    let color = image::ExtendedColorType::Rgb8;
    JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode(
        &pixels,
        size.width,
        size.height,
        color,
    )?;
    Ok(bytes.into_inner())
}

/// 32 hexadecimal digits.
fn token(of: &str) -> String {
    blake3::hash(of.as_bytes()).to_hex()[..32].to_owned()
}

fn tables_of(size: &Size) -> Vec<(&'static str, Vec<Value>)> {
    let keyframes: Vec<u32> = (0..size.frames).step_by(KEYFRAME_STEP as usize).collect();
    let sample = |number: usize| token(&format!("sample {number}"));
    let last = keyframes.len() - 1;
    let scene = json!({"token": token("scene"), "name": "scene-0001", "description": "", "log_token": token("log"),
        "nbr_samples": keyframes.len(), "first_sample_token": sample(0), "last_sample_token": sample(last)});
    let samples = keyframes.iter().enumerate().map(|(number, &frame)| {
        json!({"token": sample(number), "timestamp": time_us(frame), "scene_token": token("scene"),
            "prev": if number > 0 { sample(number - 1) } else { String::new() },
            "next": if number < last { sample(number + 1) } else { String::new() }})
    });
    let (mut sensors, mut calibrated, mut poses, mut recordings) =
        (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for camera in 0..size.cameras {
        let name = format!("CAM_{camera}");
        sensors.push(json!({"token": token(&name), "channel": name, "modality": "camera"}));
        let focal = f64::from(size.width) * 0.8;
        let (cx, cy) = (f64::from(size.width) / 2.0, f64::from(size.height) / 2.0);
        calibrated.push(
            json!({"token": token(&format!("calibrated {camera}")), "sensor_token": token(&name),
            "translation": [1.5, 0.0, 1.5], "rotation": EGO_FROM_CAMERA,
            "camera_intrinsic": [[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]]}),
        );
        let data = |frame: u32| token(&format!("data {camera} {frame}"));
        for frame in 0..size.frames {
            let pose = token(&format!("pose {camera} {frame}"));
            poses.push(json!({"token": pose, "timestamp": time_us(frame),
                "rotation": [1.0, 0.0, 0.0, 0.0], "translation": [0.5 * f64::from(frame), 0.0, 0.0]}));
            let number = (frame / KEYFRAME_STEP) as usize;
            recordings.push(json!({"token": data(frame), "sample_token": sample(number), "ego_pose_token": pose,
                "calibrated_sensor_token": token(&format!("calibrated {camera}")), "filename": file_name(camera, frame),
                "fileformat": "jpg", "width": size.width, "height": size.height, "timestamp": time_us(frame),
                "is_key_frame": frame.is_multiple_of(KEYFRAME_STEP),
                "prev": if frame > 0 { data(frame - 1) } else { String::new() },
                "next": if frame + 1 < size.frames { data(frame + 1) } else { String::new() }}));
        }
    }
    let visibility = json!({"token": "4", "level": "v80-100", "description": ""});
    let log = json!({"token": token("log"), "logfile": "", "vehicle": "", "date_captured": "2018-07-24", "location": ""});
    vec![
        ("scene", vec![scene]),
        ("sample", samples.collect()),
        ("sensor", sensors),
        ("calibrated_sensor", calibrated),
        ("ego_pose", poses),
        ("sample_data", recordings),
        ("visibility", vec![visibility]),
        ("log", vec![log]),
        ("map", Vec::new()),
        ("category", Vec::new()),
        ("attribute", Vec::new()),
        ("instance", Vec::new()),
        ("sample_annotation", Vec::new()),
    ]
}
