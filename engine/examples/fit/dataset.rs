//! Reads scenes in the NeRF-synthetic layout: transforms_train.json, transforms_test.json and RGBA PNGs, shown over white.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::view::{PixelLabel, Split, TrainView};
use glam::{DMat3, DQuat, DVec2, DVec3};
use serde::Deserialize;

#[derive(Deserialize)]
struct Transforms {
    camera_angle_x: f64,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    transform_matrix: Vec<Vec<f64>>,
}

/// Training and test views of a scene folder.
pub(crate) struct Scene {
    pub(crate) train: Vec<TrainView>,
    pub(crate) test: Vec<TrainView>,
}

/// Reads a scene; every error names the file and, within it, the field.
pub(crate) fn read(folder: &Path) -> Result<Scene> {
    Ok(Scene {
        train: read_split(folder, "train", Split::Train)?,
        test: read_split(folder, "test", Split::HeldOut)?,
    })
}

fn read_split(folder: &Path, name: &str, split: Split) -> Result<Vec<TrainView>> {
    let path = folder.join(format!("transforms_{name}.json"));
    let at = path.display();
    let text = fs::read_to_string(&path).with_context(|| format!("{at}: cannot be read"))?;
    let transforms: Transforms =
        serde_json::from_str(&text).with_context(|| format!("{at}: not a transforms file"))?;
    let angle = transforms.camera_angle_x;
    ensure!(
        angle > 0.0 && angle < std::f64::consts::PI,
        "{at}: camera_angle_x is {angle}, not an angle between 0 and pi"
    );
    ensure!(!transforms.frames.is_empty(), "{at}: frames is empty");
    let frames = transforms.frames.iter().enumerate();
    frames
        .map(|(number, frame)| {
            let pose =
                pose(frame).with_context(|| format!("{at}: frames[{number}].transform_matrix"))?;
            let image = image_path(folder, &frame.file_path)
                .with_context(|| format!("{at}: frames[{number}].file_path"))?;
            view(&image, number as u32, angle, pose, split)
        })
        .collect()
}

/// Paths in these files leave out the extension.
fn image_path(folder: &Path, file_path: &str) -> Result<PathBuf> {
    let plain = folder.join(file_path);
    let with_extension = folder.join(format!("{file_path}.png"));
    let found = [with_extension, plain]
        .into_iter()
        .find(|path| path.is_file());
    found.with_context(|| format!("{file_path}: there is no such PNG in {}", folder.display()))
}

/// OpenGL's camera (x right, y up, z back) to OpenCV's (x right, y down, z forward).
fn pose(frame: &Frame) -> Result<Rigid> {
    let m = &frame.transform_matrix;
    let shaped = m.len() == 4 && m.iter().all(|row| row.len() == 4);
    ensure!(shaped, "not a 4 x 4 matrix");
    ensure!(
        m.iter().flatten().all(|x| x.is_finite()),
        "holds a value that is not finite"
    );
    let column = |c: usize| DVec3::new(m[0][c], m[1][c], m[2][c]);
    let rotation = DMat3::from_cols(column(0), -column(1), -column(2));
    let rotates = (rotation * rotation.transpose()).abs_diff_eq(DMat3::IDENTITY, 1e-3)
        && rotation.determinant() > 0.0;
    ensure!(rotates, "its upper left 3 x 3 block is not a rotation");
    Ok(Rigid::new(
        DQuat::from_mat3(&rotation).normalize(),
        column(3),
    ))
}

fn view(path: &Path, number: u32, angle: f64, pose: Rigid, split: Split) -> Result<TrainView> {
    let at = path.display();
    let image = image::open(path).with_context(|| format!("{at}: cannot be read as an image"))?;
    let image = image.to_rgba8();
    let (width, height) = image.dimensions();
    if width == 0 || height == 0 {
        bail!("{at}: an empty image");
    }
    let focal = 0.5 * f64::from(width) / (0.5 * angle).tan();
    let over_white = |c: u8, alpha: u8| {
        let (c, alpha) = (f32::from(c) / 255.0, f32::from(alpha) / 255.0);
        ((c * alpha + 1.0 - alpha) * 255.0).round() as u8
    };
    let pixels = image.pixels();
    let rgb = pixels.flat_map(|p| [0, 1, 2].map(|c| over_white(p[c], p[3])));
    Ok(TrainView {
        frame_index: number,
        camera: Camera {
            width,
            height,
            focal_px: DVec2::splat(focal),
            principal_px: DVec2::new(f64::from(width), f64::from(height)) / 2.0,
            distortion: Distortion::None,
        },
        local_from_camera: pose,
        rgb: rgb.collect(),
        labels: vec![PixelLabel::Foreground; (width * height) as usize],
        depth: Vec::new(),
        split,
    })
}
