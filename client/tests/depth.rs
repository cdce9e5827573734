//! Backgrounds trained without LiDAR: depth maps and points of structure from motion must do what LiDAR does, and wrong ones must not
//! pass. Logs go through the wire form, validation and decomposition as an upload and its job do.

use std::io;

use backlot_client::generator::{DepthRecording, StreetConfig, StreetWorld};
use backlot_client::read_log::ReadLog;
use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::field::{Field, Ray};
use backlot_engine::quality::render_rays;
use backlot_engine::train::{Budget, NoControl, RayMix, TrainPreset, train_background};
use backlot_engine::view::{PixelLabel, Split, TrainView};
use backlot_proto::v1;
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::ingest::{BackgroundSet, LogLabels, background_set, validate};
use image::{DynamicImage, ImageBuffer, ImageFormat, Luma};

/// Depth is compared up to here, over the best share of the pixels, as quality reports do.
const RANGE_M: f64 = 50.0;
const SHARE: f64 = 0.95;

/// A short drive with a wide lens, where depth along the axis and distance differ by half at the border.
fn street(depth: DepthRecording) -> StreetWorld {
    let config = StreetConfig {
        seed: 5,
        frames: 12,
        width: 160,
        height: 96,
        travel_m: 18.0,
        horizontal_fov_rad: 1.7,
        supersample: 1,
        depth,
        ..StreetConfig::default()
    };
    StreetWorld::new(&config).expect("the configuration is valid")
}

/// Decomposes a log as its job would.
fn decomposed(log: ReadLog) -> BackgroundSet {
    let wire = v1::DriveLog {
        name: "driveLogs/street".to_owned(),
        ..log.drive_log.clone()
    };
    let drive_log = drive_log_from_wire(wire).expect("the log converts");
    let accepted = validate(&drive_log, &log).expect("blobs are in memory");
    accepted.expect("the log is valid");
    let set = background_set(
        &drive_log,
        &log,
        &LogLabels::default(),
        4,
        u32::MAX,
        |_, _| true,
    );
    set.expect("frames load").expect("nothing stops it")
}

/// Trains a small background and measures its distances on held-out frames against the exact ones, in metres.
fn depth_error_m(world: &StreetWorld, log: ReadLog) -> f64 {
    let input = decomposed(log).input;
    let preset = small(TrainPreset::background(Budget::Quick));
    let trained = train_background(&input, &preset, 1, &CpuBackend, &NoControl);
    let field = trained.expect("the field trains").field;
    let held_out = input.views.iter().filter(|v| v.split == Split::HeldOut);
    let mut errors: Vec<f64> = held_out
        .flat_map(|view| view_errors_m(world, &field, view))
        .collect();
    assert!(errors.len() > 5_000, "{} pixels", errors.len());
    errors.sort_by(f64::total_cmp);
    errors.truncate((errors.len() as f64 * SHARE) as usize);
    errors.iter().sum::<f64>() / errors.len() as f64
}

/// Coarse voxels and few rays: seconds of training, in which depth already differs.
fn small(preset: TrainPreset) -> TrainPreset {
    TrainPreset {
        voxels_m: vec![1.6, 0.4],
        level_reach_m: vec![f32::INFINITY; 2],
        box_reach_m: 60.0,
        steps: 250,
        most_passes: f64::INFINITY,
        mix: RayMix {
            pixel_rays: 1_024,
            depth_rays: 256,
            ..preset.mix
        },
        ..preset
    }
}

fn view_errors_m(world: &StreetWorld, field: &Field, view: &TrainView) -> Vec<f64> {
    let timestamp_ns = world.frame_timestamps_ns()[view.frame_index as usize];
    let exact = world.frame_at(timestamp_ns).expect("the street renders");
    let compared: Vec<(Ray, f64)> = (0..view.camera.pixel_count())
        .filter(|&at| view.labels[at] == PixelLabel::Foreground)
        .map(|at| {
            let direction = view.camera.direction(view.camera.pixel_centre(at));
            let range_m = f64::from(exact.depth_z_m[at]) / direction.z;
            (view.pixel_ray(at), range_m)
        })
        .filter(|(_, range_m)| *range_m < RANGE_M)
        .collect();
    let rays: Vec<Ray> = compared.iter().map(|(ray, _)| *ray).collect();
    let rendered = render_rays(field, &rays);
    rendered
        .iter()
        .zip(compared)
        .map(|(rendered, (_, range_m))| (f64::from(rendered.range_m) - range_m).abs())
        .collect()
}

/// Replaces every depth map's units by `change` of the pixel and its unit, and its unit in metres by `factor` of it.
fn change_maps(log: &mut ReadLog, factor: f64, change: impl Fn(u32, u32, f64) -> f64) {
    for i in 0..log.drive_log.frames.len() {
        let map = log.drive_log.frames[i].depth_map.clone();
        let mut map = map.expect("every frame has a map");
        let content = log.read_blob(map.image.as_ref().expect("a map has an image"));
        let units = image::load_from_memory(&content.expect("the blob is in memory"))
            .expect("the map decodes")
            .into_luma16();
        let changed: ImageBuffer<Luma<u16>, Vec<u16>> =
            ImageBuffer::from_fn(units.width(), units.height(), |x, y| {
                let unit = f64::from(units.get_pixel(x, y).0[0]);
                Luma([change(x, y, unit) as u16])
            });
        let mut bytes = io::Cursor::new(Vec::new());
        DynamicImage::from(changed)
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("a PNG is written to memory");
        map.image = Some(log.add_bytes(bytes.into_inner()));
        map.unit_m *= factor;
        log.drive_log.frames[i].depth_map = Some(map);
    }
}

fn recorded(depth: DepthRecording) -> (StreetWorld, ReadLog) {
    let world = street(depth);
    let log = world.read_log().expect("the street can be recorded");
    (world, log)
}

#[test]
fn maps_and_points_give_depth_and_wrong_maps_do_not() {
    let error_of = |depth| {
        let (world, log) = recorded(depth);
        depth_error_m(&world, log)
    };
    let none = error_of(DepthRecording::None);
    let maps = error_of(DepthRecording::Maps);
    let points = error_of(DepthRecording::Points);
    let lidar = error_of(DepthRecording::Lidar);
    let (world, mut log) = recorded(DepthRecording::Maps);
    change_maps(&mut log, 1.3, |_, _, unit| unit);
    let rescaled = depth_error_m(&world, log);
    let (world, mut log) = recorded(DepthRecording::Maps);
    let camera = world.camera();
    // Distances along the rays, halved so that they fit, in a map that is read as depth along the axis.
    change_maps(&mut log, 2.0, |x, y, unit| {
        let pixel = glam::DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
        unit / camera.direction(pixel).z / 2.0
    });
    let ranges = depth_error_m(&world, log);
    let figures = format!(
        "depth error: none {none:.2} m, maps {maps:.2}, points {points:.2}, lidar {lidar:.2}, rescaled maps {rescaled:.2}, ranges for depths {ranges:.2}"
    );
    eprintln!("{figures}");
    let most = 0.6 * none;
    assert!(maps < most && points < most, "{figures}");
    assert!(rescaled > 2.0 * maps && ranges > 1.5 * maps, "{figures}");
}

#[test]
fn the_report_says_where_depth_comes_from() {
    for (depth, said) in [
        (DepthRecording::Lidar, None),
        (DepthRecording::Maps, Some("the log's depth maps")),
        (DepthRecording::Points, Some("the log's SfM points")),
        (DepthRecording::None, Some("trained without depth")),
    ] {
        let warning = decomposed(recorded(depth).1).depth_warning;
        let as_said = match (&warning, said) {
            (Some(warning), Some(said)) => warning.contains(said),
            (None, None) => true,
            _ => false,
        };
        assert!(as_said, "{depth:?}: {warning:?}");
    }
}
