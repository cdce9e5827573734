//! Finished frames on analytic fields: what is filled, what is shown as recorded, and what must not change.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};

use super::box_world::{drive, street_car};
use super::composition::{Composition, LeftOut, Origin, PlacedObject, Stage};
use super::finish::{Finished, finish};
use super::frame::RenderedFrame;
use super::random::Draws;
use super::recorded::RecordedImage;
use super::recording::Recording;
use super::render::{RenderOptions, Scene, render};
use super::solid_field::solid_field;
use super::valid_region::ValidRegion;
use crate::Field;
use crate::camera::Rigid;
use crate::class::ObjectClass;

const LEAD_M: f64 = 9.0;
const GREY: [u8; 3] = [90, 90, 90];

/// A road at z = 0 without anything on it.
fn road() -> Field {
    let (low, high) = (Vec3::new(-2.0, -12.0, -1.0), Vec3::new(60.0, 12.0, 3.0));
    solid_field(low, high, 0.4, [0.3, 0.5, 0.3], |p| {
        if p.z <= -0.1 { 60.0 } else { 0.0 }
    })
}

fn car() -> Field {
    let half = Vec3::new(2.0, 0.8, 0.6);
    solid_field(-half - 0.2, half + 0.2, 0.1, [0.8, 0.1, 0.1], |p| {
        if p.abs().cmple(half).all() { 60.0 } else { 0.0 }
    })
}

/// A drive of `frames` frames behind a car that keeps its distance, or is gone after the first.
fn recording(frames: u32, follows: bool) -> Recording {
    let mut recording = drive(0.0, frames, 0.5);
    let mut track = street_car(&recording, "lead", DVec3::ZERO, true);
    for (i, pose) in track.local_from_cuboid.iter_mut().enumerate() {
        let aside = if follows || i == 0 { 0.0 } else { 200.0 };
        let x = recording.frames[i].local_from_ego.translation_m.x + LEAD_M;
        *pose = Some(Rigid::from_heading(0.0, DVec3::new(x, aside, 0.75)));
    }
    recording.tracks.push(track);
    recording
}

struct Shot {
    composition: Composition,
    recording: Recording,
    road: Arc<Field>,
    car: Arc<Field>,
}

impl Shot {
    fn new(recording: Recording) -> Self {
        let pose = recording.frames[0].local_from_camera;
        Self {
            composition: Composition {
                frame: 0,
                camera: recording.cameras[0].camera.resized(160, 96),
                local_from_camera: pose,
                local_from_ego: recording.frames[0].local_from_ego,
                objects: Vec::new(),
                left_out: Vec::new(),
                rejections: BTreeMap::new(),
                insert_shadows: false,
                daylight: None,
            },
            recording,
            road: Arc::new(road()),
            car: Arc::new(car()),
        }
    }

    fn without_lead(mut self) -> Self {
        let track = &self.recording.tracks[0];
        let occupied = super::collision::Occupied {
            local_from_cuboid: track.local_from_cuboid[0].unwrap(),
            size_m: track.size_m,
        };
        self.composition.left_out = vec![LeftOut {
            track_id: "lead".into(),
            occupied,
            asset: None,
        }];
        self
    }

    fn with(mut self, id: u16, origin: Origin, x: f64, y: f64) -> Self {
        self.composition.objects.push(PlacedObject {
            instance_id: id,
            origin,
            class: ObjectClass::Car,
            size_m: DVec3::new(4.0, 1.6, 1.2),
            local_from_object: Rigid::from_heading(0.0, DVec3::new(x, y, 0.6)),
            asset: Some(0),
            track_id: None,
            beyond_coverage: false,
            velocity_mps: None,
        });
        self
    }

    /// Before and after finishing.
    fn take(
        &self,
        recorded: Option<&RecordedImage<'_>>,
    ) -> (RenderedFrame, RenderedFrame, Finished) {
        let region = ValidRegion::unseen(DVec2::ZERO, 0.5, 1, 1);
        let stage = Stage {
            source_log: "log",
            recording: &self.recording,
            region: &region,
        };
        let field = |i: usize| (i == 0).then_some(&self.car);
        let scene = Scene::of_composition(&self.road, &self.composition, field).unwrap();
        let before = render(&scene, &RenderOptions::default(), &|| false).unwrap();
        let mut after = before.clone();
        let finished = finish(
            &stage,
            &scene,
            &self.composition,
            recorded,
            |i| field(i).map(Arc::as_ref),
            Draws::new(7, 0, u32::MAX),
            &mut after,
        );
        (before, after, finished)
    }
}

fn pixel(frame: &RenderedFrame, i: usize) -> &[u8] {
    &frame.rgb8[3 * i..3 * i + 3]
}

#[test]
fn without_movers_finishing_changes_nothing() {
    let (before, after, finished) = Shot::new(recording(4, true)).take(None);
    assert!(before == after);
    assert_eq!(finished, Finished::default());
    let inserted = Shot::new(recording(4, true)).with(1, Origin::Inserted, 12.0, 4.0);
    let (before, after, _) = inserted.take(None);
    assert!(before == after, "shadows are not asked for");
}

#[test]
fn what_no_frame_saw_is_filled_and_ignored_and_nothing_else_changes() {
    let shot = Shot::new(recording(4, true)).without_lead();
    let (before, after, finished) = shot.take(None);
    let mask = finished
        .ignore
        .expect("the lead car always hides something");
    assert!(finished.filled_px > 200);
    let mut above_ground = 0;
    for (i, ignored) in mask.iter().enumerate() {
        if *ignored == 0 {
            assert_eq!(pixel(&before, i), pixel(&after, i));
            assert_eq!(before.depth_z_m[i], after.depth_z_m[i]);
            continue;
        }
        assert_eq!(after.instance[i], 0);
        let direction = shot.composition.camera.direction(after.pixel_centre(i));
        // The camera is 1.6 m above a level road.
        let ground_z = 1.6 / (direction.y / direction.z);
        if ground_z > 0.0 && ground_z < 30.0 {
            assert!((f64::from(after.depth_z_m[i]) / ground_z - 1.0).abs() < 0.02);
            above_ground += 1;
        }
    }
    assert!(above_ground > 100);
}

#[test]
fn what_other_frames_saw_stays_the_fields_own() {
    let mut seen = recording(8, false);
    // The lead car drives off after the first frame: everything behind it is seen by the later ones.
    seen.frames[1..]
        .iter_mut()
        .for_each(|f| f.local_from_camera = seen_pose());
    let (before, after, finished) = Shot::new(seen).without_lead().take(None);
    assert_eq!(finished.filled_px, 0);
    assert!(before.rgb8 == after.rgb8);
    let once = Shot::new(recording(1, true)).without_lead();
    assert!(
        once.take(None).2.filled_px > 0,
        "a single frame saw nothing behind"
    );
}

/// The first frame's own pose.
fn seen_pose() -> Rigid {
    drive(0.0, 1, 0.5).frames[0].local_from_camera
}

#[test]
fn a_swapped_car_has_recorded_surroundings_up_to_its_soft_edge() {
    let shot = Shot::new(recording(1, true))
        .without_lead()
        .with(1, Origin::Replaced, LEAD_M, 0.0);
    let recorded = RecordedImage {
        width: 1,
        height: 1,
        rgb8: &GREY,
        masks: None,
    };
    let (before, after, finished) = shot.take(Some(&recorded));
    let placed = (0..after.instance.len()).filter(|i| after.instance[*i] == 1);
    for i in placed.filter(|i| !after.shows_behind(*i)) {
        assert_eq!(pixel(&before, i), pixel(&after, i));
    }
    // Filled from uniformly grey surroundings, near ground is grey: nothing of the field's green is left under the car.
    let mask = finished.ignore.unwrap();
    let around = (0..mask.len())
        .filter(|i| mask[*i] == 255 && after.placed_alpha[*i] == 0.0 && after.depth_z_m[*i] < 12.0);
    let mut checked = 0;
    for i in around {
        let off = pixel(&after, i).iter().map(|v| v.abs_diff(GREY[0])).max();
        assert!(off < Some(20), "pixel {i}: {:?}", pixel(&after, i));
        checked += 1;
    }
    assert!(checked > 30, "{checked}");
    let rim = |frame: &RenderedFrame| {
        let green = |i: &usize| {
            let [r, g, _] = [0, 1, 2].map(|c| f32::from(frame.rgb8[3 * i + c]));
            (0.05..0.6).contains(&frame.placed_alpha[*i]) && g > r + 8.0
        };
        (0..mask.len()).filter(green).count()
    };
    assert!(
        rim(&after) < rim(&before),
        "{} {}",
        rim(&after),
        rim(&before)
    );
}

#[test]
fn the_order_of_objects_does_not_reach_the_finished_image() {
    let mut shot = Shot::new(recording(4, true))
        .without_lead()
        .with(1, Origin::Replaced, LEAD_M, 0.0)
        .with(2, Origin::Inserted, 14.0, 4.0);
    shot.composition.insert_shadows = true;
    let recorded = RecordedImage {
        width: 1,
        height: 1,
        rgb8: &GREY,
        masks: None,
    };
    let (plain, forward, _) = shot.take(Some(&recorded));
    shot.composition.objects.reverse();
    let (_, backward, _) = shot.take(Some(&recorded));
    assert!(forward.rgb8 == backward.rgb8);
    assert!(forward.depth_z_m == backward.depth_z_m);
    let darker = (0..plain.instance.len()).filter(|i| {
        forward.instance[*i] == 0 && pixel(&forward, *i)[1] + 10 < pixel(&plain, *i)[1]
    });
    assert!(darker.count() > 20, "the insert throws a shadow");
}
