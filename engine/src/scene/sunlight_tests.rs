//! Sunlight on an analytic road between two walls whose shadows are painted on it: measured, estimated, and given to placed objects.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::{DVec2, DVec3, Vec3};

use super::box_world::{camera, drive, forward_from_camera, street_car};
use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage};
use super::daylight::SunSource;
use super::frame::RenderedFrame;
use super::measured_light::measure_daylight;
use super::recording::Recording;
use super::relight::{object_lights, relight};
use super::render::{RenderOptions, Scene, render};
use super::solid_field::{solid_field, tint};
use super::tone::Tone;
use super::valid_region::{Cell, ValidRegion};
use crate::Field;
use crate::camera::Rigid;
use crate::class::ObjectClass;

const LOW: Vec3 = Vec3::new(-2.0, -12.0, -1.0);
const HIGH: Vec3 = Vec3::new(60.0, 12.0, 7.0);
/// Walls as (low, high): one along the road on its left, with a gap, and one across its right side.
const WALLS: [(Vec3, Vec3); 3] = [
    (Vec3::new(2.0, 8.0, -1.0), Vec3::new(20.0, 9.0, 5.0)),
    (Vec3::new(32.0, 8.0, -1.0), Vec3::new(46.0, 9.0, 5.0)),
    (Vec3::new(26.0, -9.0, -1.0), Vec3::new(27.0, -4.0, 4.0)),
];
const CAR: DVec3 = DVec3::new(4.0, 1.8, 1.5);
/// The sun of the walls' shadows.
const SUN: DVec3 = DVec3::new(-0.2, 0.75, 0.63);
/// Linear light in the shade over that in the sun.
const SHADE: f64 = 0.3;

fn in_wall(p: Vec3) -> bool {
    let inside = |(low, high): &(Vec3, Vec3)| p.cmpge(*low).all() && p.cmple(*high).all();
    WALLS.iter().any(inside)
}

fn in_shade(p: Vec3, sun: DVec3) -> bool {
    let along = sun.normalize().as_vec3();
    (1..200).any(|i| in_wall(p + along * (0.1 * i as f32)))
}

/// A grey road whose shaded parts are darker, if a sun is given.
fn road(sun: Option<DVec3>) -> Field {
    let mut field = solid_field(LOW, HIGH, 0.4, [0.6; 3], |p| {
        if p.z <= -0.1 || in_wall(p) { 60.0 } else { 0.0 }
    });
    // sRGB of SHADE times the linear light of 0.6.
    let dark = super::linear::scale([0.6; 3], [SHADE; 3])[0];
    let logit = |v: f32| (v / (1.0 - v)).ln();
    if let Some(sun) = sun {
        tint(&mut field, |p| {
            let shaded = p.z < 0.5 && in_shade(p.with_z(0.0), sun);
            if shaded {
                logit(dark) - logit(0.6)
            } else {
                0.0
            }
        });
    }
    field
}

fn region() -> ValidRegion {
    let mut region = ValidRegion::unseen(DVec2::new(0.0, -8.0), 0.5, 100, 31);
    region.cells.fill(Cell::Free);
    region.ground_m.fill(0.0);
    region
}

fn recording() -> Recording {
    let mut recording = drive(0.0, 31, 1.2);
    // Recorded in the sun, on the far right.
    let parked = street_car(&recording, "parked", DVec3::new(14.0, -6.0, 0.75), false);
    recording.tracks.push(parked);
    recording
}

fn degrees_between(a: DVec3, b: DVec3) -> f64 {
    a.normalize()
        .dot(b.normalize())
        .clamp(-1.0, 1.0)
        .acos()
        .to_degrees()
}

#[test]
fn the_sun_is_found_in_the_shadows_on_the_ground() {
    let (recording, region) = (recording(), region());
    let found = measure_daylight(&road(Some(SUN)), &recording, &region).expect("there are shadows");
    assert_eq!(found.source, SunSource::Estimated);
    let off = degrees_between(found.sun_direction_local, SUN);
    assert!(off < 12.0, "{off} degrees off: {found:?}");
    for share in found.sun_share {
        assert!((share - (1.0 - SHADE)).abs() < 0.1, "{share}");
    }
    // Painted for another sun, the ground tells of that one; without shadows it tells of none.
    let other = DVec3::new(0.6, 0.5, 0.6);
    let elsewhere = measure_daylight(&road(Some(other)), &recording, &region).expect("shadows");
    let off = degrees_between(elsewhere.sun_direction_local, other);
    assert!(off < 12.0, "{off} degrees off: {elsewhere:?}");
    assert_eq!(measure_daylight(&road(None), &recording, &region), None);
}

#[test]
fn a_given_sun_is_kept_and_its_strength_measured_where_shadows_show() {
    let (mut recording, region) = (recording(), region());
    recording.sun_direction_local = Some(SUN);
    let day = measure_daylight(&road(Some(SUN)), &recording, &region).expect("given");
    assert_eq!(day.source, SunSource::Log);
    assert!((day.sun_share[1] - (1.0 - SHADE)).abs() < 0.1, "{day:?}");
    let [shade, sun] = day.ground_ln_light.expect("both kinds of ground");
    assert!(((shade - sun).exp() - SHADE).abs() < 0.1);
    let plain = measure_daylight(&road(None), &recording, &region).expect("given");
    assert_eq!(plain.ground_ln_light, None);
    assert_eq!(plain.sun_share, [0.7; 3]);
}

struct Shot {
    road: Arc<Field>,
    car: Arc<Field>,
    recording: Recording,
    region: ValidRegion,
    library: Vec<Candidate>,
}

impl Shot {
    fn new(sun: DVec3) -> Self {
        let half = (CAR * 0.5).as_vec3();
        let solid = |p: Vec3| if p.abs().cmple(half).all() { 80.0 } else { 0.0 };
        let (mut recording, region) = (recording(), region());
        let road = road(Some(SUN));
        recording.sun_direction_local = Some(sun);
        recording.daylight = measure_daylight(&road, &recording, &region);
        Self {
            road: Arc::new(road),
            car: Arc::new(solid_field(-half - 0.2, half + 0.2, 0.1, [0.5; 3], solid)),
            recording,
            region,
            library: vec![Candidate {
                name: "assets/own".into(),
                class: ObjectClass::Car,
                size_m: CAR,
                source_log: "log".into(),
                source_track_id: "parked".into(),
                library: true,
                coverage: Default::default(),
                ego_from_object: Vec::new(),
            }],
        }
    }

    /// Before and after the insert at (x, y) is moved into its light.
    fn take(&self, x: f64, y: f64) -> (RenderedFrame, RenderedFrame) {
        let composition = Composition {
            frame: 0,
            camera: camera().resized(160, 96),
            local_from_camera: Rigid::new(forward_from_camera(), DVec3::new(x - 9.0, y, 2.4)),
            local_from_ego: Rigid::IDENTITY,
            objects: vec![PlacedObject {
                instance_id: 1,
                origin: Origin::Inserted,
                class: ObjectClass::Car,
                size_m: CAR,
                local_from_object: Rigid::from_heading(0.0, DVec3::new(x, y, 0.75)),
                asset: Some(0),
                track_id: None,
                beyond_coverage: false,
                velocity_mps: None,
            }],
            left_out: Vec::new(),
            rejections: BTreeMap::new(),
            insert_shadows: true,
            daylight: self.recording.light(),
        };
        let stage = Stage {
            source_log: "log",
            recording: &self.recording,
            region: &self.region,
        };
        let scene = Scene::of_composition(&self.road, &composition, |_| Some(&self.car))
            .expect("the asset is there");
        let before = render(&scene, &RenderOptions::default(), &|| false).expect("renders");
        let tones: [(u16, Tone); 0] = [];
        let lights = object_lights(&stage, &scene, &composition, &self.library, &tones);
        let mut after = before.clone();
        relight(&scene, composition.daylight.as_ref(), &lights, &mut after);
        (before, after)
    }

    /// Mean sRGB of the insert's roof and back before and after.
    fn brightness(&self, x: f64, y: f64) -> (f64, f64) {
        let (before, after) = self.take(x, y);
        let own: Vec<usize> = (0..before.instance.len())
            .filter(|i| before.instance[*i] == 1 && before.placed_alpha[*i] > 0.99)
            .collect();
        assert!(own.len() > 200, "{} pixels", own.len());
        for i in (0..before.instance.len()).filter(|i| before.placed_alpha[*i] == 0.0) {
            assert_eq!(before.rgb8[3 * i..3 * i + 3], after.rgb8[3 * i..3 * i + 3]);
        }
        let mean = |frame: &RenderedFrame| {
            let sum: f64 = own.iter().map(|i| f64::from(frame.rgb8[3 * i])).sum();
            sum / own.len() as f64
        };
        (mean(&before), mean(&after))
    }
}

#[test]
fn an_object_recorded_in_the_sun_is_dark_in_the_shade_and_as_it_was_in_the_sun() {
    let shot = Shot::new(SUN);
    // Three metres from the left wall, under it; and beside its gap.
    let (before, shaded) = shot.brightness(14.0, 5.0);
    assert!(shaded < 0.75 * before, "{before} became {shaded}");
    let (before, sunny) = shot.brightness(26.0, 5.0);
    assert!(
        (sunny / before - 1.0).abs() < 0.06,
        "{before} became {sunny}"
    );
    // With the sun on the other side the same place is not behind a wall, and the ground's paint is not believed.
    let turned = Shot::new(DVec3::new(-0.2, -0.75, 0.63));
    let (before, lit) = turned.brightness(14.0, 5.0);
    assert!(lit > 0.9 * before, "{before} became {lit}");
}

#[test]
fn without_daylight_nothing_is_relit() {
    let mut shot = Shot::new(SUN);
    shot.recording.daylight = None;
    shot.recording.sun_direction_local = None;
    let (before, after) = shot.take(14.0, 5.0);
    assert!(before == after);
}
