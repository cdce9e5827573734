//! Tests of the generated street against closed forms and against itself.

use glam::DVec3;

use super::{StreetConfig, StreetWorld};

/// A log small enough for unoptimised tests.
fn small() -> StreetConfig {
    StreetConfig {
        frames: 6,
        width: 160,
        height: 96,
        supersample: 2,
        ..StreetConfig::default()
    }
}

#[test]
fn instance_pixels_lie_in_their_cuboids() {
    let world = StreetWorld::new(&small()).unwrap();
    let timestamp_ns = world.frame_timestamps_ns()[2];
    let (view, frame) = (
        world.view_at(timestamp_ns),
        world.frame_at(timestamp_ns).unwrap(),
    );
    let actors = world.actors_at(timestamp_ns);
    let mut seen = 0;
    for (i, &label) in frame
        .instance
        .iter()
        .enumerate()
        .filter(|(_, label)| **label > 0)
    {
        let actor = &actors[usize::from(label) - 1];
        let (x, y) = (i % 160, i / 160);
        let direction = view
            .camera
            .direction(glam::DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
        let p_camera = direction / direction.z * f64::from(frame.depth_z_m[i]);
        let p = actor
            .world_from_cuboid
            .inverse()
            .point(view.world_from_camera.point(p_camera));
        let half = 0.5 * world.size_m(&actor.track_id).unwrap() + DVec3::splat(2e-3);
        assert!(
            p.abs().cmple(half).all(),
            "{} at {p}, half size {half}",
            actor.track_id
        );
        seen += 1;
    }
    assert!(seen > 200, "only {seen} pixels show cars");
}
