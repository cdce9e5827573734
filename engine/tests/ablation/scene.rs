//! A car and a street small enough to trace by hand, recorded with the faults that the method is about.

use backlot_engine::camera::{Camera, Distortion, Rigid};
use backlot_engine::train::{BackgroundInput, ObjectInput};
use backlot_engine::view::{DepthReturn, PixelLabel, Split, TrainView};
use glam::{DMat3, DQuat, DVec2, DVec3};

/// Full extents of the car's cuboid; its centre is the origin and it stands on z = -0.75.
pub(crate) const SIZE: DVec3 = DVec3::new(4.4, 1.8, 1.5);
const GROUND_Z: f64 = -0.75;
/// Pixels on either side of the outline whose labels are flipped in a frame with a bad mask.
const FLIPPED_PX: i64 = 3;
/// Every fifth frame has a bad mask.
const BAD_EVERY: u32 = 5;

#[derive(Clone, Copy)]
struct Hit {
    t: f64,
    color: [f64; 3],
    on_car: bool,
}

/// Nearest of two hits.
fn nearer(a: Option<Hit>, b: Option<Hit>) -> Option<Hit> {
    match (a, b) {
        (Some(a), Some(b)) => Some(if a.t < b.t { a } else { b }),
        (a, b) => a.or(b),
    }
}

fn hit_box(origin: DVec3, direction: DVec3, low: DVec3, high: DVec3) -> Option<f64> {
    let inverse = direction.recip();
    let (a, b) = ((low - origin) * inverse, (high - origin) * inverse);
    let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
    (near < far && near > 0.0).then_some(near)
}

fn hit_sphere(origin: DVec3, direction: DVec3, centre: DVec3, radius: f64) -> Option<f64> {
    let to = origin - centre;
    let half = to.dot(direction);
    let inside = half * half - to.length_squared() + radius * radius;
    (inside > 0.0)
        .then(|| -half - inside.sqrt())
        .filter(|t| *t > 0.0)
}

/// The car, mirror-symmetric about y = 0: body, cabin and wheels.
fn car(origin: DVec3, direction: DVec3) -> Option<Hit> {
    let mut best: Option<Hit> = None;
    let mut add = |t: Option<f64>, color: &dyn Fn(DVec3) -> [f64; 3]| {
        if let Some(t) = t {
            let p = origin + direction * t;
            let (color, on_car) = (color(p), true);
            best = nearer(best, Some(Hit { t, color, on_car }));
        }
    };
    let body = |p: DVec3| {
        let stripe = (p.x * 2.0).floor().rem_euclid(2.0);
        let front = if p.x > 2.1 { 0.35 } else { 0.0 };
        [0.65 - 0.25 * stripe, 0.15 + front, 0.2 + 0.3 * (p.z + 0.55)]
    };
    let low = DVec3::new(-2.2, -0.9, -0.55);
    let high = DVec3::new(2.2, 0.9, 0.05);
    add(hit_box(origin, direction, low, high), &body);
    let cabin = |p: DVec3| {
        let glass = p.z < 0.6 && (p.x * 1.4).fract().abs() < 0.8;
        if glass {
            [0.1, 0.13, 0.2 + 0.2 * p.z]
        } else {
            [0.7, 0.2, 0.25]
        }
    };
    let low = DVec3::new(-1.3, -0.75, 0.0);
    let high = DVec3::new(0.8, 0.75, 0.75);
    add(hit_box(origin, direction, low, high), &cabin);
    for (x, y) in [(-1.35, -0.75), (-1.35, 0.75), (1.35, -0.75), (1.35, 0.75)] {
        let centre = DVec3::new(x, y, GROUND_Z + 0.34);
        let wheel = |p: DVec3| {
            let rim = (p - centre).with_y(0.0).length() < 0.18;
            if rim { [0.75; 3] } else { [0.08; 3] }
        };
        add(hit_sphere(origin, direction, centre, 0.34), &wheel);
    }
    best
}

/// Ground with a checkerboard, far walls with bright patches, a sky.
fn surroundings(origin: DVec3, direction: DVec3) -> Option<Hit> {
    let mut best = None;
    let t = (GROUND_Z - origin.z) / direction.z;
    if t > 0.0 && t < 60.0 {
        let p = origin + direction * t;
        let checker = (p.x.floor() + p.y.floor()).rem_euclid(2.0);
        let color = [0.35 + 0.2 * checker, 0.36 + 0.18 * checker, 0.33];
        let on_car = false;
        best = Some(Hit { t, color, on_car });
    }
    for side in [-1.0, 1.0] {
        let t = (side * 12.0 - origin.y) / direction.y;
        if t > 0.0 && t < 60.0 {
            let p = origin + direction * t;
            if p.z < 5.0 {
                let patch =
                    (p.x * 0.7).floor().rem_euclid(2.0) * (p.z * 0.8).floor().rem_euclid(2.0);
                let color = [0.75, 0.6 + 0.3 * patch, 0.35 + 0.5 * patch];
                let on_car = false;
                best = nearer(best, Some(Hit { t, color, on_car }));
            }
        }
    }
    best
}

/// Camera axes (x right, y down, z forward) looking from `eye` at `target`.
fn look_at(eye: DVec3, target: DVec3) -> Rigid {
    let forward = (target - eye).normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward);
    Rigid::new(DQuat::from_mat3(&rotation).normalize(), eye)
}

fn camera(width: u32, height: u32, focal_px: f64) -> Camera {
    Camera {
        width,
        height,
        focal_px: DVec2::splat(focal_px),
        principal_px: DVec2::new(f64::from(width), f64::from(height)) / 2.0,
        distortion: Distortion::None,
    }
}

/// A view without labels or depth, and what every pixel hits.
fn trace(number: u32, camera: Camera, pose: Rigid) -> (TrainView, Vec<Option<Hit>>) {
    let mut view = TrainView {
        frame_index: number,
        camera,
        local_from_camera: pose,
        rgb: Vec::new(),
        labels: Vec::new(),
        depth: Vec::new(),
        split: Split::Train,
    };
    let mut hits = Vec::new();
    for y in 0..camera.height {
        for x in 0..camera.width {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let direction = pose.direction(camera.direction(pixel));
            let eye = pose.translation_m;
            let hit = nearer(car(eye, direction), surroundings(eye, direction));
            let color = hit.map_or([0.55, 0.7, 0.9], |h| h.color);
            let bytes = color.map(|c| (c.clamp(0.0, 1.0) * 255.0).round() as u8);
            view.rgb.extend(bytes);
            hits.push(hit);
        }
    }
    (view, hits)
}

/// Every `nth` hit that `wanted` accepts, as a LiDAR would return it.
fn returns(
    view: &TrainView,
    hits: &[Option<Hit>],
    nth: usize,
    wanted: impl Fn(&Hit) -> bool,
) -> Vec<DepthReturn> {
    let width = view.camera.width as usize;
    let every = (0..hits.len()).filter(|i| (i % width + 3 * (i / width)).is_multiple_of(nth));
    every
        .filter_map(|i| Some((i, hits[i].filter(|h| wanted(h))?)))
        .map(|(i, hit)| {
            let pixel = [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
            DepthReturn::lidar(pixel, hit.t as f32)
        })
        .collect()
}

fn points(views: &[TrainView]) -> Vec<[f32; 3]> {
    let returns = views
        .iter()
        .flat_map(|view| view.depth.iter().map(move |depth| (view, depth)));
    returns
        .map(|(view, depth)| {
            let pixel = DVec2::from(depth.pixel.map(f64::from));
            let p = view.camera.direction(pixel) * f64::from(depth.range_m);
            view.local_from_camera.point(p).as_vec3().to_array()
        })
        .collect()
}

/// A view of the car from an azimuth, with true labels.
pub(crate) fn car_view(number: u32, azimuth_rad: f64, distance_m: f64) -> TrainView {
    let (sin, cos) = azimuth_rad.sin_cos();
    let eye = DVec3::new(distance_m * cos, distance_m * sin, 0.9);
    let pose = look_at(eye, DVec3::new(0.0, 0.0, -0.1));
    let (mut view, hits) = trace(number, camera(128, 64, 1.9 * 8.0 * distance_m), pose);
    view.labels = hits
        .iter()
        .map(|hit| match hit {
            Some(hit) if hit.on_car => PixelLabel::Foreground,
            _ => PixelLabel::Background,
        })
        .collect();
    view.depth = returns(&view, &hits, 9, |hit| hit.on_car);
    view
}

/// Inverts the labels near the outline, as a segmenter that misses it does.
fn flip_edges(view: &mut TrainView) {
    let (width, height) = (i64::from(view.camera.width), i64::from(view.camera.height));
    let truth = view.labels.clone();
    let at = |x: i64, y: i64| truth[(y * width + x) as usize];
    for y in 0..height {
        for x in 0..width {
            let own = at(x, y);
            let rows = (y - FLIPPED_PX).max(0)..=(y + FLIPPED_PX).min(height - 1);
            let mut near = rows.flat_map(|v| {
                let columns = (x - FLIPPED_PX).max(0)..=(x + FLIPPED_PX).min(width - 1);
                columns.map(move |u| (u, v))
            });
            if near.any(|(u, v)| at(u, v) != own) {
                view.labels[(y * width + x) as usize] = match own {
                    PixelLabel::Foreground => PixelLabel::Background,
                    _ => PixelLabel::Foreground,
                };
            }
        }
    }
}

/// `count` views from the left side only; with bad masks in every fifth frame.
pub(crate) fn one_sided(count: u32, symmetric: bool, bad_masks: bool) -> ObjectInput {
    let views: Vec<TrainView> = (0..count)
        .map(|i| {
            let share = f64::from(i) / f64::from(count - 1);
            let distance_m = 9.0 - 3.0 * (share * std::f64::consts::PI).sin();
            let mut view = car_view(i, 0.35 + 2.4 * share, distance_m);
            if bad_masks && i % BAD_EVERY == 2 {
                flip_edges(&mut view);
            }
            view
        })
        .collect();
    ObjectInput {
        lidar_points: points(&views),
        views,
        size_m: SIZE,
        symmetric,
    }
}

/// Views between those of [`one_sided`], or their mirror images' side, with true labels.
pub(crate) fn unseen(mirrored: bool) -> Vec<TrainView> {
    let side = if mirrored { -1.0 } else { 1.0 };
    (0..5)
        .map(|i| car_view(900 + i, side * (0.5 + 0.47 * f64::from(i)), 7.3))
        .collect()
}

/// A drive past the car towards the far end of the street; every fifth view held out.
pub(crate) fn drive(frames: u32) -> BackgroundInput {
    let mut views = Vec::new();
    let mut ego_path = Vec::new();
    for i in 0..frames {
        let eye = DVec3::new(-12.0 + 0.35 * f64::from(i), 3.0, 0.8);
        let pose = look_at(eye, eye + DVec3::new(10.0, -2.2, -0.8));
        let (mut view, hits) = trace(i, camera(128, 80, 105.0), pose);
        view.labels = hits
            .iter()
            .map(|hit| match hit {
                Some(_) => PixelLabel::Foreground,
                None => PixelLabel::Sky,
            })
            .collect();
        view.depth = returns(&view, &hits, 13, |_| true);
        if i % 5 == 2 {
            view.split = Split::HeldOut;
        }
        views.push(view);
        ego_path.push(eye);
    }
    let train: Vec<TrainView> = views
        .iter()
        .filter(|view| view.split == Split::Train)
        .cloned()
        .collect();
    BackgroundInput {
        lidar_points: points(&train),
        views,
        beams: Vec::new(),
        ego_path,
    }
}

/// A number in -1..1 that differs from view to view and sums to nearly nothing.
fn wobble(number: u32, phase: f64) -> f64 {
    (f64::from(number) * 2.399 + phase).sin()
}

/// Training views exposed up to a quarter brighter or darker than the held-out ones.
pub(crate) fn with_uneven_exposure(mut input: BackgroundInput) -> BackgroundInput {
    let train = input.views.iter_mut().filter(|v| v.split == Split::Train);
    for (number, view) in (0..).zip(train) {
        let gain = (0.25 * wobble(number, 0.0)).exp();
        for value in &mut view.rgb {
            *value = (f64::from(*value) * gain).round().min(255.0) as u8;
        }
    }
    input
}

/// Recorded poses off by up to 8 cm and 1.5 degrees of heading, as annotated cuboids jitter.
pub(crate) fn with_pose_jitter(mut input: ObjectInput) -> ObjectInput {
    for (number, view) in (0..).zip(&mut input.views) {
        let shift = DVec3::new(
            0.08 * wobble(number, 1.0),
            0.08 * wobble(number, 2.5),
            0.03 * wobble(number, 4.0),
        );
        let turn = Rigid::from_heading(1.5f64.to_radians() * wobble(number, 5.0), shift);
        view.local_from_camera = turn * view.local_from_camera;
    }
    input
}
