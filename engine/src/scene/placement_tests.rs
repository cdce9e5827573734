//! Thousands of placements on the analytic street, checked by code that shares nothing with the placer.

use std::f64::consts::PI;

use glam::{DQuat, DVec3};

use super::box_world::{BoxWorld, drive, street_car};
use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage, compose};
use super::histogram::Histogram;
use super::preset::PlacementPreset;
use super::recipe::{ClassShare, Recipe};
use super::recording::Recording;
use super::region_builder::RegionConfig;
use super::valid_region::{Cell, ValidRegion};
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::quality::ViewCoverage;

pub(super) const SLOPE: f64 = 0.05;

/// The street of the valid region's test, with the parked car labelled and a mover.
pub(super) struct Street {
    pub(super) world: BoxWorld,
    recording: Recording,
    region: ValidRegion,
    pub(super) library: Vec<Candidate>,
}

impl Street {
    pub(super) fn new(slope: f64) -> Self {
        let world = BoxWorld {
            slope,
            boxes: vec![
                (DVec3::new(10.0, 5.0, 0.0), DVec3::new(30.0, 5.5, 3.0)),
                (DVec3::new(22.0, -5.0, 0.0), DVec3::new(26.5, -3.0, 1.5)),
            ],
            half_width: 10.0,
            length: 90.0,
        };
        let mut recording = drive(slope, 41, 1.0);
        let above = |x: f64, y: f64| DVec3::new(x, y, slope * x + 0.75);
        let parked = street_car(&recording, "parked", above(24.25, -4.0), false);
        let mover = street_car(&recording, "mover", above(44.0, 2.0), true);
        recording.tracks = vec![parked, mover];
        let region =
            ValidRegion::build(&world.voxelised(0.25), &recording, &RegionConfig::default());
        let around: Vec<f64> = (0..24).map(|i| 15.0 * f64::from(i)).collect();
        let car = |name, azimuths: &[f64]| asset(name, ObjectClass::Car, azimuths);
        let library = vec![
            car("assets/followed", &[175.0, 180.0, 185.0]),
            car("assets/oncoming", &[-20.0, 0.0, 15.0]),
            car("assets/passed", &[100.0, 130.0, 160.0]),
            asset("assets/walker", ObjectClass::Pedestrian, &around),
            asset("assets/rider", ObjectClass::Cyclist, &[170.0, 190.0, 220.0]),
        ];
        Self {
            world,
            recording,
            region,
            library,
        }
    }

    fn stage(&self) -> Stage<'_> {
        Stage {
            source_log: "driveLogs/street",
            recording: &self.recording,
            region: &self.region,
        }
    }

    pub(super) fn compose(&self, recipe: &Recipe, index: u64) -> Composition {
        compose(&self.stage(), &self.library, recipe, 11, index).unwrap()
    }

    /// What is physically wrong with an inserted object.
    fn fault(&self, object: &PlacedObject, composition: &Composition) -> Option<&'static str> {
        if !self.is_supported(object) {
            return Some("footprint outside");
        }
        let half = object.size_m * 0.5;
        for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
            let wheel = object
                .local_from_object
                .point(DVec3::new(x, y, -1.0) * half);
            if (wheel.z - self.world.ground(wheel.x)).abs() > 0.1 {
                return Some("floating wheel");
            }
        }
        let others = composition.objects.iter();
        let mut others = others.filter(|o| o.instance_id != object.instance_id);
        let hits = |o: &PlacedObject| {
            share_a_point(object, &o.local_from_object, o.size_m)
                || share_a_point(o, &object.local_from_object, object.size_m)
        };
        if others.any(hits) {
            return Some("collision");
        }
        None
    }

    /// Every 5 cm of the footprint is free in the map, on the street and in no box of the world.
    fn is_supported(&self, object: &PlacedObject) -> bool {
        let half = object.size_m * 0.5;
        grid(half.x, 0.05).all(|x| {
            grid(half.y, 0.05).all(|y| {
                let p = object.local_from_object.point(DVec3::new(x, y, -half.z));
                let mut solids = self.world.boxes.iter();
                let solid = solids
                    .any(|(low, high)| p.x > low.x && p.x < high.x && p.y > low.y && p.y < high.y);
                let free = self.region.cell_at(p.truncate()) == Cell::Free;
                free && !solid && p.y.abs() < self.world.half_width
            })
        })
    }
}

/// Points of a half extent about 0, ends included.
pub(super) fn grid(half: f64, spacing: f64) -> impl Iterator<Item = f64> {
    let steps = (2.0 * half / spacing).ceil() as i32;
    (0..=steps).map(move |i| half * (2.0 * f64::from(i) / f64::from(steps) - 1.0))
}

/// Whether any of many points of an object lies in a box.
fn share_a_point(object: &PlacedObject, local_from_box: &Rigid, size_m: DVec3) -> bool {
    let pose = &object.local_from_object;
    let reach = object.size_m.length() + size_m.length();
    if (pose.translation_m - local_from_box.translation_m).length() > 0.5 * reach {
        return false;
    }
    let box_from_object = local_from_box.inverse() * *pose;
    let half = object.size_m * 0.5;
    grid(half.x, 0.15).any(|x| {
        grid(half.y, 0.15).any(|y| {
            grid(half.z, 0.25).any(|z| {
                let p = box_from_object.point(DVec3::new(x, y, z));
                p.abs().cmplt(size_m * 0.5).all()
            })
        })
    })
}

pub(super) fn asset(name: &str, class: ObjectClass, azimuths_deg: &[f64]) -> Candidate {
    let cameras: Vec<_> = azimuths_deg
        .iter()
        .map(|a| {
            let (sin, cos) = libm::sincos(a.to_radians());
            Rigid::new(DQuat::IDENTITY, DVec3::new(8.0 * cos, 8.0 * sin, 0.9))
        })
        .collect();
    let size_m = match class {
        ObjectClass::Pedestrian => DVec3::new(0.6, 0.6, 1.75),
        ObjectClass::Cyclist => DVec3::new(1.8, 0.6, 1.7),
        _ => DVec3::new(4.2, 1.8, 1.5),
    };
    let recorded = [(9.0, -0.5, 0.0), (16.0, 0.5, 0.05), (22.0, 3.0, 3.1)];
    Candidate {
        name: name.into(),
        class,
        size_m,
        source_log: "driveLogs/other".into(),
        source_track_id: name.into(),
        library: true,
        coverage: ViewCoverage::of_cameras(&cameras, false),
        ego_from_object: recorded
            .map(|(x, y, heading)| Rigid::from_heading(heading, DVec3::new(x, y, 0.75)))
            .to_vec(),
    }
}

pub(super) fn inserted(composition: &Composition) -> impl Iterator<Item = &PlacedObject> {
    let objects = composition.objects.iter();
    objects.filter(|o| o.origin == Origin::Inserted)
}

/// Heading against the horizontal line of sight, -pi..pi.
fn camera_relative(object: &PlacedObject, composition: &Composition) -> f64 {
    let eye = composition.local_from_camera.translation_m;
    let sight = object.local_from_object.translation_m - eye;
    let forward = object.local_from_object.direction(DVec3::X);
    let angle = forward.y.atan2(forward.x) - sight.y.atan2(sight.x);
    (angle + PI).rem_euclid(2.0 * PI) - PI
}

#[test]
fn ten_thousand_placements_are_physically_possible() {
    let street = Street::new(SLOPE);
    let mut accepted = 0;
    let mut index = 0;
    while accepted < 10_000 {
        for preset in PlacementPreset::ALL {
            let composition = street.compose(&Recipe::new(preset), index);
            for object in inserted(&composition) {
                let fault = street.fault(object, &composition);
                assert_eq!(fault, None, "{preset:?}, sample {index}: {object:?}");
                accepted += 1;
            }
        }
        index += 1;
        assert!(index < 10_000, "{accepted} accepted");
    }
}

/// The checks above on placements that nobody may accept.
#[test]
fn impossible_placements_are_noticed() {
    let street = Street::new(SLOPE);
    let mut composition = street.compose(&Recipe::new(PlacementPreset::Dense), 0);
    let good = inserted(&composition).next().unwrap().clone();
    assert_eq!(street.fault(&good, &composition), None);
    let moved = |by: DVec3| PlacedObject {
        local_from_object: Rigid::new(
            good.local_from_object.rotation,
            good.local_from_object.translation_m + by,
        ),
        ..good.clone()
    };
    let faults = |object: &PlacedObject, composition: &Composition| {
        street.fault(object, composition).unwrap_or("none")
    };
    assert_eq!(
        faults(&moved(DVec3::Z * 0.15), &composition),
        "floating wheel"
    );
    assert_eq!(
        faults(&moved(DVec3::Z * -0.15), &composition),
        "floating wheel"
    );
    let level = PlacedObject {
        local_from_object: Rigid::from_heading(0.0, good.local_from_object.translation_m),
        size_m: DVec3::new(4.5, 1.9, 1.5),
        ..good.clone()
    };
    assert_eq!(
        faults(&level, &composition),
        "floating wheel",
        "not pitched"
    );
    assert_eq!(
        faults(&moved(DVec3::Y * 30.0), &composition),
        "footprint outside"
    );
    let parked = &street.recording.tracks[0];
    let onto = parked.local_from_cuboid[0].unwrap().translation_m;
    let onto = onto - good.local_from_object.translation_m;
    assert_eq!(faults(&moved(onto), &composition), "footprint outside");
    // A second one half a metre aside.
    let twin = PlacedObject {
        instance_id: 99,
        ..moved(DVec3::new(0.5, 0.0, 0.5 * SLOPE))
    };
    composition.objects.push(twin);
    assert_eq!(faults(&good, &composition), "collision");
}

/// Shares of twelve bins of camera-relative heading over many accepted placements.
fn heading_counts(street: &Street, recipe: &Recipe, least: usize) -> [usize; 12] {
    let mut counts = [0; 12];
    let mut index = 0;
    while counts.iter().sum::<usize>() < least {
        let composition = street.compose(recipe, index);
        for object in inserted(&composition) {
            let turn = (camera_relative(object, &composition) + PI) / (2.0 * PI);
            counts[((turn * 12.0) as usize).min(11)] += 1;
        }
        index += 1;
        assert!(index < 100 * least as u64, "{counts:?}");
    }
    counts
}

/// Which bins any asset was observed from, by trying every tenth of a degree.
fn allowed_bins(library: &[Candidate], slack_rad: f64) -> [bool; 12] {
    std::array::from_fn(|bin| {
        (0..300).any(|i| {
            let heading = -180.0 + 30.0 * bin as f64 + (f64::from(i) + 0.5) * 0.1;
            let azimuth = 180.0 - heading;
            let seen = library.iter().flat_map(|a| &a.coverage.azimuths_rad);
            seen.map(|s| (azimuth - s.to_degrees() + 180.0).rem_euclid(360.0) - 180.0)
                .any(|gap| gap.abs() < slack_rad.to_degrees())
        })
    })
}

fn is_balanced(counts: &[usize; 12], allowed: &[bool; 12]) -> bool {
    let total: usize = counts.iter().sum();
    let share = total as f64 / allowed.iter().filter(|a| **a).count() as f64;
    counts.iter().zip(allowed).all(|(count, allowed)| {
        let count = *count as f64;
        match allowed {
            true => (count - share).abs() <= 0.2 * share,
            // Pitch and roll shift a heading at a bin's edge by less than a degree.
            false => count <= 0.002 * total as f64,
        }
    })
}

#[test]
fn balanced_headings_hold_their_share_in_every_bin_that_was_observed() {
    let mut street = Street::new(SLOPE);
    street.library.retain(|a| a.class == ObjectClass::Car);
    let balanced = Recipe::new(PlacementPreset::BalancedHeading);
    let allowed = allowed_bins(&street.library, balanced.coverage_slack_rad);
    let bins = allowed.iter().filter(|a| **a).count();
    assert!((5..12).contains(&bins), "{allowed:?}");
    let counts = heading_counts(&street, &balanced, 10_000);
    assert!(is_balanced(&counts, &allowed), "{counts:?} {allowed:?}");
    // The same check on traffic along the road must fail.
    let along = Recipe::new(PlacementPreset::Default);
    let counts = heading_counts(&street, &along, 2_000);
    assert!(!is_balanced(&counts, &allowed), "{counts:?}");
}

#[test]
fn distances_and_classes_follow_their_histograms() {
    let street = Street::new(SLOPE);
    let recipe = Recipe {
        distance: Some(Histogram {
            weights: vec![1.0, 0.0, 3.0],
        }),
        distance_m: [8.0, 38.0],
        class_shares: [ObjectClass::Car, ObjectClass::Pedestrian]
            .into_iter()
            .zip([1.0, 4.0])
            .map(|(class, weight)| ClassShare { class, weight })
            .collect(),
        max_objects: 1,
        ..Recipe::new(PlacementPreset::Default)
    };
    let (mut bins, mut walkers, mut total) = ([0; 3], 0, 0);
    for index in 0..1500 {
        let composition = street.compose(&recipe, index);
        let eye = composition.local_from_camera.translation_m;
        for object in inserted(&composition) {
            let distance = (object.local_from_object.translation_m - eye).length();
            bins[((distance - 8.0) / 10.0) as usize] += 1;
            walkers += u32::from(object.class == ObjectClass::Pedestrian);
            assert_ne!(object.class, ObjectClass::Cyclist);
            total += 1;
        }
    }
    assert!(total > 1300, "{total}");
    let near = f64::from(bins[0]) / f64::from(total);
    assert!((near - 0.25).abs() < 0.04 && bins[1] == 0, "{bins:?}");
    let share = f64::from(walkers) / f64::from(total);
    assert!((share - 0.8).abs() < 0.04, "{share}");
}

#[test]
fn objects_come_from_the_logs_that_are_named() {
    let mut street = Street::new(SLOPE);
    street.library[0].source_log = "driveLogs/street".into();
    street.library[1].source_log = "driveLogs/third".into();
    let logs = |recipe: &Recipe| -> Vec<String> {
        let mut logs: Vec<String> = (0..40)
            .flat_map(|i| {
                let composition = street.compose(recipe, i);
                let assets: Vec<usize> = inserted(&composition).filter_map(|o| o.asset).collect();
                assets
            })
            .map(|asset| street.library[asset].source_log.clone())
            .collect();
        logs.sort();
        logs.dedup();
        logs
    };
    let any = Recipe::new(PlacementPreset::Default);
    assert_eq!(logs(&any).len(), 3);
    let others = Recipe {
        other_logs_only: true,
        ..any.clone()
    };
    assert_eq!(logs(&others), ["driveLogs/other", "driveLogs/third"]);
    let third = Recipe {
        source_logs: vec!["driveLogs/third".into()],
        ..any
    };
    assert_eq!(logs(&third), ["driveLogs/third"]);
}

#[test]
fn the_same_asset_is_not_inserted_beside_itself() {
    let mut street = Street::new(SLOPE);
    street.library.truncate(1);
    let mut pairs = 0;
    for index in 0..60 {
        let composition = street.compose(&Recipe::new(PlacementPreset::Dense), index);
        let at: Vec<DVec3> = inserted(&composition)
            .map(|o| o.local_from_object.translation_m)
            .collect();
        for i in 0..at.len() {
            for j in 0..i {
                pairs += 1;
                assert!((at[i] - at[j]).length() >= 12.0);
            }
        }
        assert!(composition.rejections["duplicate"] > 0);
    }
    assert!(pairs > 60, "{pairs}");
}

#[test]
fn more_objects_than_the_region_holds_are_counted_not_searched_for_ever() {
    let street = Street::new(SLOPE);
    let crowd = Recipe {
        min_objects: 32,
        max_objects: 32,
        ..Recipe::new(PlacementPreset::Dense)
    };
    let composition = street.compose(&crowd, 0);
    let placed = inserted(&composition).count();
    let gave_up = composition.rejections["gave_up"] as usize;
    assert_eq!(placed + gave_up, 32);
    assert!(gave_up > 0);
    let attempts: u32 = composition.rejections.values().sum();
    assert!(attempts <= 32 * 65, "{attempts}");
}

#[test]
fn an_original_around_the_camera_is_counted_and_not_shown() {
    let mut street = Street::new(SLOPE);
    let eye = street.recording.frames[5].local_from_camera.translation_m;
    street.recording.tracks[1] = street_car(&street.recording, "mover", eye, true);
    let recipe = Recipe {
        frame_indices: vec![5],
        min_objects: 0,
        max_objects: 0,
        ..Recipe::new(PlacementPreset::Default)
    };
    let composition = street.compose(&recipe, 0);
    assert_eq!(composition.rejections["camera_inside"], 1);
    let shown = composition.objects.iter();
    assert!(
        shown
            .filter(|o| o.track_id.as_deref() == Some("mover"))
            .count()
            == 0
    );
}

#[test]
fn distributions_that_no_asset_can_follow_are_one_clear_error() {
    let street = Street::new(SLOPE);
    let fails = |recipe: Recipe, part: &str| {
        let error = compose(&street.stage(), &street.library, &recipe, 1, 1).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    };
    let plain = Recipe::new(PlacementPreset::Default);
    let mut only_left = vec![0.0; 12];
    only_left[0] = 1.0;
    fails(
        Recipe {
            objects: vec!["assets/followed".into()],
            heading: Some(Histogram { weights: only_left }),
            ..plain.clone()
        },
        "heading_histogram",
    );
    fails(
        Recipe {
            class_shares: vec![ClassShare {
                class: ObjectClass::Bus,
                weight: 1.0,
            }],
            ..plain.clone()
        },
        "bus",
    );
    fails(
        Recipe {
            source_logs: vec!["driveLogs/none".into()],
            ..plain
        },
        "source_logs",
    );
}
