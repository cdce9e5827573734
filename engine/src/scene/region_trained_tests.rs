//! The valid region of a field that was trained on images of the analytic street.

use glam::{DVec2, DVec3};

use super::box_world::{BoxWorld, drive};
use super::recording::Recording;
use super::region_builder::RegionConfig;
use super::region_tests::{config, draw, expected, street};
use super::valid_region::{Cell, ValidRegion};
use crate::backend::cpu::CpuBackend;
use crate::camera::Camera;
use crate::train::{BackgroundInput, Budget, LidarBeam, NoControl, TrainPreset, train_background};
use crate::view::{DepthReturn, PixelLabel, Split, TrainView};

const SLOPE: f64 = 0.05;
const FRAMES: u32 = 31;
/// Half of the recorded size.
const WIDTH: u32 = 320;
const HEIGHT: u32 = 192;
const LIDAR_RANGE_M: f64 = 60.0;
/// One LiDAR return for this many pixels.
const LIDAR_EVERY: u32 = 7;

/// As far as images of this size resolve the ground.
fn near() -> RegionConfig {
    RegionConfig {
        ahead_m: 6.0,
        max_lateral_m: 7.5,
        view_range_m: 25.0,
        ..config()
    }
}

/// The images and returns that the recording's cameras would have taken.
fn input(world: &BoxWorld, recording: &Recording) -> BackgroundInput {
    let camera = recording.cameras[0].camera.resized(WIDTH, HEIGHT);
    let mut input = BackgroundInput::default();
    for frame in &recording.frames {
        let mut view = TrainView {
            frame_index: frame.frame_index,
            camera,
            local_from_camera: frame.local_from_camera,
            rgb: Vec::new(),
            labels: Vec::new(),
            depth: Vec::new(),
            split: Split::Train,
        };
        let eye = frame.local_from_camera.translation_m;
        for at in 0..WIDTH * HEIGHT {
            shoot(world, &camera, eye, at, &mut view, &mut input.lidar_points);
        }
        let number = input.views.len() as u32;
        input.beams.extend(turn(world, eye, number));
        input.ego_path.push(eye);
        input.views.push(view);
    }
    input
}

/// A whole turn of a scanner at the camera.
fn turn(world: &BoxWorld, eye: DVec3, view: u32) -> impl Iterator<Item = LidarBeam> {
    let directions = (0..360).flat_map(|azimuth_deg| {
        (-12..6).map(move |step| (f64::from(azimuth_deg), 2.0 * f64::from(step)))
    });
    directions.filter_map(move |(azimuth_deg, elevation_deg)| {
        let (azimuth, elevation) = (azimuth_deg.to_radians(), elevation_deg.to_radians());
        let flat = DVec2::from_angle(azimuth) * elevation.cos();
        let direction = flat.extend(elevation.sin());
        let range_m = world.trace(eye, direction, LIDAR_RANGE_M)?;
        Some(LidarBeam {
            origin_m: eye.as_vec3().to_array(),
            return_m: (eye + direction * range_m).as_vec3().to_array(),
            view,
        })
    })
}

fn shoot(
    world: &BoxWorld,
    camera: &Camera,
    eye: DVec3,
    at: u32,
    view: &mut TrainView,
    points: &mut Vec<[f32; 3]>,
) {
    let pixel = DVec2::new(f64::from(at % WIDTH), f64::from(at / WIDTH)) + 0.5;
    let direction = view
        .local_from_camera
        .direction(camera.direction(pixel))
        .normalize();
    let hit = world.trace(eye, direction, 100.0);
    let color = hit.map_or([0.55, 0.7, 0.9], |t| texture(world, eye + direction * t));
    view.rgb.extend(color.map(|c| (c * 255.0).round() as u8));
    view.labels.push(match hit {
        Some(_) => PixelLabel::Foreground,
        None => PixelLabel::Sky,
    });
    let (column, row) = (at % WIDTH, at / WIDTH);
    if let Some(t) = hit.filter(|t| *t < LIDAR_RANGE_M && (column + 3 * row) % LIDAR_EVERY == 0) {
        view.depth
            .push(DepthReturn::lidar(pixel.as_vec2().to_array(), t as f32));
        points.push((eye + direction * t).as_vec3().to_array());
    }
}

/// Patches of a few sizes, grey on the ground and coloured above it.
fn texture(world: &BoxWorld, p: DVec3) -> [f64; 3] {
    let above = p.z - world.ground(p.x);
    let patch = |size: f64| {
        let cell = (p.with_z(above + 0.01) / size).floor();
        let mixed = cell.x * 12.9898 + cell.y * 78.233 + cell.z * 37.719;
        (mixed.sin() * 43_758.545).rem_euclid(1.0)
    };
    let light = 0.25 + 0.25 * patch(1.7) + 0.2 * patch(0.6);
    match above < 0.02 {
        true => [light, light, 0.95 * light],
        false => [0.3 + 0.6 * light, light, 0.4 + 0.3 * patch(0.9)],
    }
}

fn trained_region(steps: u64) -> (ValidRegion, BoxWorld) {
    let (world, recording) = (street(), drive(SLOPE, FRAMES, 1.0));
    let preset = TrainPreset {
        steps,
        ..TrainPreset::background(Budget::Quick)
    };
    let input = input(&world, &recording);
    let trained = train_background(&input, &preset, 1, &CpuBackend, &NoControl).unwrap();
    let region = ValidRegion::build(&trained.field, &recording, &near());
    (region, world)
}

/// Cells that are more than a cell away from any change in the expected map, and still differ from it.
fn far_from_expected(region: &ValidRegion, expected: &[Cell]) -> Vec<usize> {
    let is_free = |cells: &[Cell], at: usize| cells[at] == Cell::Free;
    let (columns, rows) = (region.columns as i64, region.rows as i64);
    (0..expected.len())
        .filter(|at| {
            let (column, row) = (*at as i64 % columns, *at as i64 / columns);
            let around = (-1..=1i64).flat_map(|y| (-1..=1i64).map(move |x| (x, y)));
            let mut known = around
                .map(|(x, y)| (column + x, row + y))
                .filter(|(x, y)| (0..columns).contains(x) && (0..rows).contains(y))
                .map(|(x, y)| (y * columns + x) as usize);
            known.all(|near| is_free(expected, near) == is_free(expected, *at))
                && is_free(&region.cells, *at) != is_free(expected, *at)
        })
        .collect()
}

/// Wherever the map can be told from its surroundings by more than a cell, nothing is free that must not be, and nothing is missed.
#[test]
fn a_trained_street_has_the_expected_map_within_one_cell() {
    let (region, world) = trained_region(900);
    let expected = expected(&world, &world, &region, &near());
    let off = far_from_expected(&region, &expected);
    let (freed, missed): (Vec<usize>, Vec<usize>) =
        off.iter().partition(|at| region.cells[**at] == Cell::Free);
    let free = region.free_cells().count();
    println!(
        "{} freed and {} missed of {free}",
        freed.len(),
        missed.len()
    );
    assert!(
        freed.is_empty() && missed.is_empty(),
        "{} cells freed, {} missed\n{}\n{}",
        freed.len(),
        missed.len(),
        draw(&region, &region.cells),
        draw(&region, &expected)
    );
    for cell in region.free_cells() {
        let off = region.ground_m[cell] - world.ground(region.centre(cell).x);
        assert!(off.abs() < 0.1, "ground {off} m off");
    }
}

/// The comparison must notice a map that is moved by more than a cell.
#[test]
fn a_shifted_map_is_not_within_one_cell() {
    let (world, recording) = (street(), drive(SLOPE, FRAMES, 1.0));
    let region = ValidRegion::build(&world, &recording, &near());
    let truth = expected(&world, &world, &region, &near());
    assert!(far_from_expected(&region, &truth).is_empty());
    let moved = |columns: usize| -> Vec<Cell> {
        let count = truth.len();
        (0..count).map(|i| truth[(i + columns) % count]).collect()
    };
    let shifted = |columns: usize| far_from_expected(&region, &moved(columns)).len();
    assert_eq!(shifted(1), 0);
    assert!(shifted(3) > 5, "{}", shifted(3));
    let unseen_is_free = RegionConfig {
        min_views: 0,
        ..near()
    };
    let careless = ValidRegion::build(&world, &recording, &unseen_is_free);
    assert!(far_from_expected(&careless, &truth).len() > 5);
}
