//! Clips, moved and removed actors on an analytic street: nothing touches at any time, ids and poses agree from frame to frame.

use std::collections::BTreeMap;

use glam::{DQuat, DVec2, DVec3};

use super::box_world::{BoxWorld, drive, street_car};
use super::clip::compose_clip;
use super::collision::Occupied;
use super::composition::{Candidate, Composition, Origin, PlacedObject, Stage, compose};
use super::edit::{ActorEdit, Edit, GivenObject, Shift};
use super::originals::pose_at;
use super::preset::PlacementPreset;
use super::recipe::Recipe;
use super::recording::Recording;
use super::region_builder::RegionConfig;
use super::timeline::Clip;
use super::trajectory::{Trajectory, Waypoint};
use super::valid_region::ValidRegion;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::quality::ViewCoverage;

const SLOPE: f64 = 0.03;
const SIZE: DVec3 = DVec3::new(4.2, 1.8, 1.5);

struct Street {
    recording: Recording,
    region: ValidRegion,
    library: Vec<Candidate>,
}

impl Street {
    /// A wall on the left, a parked car on the right, a mover that drives ahead at 8 m/s, frames every 0.1 s.
    fn new() -> Self {
        let world = BoxWorld {
            slope: SLOPE,
            boxes: vec![
                (DVec3::new(10.0, 6.0, 0.0), DVec3::new(60.0, 6.5, 3.0)),
                (DVec3::new(22.0, -5.0, 0.0), DVec3::new(26.5, -3.0, 1.5)),
            ],
            half_width: 10.0,
            length: 90.0,
        };
        let mut recording = drive(SLOPE, 41, 0.8);
        let parked = street_car(&recording, "parked", DVec3::new(24.25, -4.0, 1.48), false);
        let mut mover = street_car(&recording, "mover", DVec3::ZERO, true);
        for (i, pose) in mover.local_from_cuboid.iter_mut().enumerate() {
            let x = 14.0 + 0.8 * i as f64;
            let rotation = DQuat::from_rotation_y(-libm::atan(SLOPE));
            *pose = Some(Rigid::new(rotation, DVec3::new(x, 0.4, SLOPE * x + 0.75)));
        }
        recording.tracks = vec![parked, mover];
        let region = ValidRegion::build(&world, &recording, &RegionConfig::default());
        let all_round: Vec<f64> = (0..24).map(|i| f64::from(i) * 15.0).collect();
        let library = vec![
            candidate("assets/car", "other-log", "7", &all_round, true),
            candidate("assets/mover", "log", "mover", &all_round, false),
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

    fn clip(&self, recipe: &Recipe, index: u64) -> Vec<Composition> {
        compose_clip(&self.stage(), &self.library, recipe, 11, index).unwrap()
    }
}

fn candidate(name: &str, log: &str, track: &str, azimuths_deg: &[f64], library: bool) -> Candidate {
    let cameras: Vec<_> = azimuths_deg
        .iter()
        .map(|a| {
            let (sin, cos) = libm::sincos(a.to_radians());
            Rigid::new(DQuat::IDENTITY, DVec3::new(12.0 * cos, 12.0 * sin, 1.0))
        })
        .collect();
    Candidate {
        name: name.into(),
        class: ObjectClass::Car,
        size_m: SIZE,
        source_log: log.into(),
        source_track_id: track.into(),
        library,
        coverage: ViewCoverage::of_cameras(&cameras, true),
        ego_from_object: Vec::new(),
    }
}

fn clip_recipe(frames: u32, stride: u32, speed_mps: [f64; 2]) -> Recipe {
    Recipe {
        min_objects: 2,
        max_objects: 3,
        clip: Clip {
            frames,
            stride,
            speed_mps,
        },
        ..Recipe::new(PlacementPreset::Default)
    }
}

fn edited(edit: Edit) -> Recipe {
    Recipe {
        min_objects: 0,
        max_objects: 0,
        frame_indices: vec![4],
        edits: vec![ActorEdit {
            track_id: "mover".into(),
            edit,
        }],
        ..Recipe::new(PlacementPreset::Default)
    }
}

fn find(composition: &Composition, origin: Origin) -> Option<&PlacedObject> {
    composition.objects.iter().find(|o| o.origin == origin)
}

/// Pairs of objects that overlap in any frame, and objects off the ground.
fn faults(street: &Street, frames: &[Composition]) -> Vec<String> {
    let mut faults = Vec::new();
    for frame in frames {
        let mut standing: Vec<(String, Occupied)> = Vec::new();
        for object in &frame.objects {
            standing.push((object.instance_id.to_string(), object.occupied()));
            if object.origin == Origin::Inserted {
                for (x, y) in [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)] {
                    let wheel = DVec3::new(x, y, -1.0) * SIZE * 0.5;
                    let wheel = object.local_from_object.point(wheel);
                    let hang = wheel.z - SLOPE * wheel.x;
                    if hang.abs() > 0.1 {
                        faults.push(format!("{} floats {hang}", object.instance_id));
                    }
                }
            }
        }
        let ego = frame.local_from_ego;
        standing.push((
            "ego".into(),
            Occupied {
                local_from_cuboid: ego * Rigid::from_heading(0.0, DVec3::new(0.6, 0.0, 0.8)),
                size_m: DVec3::new(4.8, 2.0, 1.6),
            },
        ));
        // Originals that left the image still stand on the street.
        for track in &street.recording.tracks {
            let shown = frame
                .objects
                .iter()
                .any(|o| o.track_id.as_ref() == Some(&track.track_id));
            if let (false, Some(pose)) = (shown, pose_at(track, frame.frame)) {
                let original = Occupied {
                    local_from_cuboid: pose,
                    size_m: track.size_m,
                };
                standing.push((track.track_id.clone(), original));
            }
        }
        for (i, (a, first)) in standing.iter().enumerate() {
            for (b, second) in &standing[i + 1..] {
                if first.overlap_m3(second) > 0.0 {
                    faults.push(format!("{a} and {b} overlap in frame {}", frame.frame));
                }
            }
        }
    }
    faults
}

#[test]
fn objects_of_a_clip_touch_nothing_at_any_time() {
    let street = Street::new();
    let (mut inserted, mut rejected) = (0, 0);
    for index in 0..60 {
        let frames = street.clip(&clip_recipe(12, 2, [3.0, 9.0]), index);
        assert_eq!(frames.len(), 12);
        assert_eq!(
            faults(&street, &frames),
            Vec::<String>::new(),
            "sample {index}"
        );
        inserted += frames[0]
            .objects
            .iter()
            .filter(|o| o.origin == Origin::Inserted)
            .count();
        let reasons = &frames[0].rejections;
        rejected += reasons.get("collides_original").copied().unwrap_or(0);
        rejected += reasons.get("collides_ego").copied().unwrap_or(0);
    }
    assert!(inserted > 40, "{inserted}");
    assert!(
        rejected > 10,
        "the clip's own tests refuse something: {rejected}"
    );
}

/// The same objects driven on without looking: the check above must see that they crash.
#[test]
fn blind_driving_is_found() {
    let street = Street::new();
    let (mut crashed, mut floating) = (0, 0);
    for (index, rise) in (0..60).flat_map(|index| [(index, SLOPE), (index, 0.0)]) {
        let mut frames = street.clip(&clip_recipe(12, 2, [3.0, 9.0]), index);
        let start = frames[0].objects.clone();
        for (k, frame) in frames.iter_mut().enumerate() {
            for object in frame
                .objects
                .iter_mut()
                .filter(|o| o.origin == Origin::Inserted)
            {
                let first = start.iter().find(|o| o.instance_id == object.instance_id);
                let pose = first.expect("inserts are in every frame").local_from_object;
                // Backwards through the ego: along the street, or level where it rises.
                let way = -12.0 * k as f64 * 0.2;
                let by = DVec3::new(way, 0.0, rise * way);
                object.local_from_object = Rigid::new(pose.rotation, pose.translation_m + by);
            }
        }
        let faults = faults(&street, &frames);
        crashed += usize::from(rise > 0.0 && faults.iter().any(|f| f.contains("overlap")));
        floating += usize::from(rise == 0.0 && faults.iter().any(|f| f.contains("float")));
    }
    println!("{crashed} crash and {floating} float of 60");
    assert!(crashed > 45 && floating > 55, "{crashed}, {floating} of 60");
}

#[test]
fn ids_sizes_and_velocities_agree_from_frame_to_frame() {
    let street = Street::new();
    let mut moved = 0;
    for index in 0..20 {
        let frames = street.clip(&clip_recipe(6, 2, [3.0, 9.0]), index);
        let mut seen: BTreeMap<u16, PlacedObject> = BTreeMap::new();
        for (k, frame) in frames.iter().enumerate() {
            assert!(frame.objects.iter().all(|o| o.instance_id > 0));
            for object in &frame.objects {
                let known = seen
                    .entry(object.instance_id)
                    .or_insert_with(|| object.clone());
                assert_eq!((known.asset, known.size_m), (object.asset, object.size_m));
                assert_eq!(
                    (known.origin, &known.track_id),
                    (object.origin, &object.track_id)
                );
                let Some(later) = frames.get(k + 1) else {
                    continue;
                };
                let next = later
                    .objects
                    .iter()
                    .find(|o| o.instance_id == object.instance_id);
                let Some(next) = next else {
                    assert!(
                        object.origin.is_as_recorded(),
                        "placed objects stay in the sample"
                    );
                    continue;
                };
                let way =
                    next.local_from_object.translation_m - object.local_from_object.translation_m;
                let velocity = object.velocity_mps.expect("every velocity is known");
                // Frames are 0.2 s apart; the ground's cells make the way a little uneven.
                assert!((way - velocity * 0.2).length() < 0.06, "{way} {velocity}");
                moved += usize::from(object.origin == Origin::Inserted && way.length() > 0.5);
            }
        }
    }
    assert!(moved > 30, "{moved}");
}

#[test]
fn a_clip_of_one_frame_is_the_single_image() {
    let street = Street::new();
    let recipe = clip_recipe(1, 1, [0.0; 2]);
    for index in 0..10 {
        let single = compose(&street.stage(), &street.library, &recipe, 11, index).unwrap();
        assert_eq!(street.clip(&recipe, index), [single]);
    }
    let two = clip_recipe(2, 1, [0.0; 2]);
    assert_eq!(street.clip(&two, 0).len(), 2);
    assert_eq!(street.clip(&two, 3), street.clip(&two, 3));
}

#[test]
fn a_removed_actor_is_in_no_frame_and_its_place_is_free() {
    let street = Street::new();
    let recipe = Recipe {
        clip: Clip {
            frames: 5,
            ..Clip::default()
        },
        ..edited(Edit::Remove)
    };
    let frames = street.clip(&recipe, 0);
    for frame in &frames {
        let names: Vec<_> = frame
            .objects
            .iter()
            .map(|o| o.track_id.as_deref())
            .collect();
        assert!(!names.contains(&Some("mover")), "{names:?}");
        assert_eq!(frame.left_out.len(), 1, "its hole is known");
        assert_eq!(frame.left_out[0].track_id, "mover");
    }
    // Something else may stand where it was.
    let place = street.recording.tracks[1].local_from_cuboid[4].unwrap();
    let given = |edits: Vec<ActorEdit>| Recipe {
        given_objects: vec![GivenObject {
            asset: "assets/car".into(),
            trajectory: Trajectory {
                waypoints: vec![Waypoint {
                    time_s: 0.0,
                    position_m: place.translation_m,
                    heading_rad: 0.0,
                }],
            },
        }],
        edits,
        ..edited(Edit::Remove)
    };
    let free = street.clip(&given(edited(Edit::Remove).edits), 0);
    assert!(
        find(&free[0], Origin::Inserted).is_some(),
        "{:?}",
        free[0].rejections
    );
    let taken = street.clip(&given(Vec::new()), 0);
    assert!(find(&taken[0], Origin::Inserted).is_none());
    assert_eq!(taken[0].rejections["collides_original"], 1);
    assert_eq!(taken[0].rejections["given_refused"], 1);
}

#[test]
fn a_shifted_actor_drives_beside_its_path_on_the_ground() {
    let street = Street::new();
    let shift = Shift {
        x_m: 6.0,
        y_m: 2.2,
        heading_rad: 0.1,
    };
    let recipe = Recipe {
        clip: Clip {
            frames: 6,
            ..Clip::default()
        },
        ..edited(Edit::Shift(shift))
    };
    for frame in street.clip(&recipe, 0) {
        let moved = find(&frame, Origin::Moved).expect("the actor is there");
        assert_eq!(moved.track_id.as_deref(), Some("mover"));
        assert_eq!(moved.asset, Some(1));
        assert!(find(&frame, Origin::Replayed).is_none());
        assert_eq!(frame.left_out.len(), 1);
        let recorded = street.recording.tracks[1].local_from_cuboid[frame.frame].unwrap();
        let way = moved.local_from_object.translation_m - recorded.translation_m;
        assert!(
            (way.truncate() - DVec2::new(6.0, 2.2)).length() < 0.05,
            "{way}"
        );
        let bottom = moved
            .local_from_object
            .point(DVec3::new(0.0, 0.0, -0.5 * SIZE.z));
        assert!((bottom.z - SLOPE * bottom.x).abs() < 0.05, "{bottom}");
        let velocity = moved.velocity_mps.unwrap();
        assert!((velocity.x - 8.0).abs() < 0.3, "{velocity}");
    }
    let single = street.clip(&edited(Edit::Shift(shift)), 0);
    let velocity = find(&single[0], Origin::Moved)
        .unwrap()
        .velocity_mps
        .unwrap();
    assert!((velocity.x - 8.0).abs() < 0.3, "{velocity}");
}

#[test]
fn an_actor_that_cannot_move_stays_and_is_counted() {
    let street = Street::new();
    let into_the_wall = Shift {
        x_m: 0.0,
        y_m: 5.8,
        heading_rad: 0.0,
    };
    let frames = street.clip(&edited(Edit::Shift(into_the_wall)), 0);
    assert!(find(&frames[0], Origin::Replayed).is_some());
    assert!(find(&frames[0], Origin::Moved).is_none());
    assert!(frames[0].left_out.is_empty());
    assert_eq!(frames[0].rejections["given_refused"], 1);
    assert!(frames[0].rejections.len() > 1, "{:?}", frames[0].rejections);
}

#[test]
fn a_given_trajectory_is_followed_and_refused_when_it_crashes_later() {
    let street = Street::new();
    let follow = |points: &[(f64, f64, f64)]| {
        let waypoints = points.iter().map(|&(time_s, x, y)| Waypoint {
            time_s,
            position_m: DVec3::new(x, y, 99.0),
            heading_rad: 0.0,
        });
        let trajectory = Trajectory {
            waypoints: waypoints.collect(),
        };
        Recipe {
            clip: Clip {
                frames: 4,
                stride: 5,
                ..Clip::default()
            },
            ..edited(Edit::Follow(trajectory))
        }
    };
    let frames = street.clip(&follow(&[(0.0, 20.0, 1.0), (1.5, 32.0, 2.0)]), 0);
    for (k, frame) in frames.iter().enumerate() {
        let moved = find(frame, Origin::Moved).expect("the actor is there");
        let at = moved.local_from_object.translation_m;
        let expected = DVec2::new(20.0, 1.0).lerp(DVec2::new(32.0, 2.0), k as f64 / 3.0);
        assert!(
            (at.truncate() - expected).length() < 0.05,
            "{at} {expected}"
        );
        assert!(
            (at.z - 0.75 - SLOPE * at.x).abs() < 0.05,
            "on the ground: {at}"
        );
        let velocity = moved.velocity_mps.unwrap();
        assert!(
            (velocity.truncate() - DVec2::new(8.0, 2.0 / 3.0)).length() < 0.3,
            "{velocity}"
        );
    }
    // Through the parked car between the second frame and the third: no frame shows it, the instants between do.
    let through = street.clip(
        &follow(&[(0.55, 24.0, 1.0), (0.75, 24.25, -4.0), (0.95, 24.0, 1.0)]),
        0,
    );
    assert!(find(&through[0], Origin::Moved).is_none());
    let reasons = &through[0].rejections;
    assert!(reasons.contains_key("given_refused"), "{reasons:?}");
}

#[test]
fn edits_that_name_nothing_are_one_clear_error() {
    let street = Street::new();
    let fails = |recipe: Recipe, part: &str| {
        let error = compose(&street.stage(), &street.library, &recipe, 1, 1).unwrap_err();
        assert!(error.to_string().contains(part), "{error}");
    };
    let named = |track: &str| Recipe {
        edits: vec![ActorEdit {
            track_id: track.into(),
            edit: Edit::Remove,
        }],
        ..edited(Edit::Remove)
    };
    fails(named("ghost"), "no track \"ghost\"");
    fails(named("parked"), "never moves");
    let mut twice = named("mover");
    twice.edits.push(twice.edits[0].clone());
    fails(twice, "edited twice");
    let given = Recipe {
        given_objects: vec![GivenObject {
            asset: "assets/none".into(),
            trajectory: Trajectory {
                waypoints: vec![Waypoint {
                    time_s: 0.0,
                    position_m: DVec3::ZERO,
                    heading_rad: 0.0,
                }],
            },
        }],
        ..edited(Edit::Remove)
    };
    fails(given, "no object \"assets/none\"");
    fails(
        Recipe {
            clip: Clip {
                frames: 40,
                stride: 2,
                ..Clip::default()
            },
            ..edited(Edit::Remove)
        },
        "clip",
    );
    let no_asset = compose(
        &street.stage(),
        &street.library[..1],
        &edited(Edit::Follow(Trajectory {
            waypoints: vec![Waypoint {
                time_s: 0.0,
                position_m: DVec3::ZERO,
                heading_rad: 0.0,
            }],
        })),
        1,
        1,
    );
    assert!(
        no_asset
            .unwrap_err()
            .to_string()
            .contains("no asset to move")
    );
}
