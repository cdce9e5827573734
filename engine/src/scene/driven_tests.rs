//! Ground that no camera saw and a mover drove over.

use glam::{DQuat, DVec2, DVec3};

use super::box_world::{BoxWorld, drive, street_car};
use super::density::DensityField;
use super::recording::{RecordedTrack, Recording};
use super::region_tests::config;
use super::valid_region::{Cell, ValidRegion};
use crate::camera::Rigid;
use crate::class::ObjectClass;

const SLOPE: f64 = 0.05;
const FRAMES: u32 = 31;

/// A cell's middle, near enough to known ground to be looked at.
const SLAB: DVec2 = DVec2::new(34.75, 0.25);

/// A street whose ground was reconstructed everywhere but here, in the ego's lane.
struct Unseen(BoxWorld);

fn is_hidden(p: DVec2) -> bool {
    (34.0..42.0).contains(&p.x) && p.y.abs() < 1.5
}

fn is_in_slab(p: DVec2) -> bool {
    (p - SLAB).abs().max_element() < 0.3
}

impl DensityField for Unseen {
    fn sigma(&self, p: DVec3) -> f64 {
        if is_hidden(p.truncate()) {
            // What nobody saw holds anything, here a slab that looks like a step.
            let above = p.z - self.0.ground(p.x);
            let is_slab = is_in_slab(p.truncate()) && (0.1..0.2).contains(&above);
            if is_slab { 3.0 } else { 0.0 }
        } else {
            self.0.sigma(p)
        }
    }

    fn hit(&self, origin: DVec3, direction: DVec3, t_max: f64) -> Option<f64> {
        self.0.hit(origin, direction, t_max)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        self.0.bounds()
    }
}

fn street() -> Unseen {
    Unseen(BoxWorld {
        slope: SLOPE,
        boxes: Vec::new(),
        half_width: 10.0,
        length: 60.0,
    })
}

/// A car that drives up the slope from known ground over what was not seen, its cuboids `off_m` above the ground.
fn lead_car(recording: &Recording, off_m: f64) -> RecordedTrack {
    let pitch = DQuat::from_rotation_y(-libm::atan(SLOPE));
    let pose = |i: u32| {
        let x = 20.0 + f64::from(i) * 18.0 / f64::from(FRAMES - 1);
        let ground = DVec3::new(x, 0.0, SLOPE * x);
        Rigid::new(pitch, ground + pitch * DVec3::Z * 0.75 + DVec3::Z * off_m)
    };
    RecordedTrack {
        local_from_cuboid: (0..FRAMES).map(|i| Some(pose(i))).collect(),
        ..street_car(recording, "lead", DVec3::ZERO, true)
    }
}

fn region(track: impl Fn(&Recording) -> Option<RecordedTrack>) -> ValidRegion {
    let mut recording = drive(SLOPE, FRAMES, 1.0);
    recording.tracks.extend(track(&recording));
    ValidRegion::build(&street(), &recording, &config())
}

/// Free cells of what was not seen, and their worst height.
fn hidden_cells(region: &ValidRegion) -> (usize, f64) {
    let hidden = region.free_cells().filter(|i| is_hidden(region.centre(*i)));
    let cells: Vec<usize> = hidden.collect();
    let off = |i: &usize| (region.ground_m[*i] - SLOPE * region.centre(*i).x).abs();
    (cells.len(), cells.iter().map(off).fold(0.0, f64::max))
}

#[test]
fn what_a_mover_drove_over_is_free_at_its_true_height() {
    // Along the edge the known ground is bridged by a cell, so both have some.
    let undriven = region(|_| None);
    let (without, _) = hidden_cells(&undriven);
    assert_eq!(undriven.cell_at(SLAB), Cell::Uneven);
    for off_m in [0.0, -0.12, 0.2] {
        let region = region(|r| Some(lead_car(r, off_m)));
        let (with, worst_m) = hidden_cells(&region);
        // The car's last place ends at 40.25 m: 6 m by 2 m of new ground, in cells of half a metre.
        assert!(with >= without + 40, "{off_m}: {with} {without}");
        assert!(worst_m < 0.02, "{off_m}: {worst_m}");
        assert_eq!(region.cell_at(DVec2::new(37.2, 0.2)), Cell::Free);
        assert_eq!(region.cell_at(SLAB), Cell::Free);
        assert_ne!(region.cell_at(DVec2::new(41.2, 0.2)), Cell::Free);
    }
}

#[test]
fn nothing_else_proves_ground() {
    let parked = |r: &Recording| RecordedTrack {
        moving: false,
        ..lead_car(r, 0.0)
    };
    let walker = |r: &Recording| RecordedTrack {
        class: ObjectClass::Pedestrian,
        ..lead_car(r, 0.0)
    };
    let floating = |r: &Recording| lead_car(r, 0.6);
    // Starts where the ground is not known either: nothing says how its cuboids lie.
    let appearing = |r: &Recording| {
        let mut car = lead_car(r, 0.0);
        car.local_from_cuboid[..27].fill(None);
        car.size_m = DVec3::new(1.0, 1.0, 1.5);
        car
    };
    let lying = |r: &Recording| {
        let mut car = lead_car(r, 0.0);
        let roll = Rigid::new(DQuat::from_rotation_x(1.3), DVec3::ZERO);
        for pose in car.local_from_cuboid.iter_mut().flatten() {
            *pose = *pose * roll;
        }
        car
    };
    let none = hidden_cells(&region(|_| None)).0;
    type Making = dyn Fn(&Recording) -> RecordedTrack;
    let tracks: [(&str, &Making); 5] = [
        ("parked", &parked),
        ("walker", &walker),
        ("floating", &floating),
        ("appearing", &appearing),
        ("lying", &lying),
    ];
    for (name, track) in tracks {
        let free = hidden_cells(&region(|r| Some(track(r)))).0;
        assert_eq!(free, none, "{name}");
    }
}

#[test]
fn a_step_beside_known_ground_is_not_driven_over() {
    // The car's last third floats: a ramp, or poses that are wrong.
    let ramp = |r: &Recording| {
        let mut car = lead_car(r, 0.0);
        for pose in car.local_from_cuboid[20..].iter_mut().flatten() {
            pose.translation_m.z += 0.4;
        }
        car.size_m.y = 4.0;
        Some(car)
    };
    let region = region(ramp);
    let beside_known = region
        .free_cells()
        .filter(|i| is_hidden(region.centre(*i)))
        .filter(|i| (region.ground_m[*i] - SLOPE * region.centre(*i).x).abs() > 0.3)
        .filter(|i| region.centre(*i).y.abs() > 1.0);
    assert_eq!(beside_known.count(), 0);
}
