//! Tests of generated logs against closed forms and against themselves.

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use glam::{DVec2, DVec3};

use super::{
    ActorPose, Error, ExactFrame, RenderOptions, ShadowCasters, StreetConfig, StreetWorld, View,
    psnr, warp_by_depth,
};
use crate::read_log::{BlobSource, ReadLog};

/// A log small enough for unoptimised tests.
fn small() -> StreetConfig {
    StreetConfig {
        frames: 4,
        travel_m: 6.0,
        width: 160,
        height: 96,
        supersample: 1,
        ..StreetConfig::default()
    }
}

fn blob<'a>(log: &'a ReadLog, blob: &Option<v1::BlobRef>) -> &'a [u8] {
    match &log.blobs[&blob.as_ref().unwrap().digest] {
        BlobSource::Memory(bytes) => bytes,
        other => panic!("{other:?} is not in memory"),
    }
}

fn in_pool(threads: usize, config: &StreetConfig) -> ReadLog {
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .unwrap();
    pool.install(|| StreetWorld::new(config).unwrap().read_log().unwrap())
}

/// The world point at the centre of a pixel.
fn surface_point(view: &View, frame: &ExactFrame, i: usize) -> DVec3 {
    let width = frame.width as usize;
    let direction = view.camera.direction(DVec2::new(
        (i % width) as f64 + 0.5,
        (i / width) as f64 + 0.5,
    ));
    let p_camera = direction / direction.z * f64::from(frame.depth_z_m[i]);
    view.world_from_camera.point(p_camera)
}

#[test]
fn logs_depend_on_the_seed_and_not_on_threads() {
    let config = small();
    let (one, three) = (in_pool(1, &config), in_pool(3, &config));
    assert_eq!(one.drive_log, three.drive_log);
    assert!(one.blobs.keys().eq(three.blobs.keys()));
    let other = in_pool(2, &StreetConfig { seed: 2, ..config });
    assert_ne!(
        one.drive_log.frames[0].image,
        other.drive_log.frames[0].image
    );
}

#[test]
fn instance_pixels_lie_in_their_cuboids() {
    let world = StreetWorld::new(&small()).unwrap();
    let timestamp_ns = world.frame_timestamps_ns()[1];
    let (view, frame) = (
        world.view_at(timestamp_ns),
        world.frame_at(timestamp_ns).unwrap(),
    );
    let actors = world.actors_at(timestamp_ns);
    let outside = |slack_m: f64| {
        (0..frame.instance.len())
            .filter(|&i| frame.instance[i] > 0)
            .filter(|&i| {
                let actor = &actors[usize::from(frame.instance[i]) - 1];
                let p = actor
                    .world_from_cuboid
                    .inverse()
                    .point(surface_point(&view, &frame, i));
                let half = 0.5 * world.size_m(&actor.track_id).unwrap() + DVec3::splat(slack_m);
                !p.abs().cmple(half).all()
            })
            .count()
    };
    assert!(frame.instance.iter().filter(|&&label| label > 0).count() > 200);
    assert_eq!(outside(2e-3), 0);
    assert!(outside(-0.05) > 50, "a smaller cuboid must not hold them");
}

#[test]
fn depth_of_the_road_is_that_of_a_plane() {
    let world = StreetWorld::new(&small()).unwrap();
    let timestamp_ns = world.frame_timestamps_ns()[0];
    let view = world.view_at(timestamp_ns);
    let frame = world.render(&view, &[], &RenderOptions::default()).unwrap();
    let far_from_plane = |lift_m: f64| {
        let mut far = 0;
        // The lower middle of the image shows nothing but road.
        for (x, y) in [(60, 90), (80, 95), (80, 70), (100, 80)] {
            let direction = view
                .camera
                .direction(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
            let slope = view.world_from_camera.direction(direction / direction.z).z;
            let expected = -(view.world_from_camera.translation_m.z + lift_m) / slope;
            let depth = f64::from(frame.depth_z_m[y * 160 + x]);
            far += usize::from((depth - expected).abs() > 1e-4 * expected);
        }
        far
    };
    assert_eq!(far_from_plane(0.0), 0);
    assert_eq!(far_from_plane(0.01), 4);
}

#[test]
fn lidar_points_lie_on_what_the_camera_sees() {
    let mut config = small();
    config.lidar.azimuth_step_rad *= 4.0;
    config.moving_cars = 0;
    let world = StreetWorld::new(&config).unwrap();
    let timestamp_ns = world.frame_timestamps_ns()[1];
    let view = world.view_at(timestamp_ns);
    let frame = world.frame_at(timestamp_ns).unwrap();
    let points = world.scan(timestamp_ns, 0).unwrap();
    let near_surface = |shift_m: f64| {
        let (mut near, mut total) = (0, 0);
        for point in &points {
            let time_ns = timestamp_ns + (f64::from(point.time_s) * 1e9).round() as i64;
            let p_lidar = DVec3::from(point.position_m.map(f64::from)) * (1.0 + shift_m);
            let p_world = (world.world_from_ego(time_ns) * world.ego_from_lidar()).point(p_lidar);
            let p_camera = view.world_from_camera.inverse().point(p_world);
            let Some(pixel) = view.camera.project(p_camera) else {
                continue;
            };
            if pixel.x < 0.0
                || pixel.y < 0.0
                || pixel.x >= 160.0
                || pixel.y >= 96.0
                || p_camera.z > 30.0
            {
                continue;
            }
            let depth = f64::from(frame.depth_z_m[pixel.y as usize * 160 + pixel.x as usize]);
            near += usize::from((depth - p_camera.z).abs() < 0.03 * depth);
            total += 1;
        }
        assert!(total > 500, "{total} points in the image");
        f64::from(near as u32) / f64::from(total)
    };
    // Pixels are coarse and the scanner sees behind corners that the camera does not.
    assert!(near_surface(0.0) > 0.85, "{}", near_surface(0.0));
    assert!(near_surface(0.06) < 0.4, "{}", near_surface(0.06));
}

#[test]
fn everything_has_its_own_time_inside_the_trajectory() {
    let log = in_pool(2, &small()).drive_log;
    let increasing = |times: &[i64]| times.windows(2).all(|w| w[0] < w[1]);
    let frames: Vec<i64> = log.frames.iter().map(|f| f.timestamp_ns).collect();
    let sweeps: Vec<i64> = log.sweeps.iter().map(|s| s.timestamp_ns).collect();
    let poses: Vec<i64> = log.world_from_ego.iter().map(|p| p.timestamp_ns).collect();
    assert!(increasing(&frames) && increasing(&sweeps) && increasing(&poses));
    assert!(frames.iter().all(|t| !sweeps.contains(t)));
    // A sweep's last points come 28 ms after its start.
    let (first, last) = (
        frames[0].min(sweeps[0]),
        frames[3].max(sweeps[sweeps.len() - 1] + 30_000_000),
    );
    assert!(poses[0] < first && poses[poses.len() - 1] > last);
    for track in &log.tracks {
        let states: Vec<i64> = track.states.iter().map(|s| s.timestamp_ns).collect();
        assert!(increasing(&states) && states[0] < first && states[states.len() - 1] > last);
        assert!(frames.iter().all(|t| !states.contains(t)));
    }
    assert!(log.synthetic && log.notes[0].starts_with("synthetic"));
}

#[test]
fn interpolated_poses_are_the_true_ones() {
    let world = StreetWorld::new(&small()).unwrap();
    let poses = in_pool(2, &small()).drive_log.world_from_ego;
    for timestamp_ns in world.frame_timestamps_ns() {
        let after = poses
            .partition_point(|p| p.timestamp_ns < timestamp_ns)
            .max(1);
        let [a, b] =
            [after - 1, after].map(|i| crate::geometry::rigid_from_wire(poses[i].pose.as_ref()));
        let (t0, t1) = (poses[after - 1].timestamp_ns, poses[after].timestamp_ns);
        let between = a.interpolate(&b, (timestamp_ns - t0) as f64 / (t1 - t0) as f64);
        let truth = world.world_from_ego(timestamp_ns);
        assert!(between.translation_m.distance(truth.translation_m) < 1e-4);
        assert!(between.rotation.angle_between(truth.rotation) < 1e-5);
    }
}

#[test]
fn masks_name_tracks_and_sky() {
    let config = small();
    let log = in_pool(2, &config);
    let world = StreetWorld::new(&config).unwrap();
    for frame in &log.drive_log.frames {
        let exact = world.frame_at(frame.timestamp_ns).unwrap();
        let instance = image::load_from_memory(blob(&log, &frame.instance_mask)).unwrap();
        assert_eq!(instance.as_luma16().unwrap().as_raw(), &exact.instance);
        let sky = image::load_from_memory(blob(&log, &frame.sky_mask))
            .unwrap()
            .into_luma8();
        assert!(
            sky.iter()
                .zip(&exact.depth_z_m)
                .all(|(s, d)| (*s == 255) == d.is_infinite())
        );
        assert!(
            exact
                .instance
                .iter()
                .all(|&label| usize::from(label) <= log.drive_log.tracks.len())
        );
    }
}

#[test]
fn mask_noise_moves_edges_only() {
    let clean = in_pool(2, &small());
    let noisy = in_pool(
        2,
        &StreetConfig {
            mask_edge_noise: 0.5,
            ..small()
        },
    );
    assert_eq!(
        clean.drive_log.frames[1].image,
        noisy.drive_log.frames[1].image
    );
    let mask = |log: &ReadLog| {
        let bytes = blob(log, &log.drive_log.frames[1].instance_mask);
        image::load_from_memory(bytes).unwrap().into_luma16()
    };
    let (clean, noisy) = (mask(&clean), mask(&noisy));
    let mut changed = 0;
    for (x, y, pixel) in noisy.enumerate_pixels() {
        if pixel != clean.get_pixel(x, y) {
            let around = [(0, 1), (2, 1), (1, 0), (1, 2)];
            let across = around.iter().filter_map(|(dx, dy)| {
                clean.get_pixel_checked((x + dx).wrapping_sub(1), (y + dy).wrapping_sub(1))
            });
            assert!(across.into_iter().any(|other| other == pixel));
            changed += 1;
        }
    }
    assert!(changed > 30, "{changed} pixels changed");
}

/// The view of the first frame, and a car standing free in it 9 m ahead.
fn inserted(world: &StreetWorld, y_m: f64) -> (View, ActorPose) {
    let view = world.view_at(world.frame_timestamps_ns()[0]);
    let height_m = world.size_m("parked-01").unwrap().z;
    let actor = ActorPose {
        track_id: "parked-01".to_owned(),
        world_from_cuboid: Rigid::from_heading(0.4, DVec3::new(11.0, y_m, 0.5 * height_m)),
    };
    (view, actor)
}

#[test]
fn shadows_follow_the_casters_and_self_shadow_stays() {
    let world = StreetWorld::new(&small()).unwrap();
    let (view, actor) = inserted(&world, -1.0);
    let render = |shadow_casters| {
        let options = RenderOptions {
            supersample: 1,
            shadow_casters,
        };
        world
            .render(&view, std::slice::from_ref(&actor), &options)
            .unwrap()
    };
    let (with, without) = (render(ShadowCasters::All), render(ShadowCasters::None));
    assert_eq!(with, render(ShadowCasters::Flags(vec![true])));
    assert_eq!(without, render(ShadowCasters::Flags(vec![])));
    assert_eq!(with.instance, without.instance);
    let differs = |i: usize| with.rgb8[3 * i..3 * i + 3] != without.rgb8[3 * i..3 * i + 3];
    assert!((0..160 * 96).filter(|&i| differs(i)).count() > 30);
    assert!(
        (0..160 * 96)
            .filter(|&i| with.instance[i] == 1)
            .all(|i| !differs(i))
    );
}

#[test]
fn one_track_may_stand_in_several_places() {
    let world = StreetWorld::new(&small()).unwrap();
    let (view, left) = inserted(&world, 1.6);
    let (_, right) = inserted(&world, -3.0);
    let frame = world
        .render(&view, &[left, right], &RenderOptions::default())
        .unwrap();
    let count = |label: u16| frame.instance.iter().filter(|&&l| l == label).count();
    assert!(
        count(1) > 50 && count(2) > 50,
        "{} and {} pixels",
        count(1),
        count(2)
    );
    let stranger = ActorPose {
        track_id: "nobody".to_owned(),
        world_from_cuboid: Rigid::IDENTITY,
    };
    let error = world
        .render(&view, &[stranger], &RenderOptions::default())
        .unwrap_err();
    assert!(matches!(error, Error::UnknownTrack { track_id } if track_id == "nobody"));
}

#[test]
fn warping_needs_the_right_depth() {
    let world = StreetWorld::new(&StreetConfig {
        frames: 30,
        travel_m: 60.0,
        moving_cars: 0,
        ..small()
    })
    .unwrap();
    let times = world.frame_timestamps_ns();
    let (a, b) = (world.view_at(times[4]), world.view_at(times[5]));
    let (fa, fb) = (
        world.frame_at(times[4]).unwrap(),
        world.frame_at(times[5]).unwrap(),
    );
    let counted = |i: usize| !fb.sky[i];
    let itself = psnr(&warp_by_depth((&b, &fb), (&b, &fb)), &fb.rgb8, counted);
    let warped = psnr(&warp_by_depth((&a, &fa), (&b, &fb)), &fb.rgb8, counted);
    let copied = psnr(&fa.rgb8, &fb.rgb8, counted);
    assert!(itself > 60.0, "{itself}");
    assert!(
        warped > copied + 3.0,
        "{warped} dB warped, {copied} dB copied"
    );
    let mut wrong = fb.clone();
    wrong.depth_z_m.iter_mut().for_each(|depth| *depth *= 1.3);
    let missed = psnr(&warp_by_depth((&a, &fa), (&b, &wrong)), &fb.rgb8, counted);
    assert!(
        missed < warped - 1.0,
        "{missed} dB with wrong depth, {warped} dB"
    );
}

#[test]
fn bad_configurations_name_the_field() {
    let error = StreetWorld::new(&StreetConfig {
        travel_m: f64::NAN,
        ..small()
    })
    .unwrap_err();
    assert_eq!(error.kind(), backlot_engine::ErrorKind::Invalid);
    assert!(error.to_string().contains("travel_m"), "{error}");
    assert!(
        StreetConfig {
            frames: 1,
            ..small()
        }
        .validate()
        .is_err()
    );
    assert!(small().validate().is_ok());
}
