//! Placement on an analytic street with a wall and a parked car that the log labels.

use glam::{DQuat, DVec2, DVec3};

use super::box_world::{BoxWorld, drive, street_car};
use super::collision::Occupied;
use super::composition::{Candidate, Composition, Origin, Stage, compose};
use super::footprint::Footprint;
use super::preset::PlacementPreset;
use super::recipe::Recipe;
use super::recording::Recording;
use super::region_builder::RegionConfig;
use super::valid_region::{Cell, ValidRegion};
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::quality::ViewCoverage;

const SLOPE: f64 = 0.05;

struct Street {
    recording: Recording,
    region: ValidRegion,
    library: Vec<Candidate>,
}

impl Street {
    fn new() -> Self {
        let world = BoxWorld {
            slope: SLOPE,
            boxes: vec![
                (DVec3::new(10.0, 6.0, 0.0), DVec3::new(50.0, 6.5, 3.0)),
                (DVec3::new(22.0, -5.0, 0.0), DVec3::new(26.5, -3.0, 1.5)),
            ],
            half_width: 10.0,
            length: 80.0,
        };
        let mut recording = drive(SLOPE, 31, 1.0);
        let parked = street_car(&recording, "parked", DVec3::new(24.25, -4.0, 1.96), false);
        let mover = street_car(&recording, "mover", DVec3::new(38.0, 2.0, 2.65), true);
        recording.tracks = vec![parked, mover];
        let region = ValidRegion::build(&world, &recording, &RegionConfig::default());
        let library = vec![
            candidate("assets/car", "other-log", "7", &[180.0]),
            candidate("assets/van", "other-log", "8", &[150.0, 170.0, 190.0, 0.0]),
            candidate("assets/own", "log", "parked", &[180.0, 200.0]),
        ];
        Self {
            recording,
            region,
            library,
        }
    }

    fn stage(&self) -> Stage<'_> {
        Stage {
            source_log: "log",
            recording: &self.recording,
            region: &self.region,
        }
    }

    fn compose(&self, recipe: &Recipe, index: u64) -> Composition {
        compose(&self.stage(), &self.library, recipe, 7, index).unwrap()
    }
}

fn candidate(name: &str, log: &str, track: &str, azimuths_deg: &[f64]) -> Candidate {
    let cameras: Vec<_> = azimuths_deg
        .iter()
        .map(|a| {
            let (sin, cos) = libm::sincos(a.to_radians());
            Rigid::new(DQuat::IDENTITY, DVec3::new(12.0 * cos, 12.0 * sin, 1.0))
        })
        .collect();
    let recorded = [(9.0, -0.5, 0.0), (16.0, 0.5, 0.05), (22.0, 3.0, 3.1)];
    Candidate {
        name: name.into(),
        class: ObjectClass::Car,
        size_m: DVec3::new(4.2, 1.8, 1.5),
        source_log: log.into(),
        source_track_id: track.into(),
        library: true,
        coverage: ViewCoverage::of_cameras(&cameras, true),
        ego_from_object: recorded
            .map(|(x, y, heading)| Rigid::from_heading(heading, DVec3::new(x, y, 0.75)))
            .to_vec(),
    }
}

fn recipe(preset: PlacementPreset) -> Recipe {
    Recipe {
        min_objects: 2,
        max_objects: 4,
        ..Recipe::new(preset)
    }
}

fn rendered(composition: &Composition) -> impl Iterator<Item = &super::PlacedObject> {
    composition.objects.iter().filter(|o| o.asset.is_some())
}

#[test]
fn accepted_placements_stand_on_free_ground_and_touch_nothing() {
    let street = Street::new();
    let mut accepted = 0;
    for preset in [
        PlacementPreset::Default,
        PlacementPreset::Paper,
        PlacementPreset::PaperNoRt,
    ] {
        for index in 0..150 {
            let composition = street.compose(&recipe(preset), index);
            let objects = &composition.objects;
            for object in objects.iter().filter(|o| o.origin == Origin::Inserted) {
                accepted += 1;
                check_stands(&street, object.local_from_object, object.size_m);
                let others = objects
                    .iter()
                    .filter(|o| o.instance_id != object.instance_id);
                for other in others {
                    assert_eq!(object.occupied().overlap_m3(&other.occupied()), 0.0);
                }
                let ego = composition.local_from_ego.translation_m;
                assert!((object.local_from_object.translation_m - ego).length() > 4.0);
                if preset == PlacementPreset::Default {
                    assert!(!object.beyond_coverage);
                }
            }
        }
    }
    assert!(accepted > 600, "{accepted} accepted");
}

fn check_stands(street: &Street, pose: Rigid, size_m: DVec3) {
    for p in Footprint::of_cuboid(&pose, size_m).points(0.25) {
        assert_eq!(street.region.cell_at(p), Cell::Free, "at {p}");
    }
    for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
        let wheel = pose.point(DVec3::new(x, y, -1.0) * size_m * 0.5);
        let hang = wheel.z - SLOPE * wheel.x;
        assert!(hang.abs() < 0.1, "wheel {hang} m off the ground");
    }
}

#[test]
fn the_collision_check_can_fail() {
    // The same assertion as above, on a pose that nobody tested.
    let street = Street::new();
    let parked = street.recording.tracks[0].local_from_cuboid[0].unwrap();
    let on_top = Occupied {
        local_from_cuboid: parked,
        size_m: DVec3::new(4.2, 1.8, 1.5),
    };
    let original = Occupied {
        size_m: street.recording.tracks[0].size_m,
        ..on_top
    };
    assert!(on_top.overlap_m3(&original) > 1.0);
    let footprint = Footprint::of_cuboid(&parked, on_top.size_m);
    assert!(street.region.support(&footprint).is_err());
}

#[test]
fn a_sample_is_a_pure_function_of_seed_and_index() {
    let street = Street::new();
    let recipe = recipe(PlacementPreset::Default);
    let bits = |c: &Composition| -> Vec<u64> {
        let poses = rendered(c).flat_map(|o| {
            let p = o.local_from_object;
            p.translation_m
                .to_array()
                .into_iter()
                .chain(p.rotation.to_array())
        });
        poses.map(f64::to_bits).collect()
    };
    let third = street.compose(&recipe, 3);
    for index in [0, 1, 2] {
        assert_ne!(bits(&street.compose(&recipe, index)), bits(&third));
    }
    assert_eq!(street.compose(&recipe, 3), third);
    let other_seed = compose(&street.stage(), &street.library, &recipe, 8, 3).unwrap();
    assert_ne!(bits(&other_seed), bits(&third));
}

/// Fails when any step from draws to poses changes: recipes promise the same samples for ever.
#[test]
fn golden_pose_bits() {
    let street = Street::new();
    let composition = street.compose(&recipe(PlacementPreset::Default), 0);
    let hash = rendered(&composition)
        .flat_map(|o| {
            let p = o.local_from_object;
            p.translation_m
                .to_array()
                .into_iter()
                .chain(p.rotation.to_array())
        })
        .fold(0xcbf2_9ce4_8422_2325u64, |hash, x| {
            (hash ^ x.to_bits()).wrapping_mul(0x0100_0000_01b3)
        });
    assert_eq!(hash, GOLDEN, "got {hash:#018x}");
}

const GOLDEN: u64 = 0xcf5f_6a40_37d7_4f78;

#[test]
fn originals_are_labelled_replayed_replaced_or_left_out() {
    let mut street = Street::new();
    let at_frame = |preset| Recipe {
        frame_indices: vec![12],
        min_objects: 0,
        max_objects: 0,
        ..recipe(preset)
    };
    let plain = at_frame(PlacementPreset::Default);
    let origins = |c: &Composition| c.objects.iter().map(|o| o.origin).collect::<Vec<_>>();

    let unmodelled = street.compose(&plain, 0);
    assert_eq!(origins(&unmodelled), [Origin::Static, Origin::Recorded]);
    assert!(unmodelled.left_out.is_empty());

    street.library.push(Candidate {
        library: false,
        ..candidate("assets/mover", "log", "mover", &[180.0])
    });
    let replayed = street.compose(&plain, 0);
    assert_eq!(origins(&replayed), [Origin::Static, Origin::Replayed]);
    assert!(replayed.left_out.is_empty());
    let pose = street.recording.tracks[1].local_from_cuboid[12].unwrap();
    assert_eq!(replayed.objects[1].local_from_object, pose);

    let dropped = street.compose(
        &Recipe {
            drop_originals: true,
            ..plain.clone()
        },
        0,
    );
    assert_eq!(origins(&dropped), [Origin::Static]);
    assert_eq!(dropped.left_out.len(), 1);

    let swapped = street.compose(
        &Recipe {
            replace_probability: 1.0,
            ..plain
        },
        0,
    );
    assert_eq!(origins(&swapped), [Origin::Static, Origin::Replaced]);
    let object = &swapped.objects[1];
    assert_eq!(object.track_id.as_deref(), Some("mover"));
    assert_ne!(
        object.asset,
        Some(3),
        "the original does not replace itself"
    );
    let bottom = |pose: Rigid, size: DVec3| pose.point(DVec3::new(0.0, 0.0, -size.z * 0.5));
    let gap = bottom(object.local_from_object, object.size_m)
        - bottom(pose, street.recording.tracks[1].size_m);
    assert!(gap.length() < 1e-9);
}

#[test]
fn an_asset_is_never_placed_beside_its_own_original() {
    let street = Street::new();
    let only_own = Recipe {
        objects: vec!["assets/own".into()],
        ..recipe(PlacementPreset::Default)
    };
    let original = street.recording.tracks[0].local_from_cuboid[0].unwrap();
    let mut inserted = 0;
    for index in 0..40 {
        let composition = street.compose(&only_own, index);
        for object in rendered(&composition) {
            inserted += 1;
            let gap = object.local_from_object.translation_m - original.translation_m;
            assert!(gap.length() >= 12.0, "{}", gap.length());
        }
    }
    assert!(inserted > 10, "{inserted}");
}

#[test]
fn a_crowded_region_gives_up_and_counts() {
    let mut street = Street::new();
    for (cell, state) in street.region.cells.iter_mut().enumerate() {
        if cell % 3 == 0 && *state == Cell::Free {
            *state = Cell::Blocked;
        }
    }
    let composition = street.compose(&recipe(PlacementPreset::Default), 0);
    assert_eq!(rendered(&composition).count(), 0);
    let rejections = &composition.rejections;
    assert!(
        rejections["gave_up"] >= 2 && rejections["blocked"] > 50,
        "{rejections:?}"
    );
}

#[test]
fn bad_input_is_one_clear_error() {
    let street = Street::new();
    let fails = |recipe: Recipe, part: &str| {
        let error = compose(&street.stage(), &street.library, &recipe, 1, 1).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    };
    let plain = recipe(PlacementPreset::Default);
    fails(
        Recipe {
            camera_id: "rear".into(),
            ..plain.clone()
        },
        "rear",
    );
    fails(
        Recipe {
            frame_indices: vec![99],
            ..plain.clone()
        },
        "no frame",
    );
    fails(
        Recipe {
            classes: vec![ObjectClass::Tram],
            ..plain
        },
        "no library object",
    );
}

#[test]
fn paper_presets_jitter_recorded_poses() {
    let street = Street::new();
    let still = Recipe {
        objects: vec!["assets/car".into()],
        ..recipe(PlacementPreset::PaperNoRt)
    };
    for index in 0..30 {
        let composition = street.compose(&still, index);
        let inserted = composition
            .objects
            .iter()
            .filter(|o| o.origin == Origin::Inserted);
        for object in inserted {
            let ego = composition.local_from_ego.inverse() * object.local_from_object;
            let near = |p: &&Rigid| {
                (p.translation_m.truncate() - ego.translation_m.truncate()).length() < 0.1
            };
            assert!(
                street.library[0].ego_from_object.iter().any(|p| near(&p)),
                "{ego:?}"
            );
        }
    }
    let own_lane = DVec2::new(9.0, -0.5);
    let jittered = Recipe {
        objects: vec!["assets/car".into()],
        ..recipe(PlacementPreset::Paper)
    };
    let spread = (0..30)
        .flat_map(|i| {
            let c = street.compose(&jittered, i);
            let ego_from_local = c.local_from_ego.inverse();
            rendered(&c)
                .map(|o| {
                    ego_from_local
                        .point(o.local_from_object.translation_m)
                        .truncate()
                })
                .collect::<Vec<_>>()
        })
        .map(|p| (p - own_lane).length())
        .fold(0.0, f64::max);
    assert!(spread > 5.0, "{spread}");
}
