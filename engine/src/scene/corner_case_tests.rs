//! Presets of corner cases place what their names say.

use glam::{DVec2, DVec3};

use super::composition::{Composition, PlacedObject};
use super::placement_tests::{SLOPE, Street, asset, grid, inserted};
use super::preset::PlacementPreset;
use super::recipe::Recipe;
use crate::class::ObjectClass;

/// Accepted placements of a preset over some samples.
fn accepted(street: &Street, recipe: &Recipe, samples: u64) -> Vec<(PlacedObject, Composition)> {
    (0..samples)
        .flat_map(|index| {
            let composition = street.compose(recipe, index);
            let objects: Vec<_> = inserted(&composition).cloned().collect();
            objects.into_iter().map(move |o| (o, composition.clone()))
        })
        .collect()
}

#[test]
fn corner_cases_are_what_their_names_say() {
    let street = Street::new(SLOPE);
    let distance = |object: &PlacedObject, composition: &Composition| {
        let eye = composition.local_from_camera.translation_m;
        (object.local_from_object.translation_m - eye).length()
    };
    let far = accepted(&street, &Recipe::new(PlacementPreset::Far), 60);
    assert!(far.len() > 60 && far.iter().all(|(o, c)| distance(o, c) >= 30.0));
    let cars = Recipe {
        classes: vec![ObjectClass::Car],
        ..Recipe::new(PlacementPreset::StrangeHeading)
    };
    let strange = accepted(&street, &cars, 60);
    assert!(strange.len() > 40, "{}", strange.len());
    for (object, _) in &strange {
        // The road runs along x.
        let across = object.local_from_object.direction(DVec3::X).y.abs();
        assert!(across > 0.7, "{across}");
    }
    let cut_in = accepted(&street, &Recipe::new(PlacementPreset::CutIn), 60);
    assert!(cut_in.len() > 30, "{}", cut_in.len());
    for (object, composition) in &cut_in {
        let pose = object.local_from_object;
        assert!(distance(object, composition) <= 20.0);
        let forward = pose.direction(DVec3::X);
        assert!(forward.x > 0.9 && forward.y * pose.translation_m.y < 0.0);
        assert!((8.0..25.1).contains(&forward.y.abs().asin().to_degrees()));
        assert!((0.7..3.6).contains(&pose.translation_m.y.abs()));
    }
}

#[test]
fn queues_stand_bumper_to_bumper() {
    let mut street = Street::new(SLOPE);
    street.library = (0..8)
        .map(|i| {
            asset(
                &format!("assets/{i}"),
                ObjectClass::Car,
                &[165.0, 180.0, 195.0],
            )
        })
        .collect();
    let recipe = Recipe::new(PlacementPreset::DenseQueue);
    let mut lengths = Vec::new();
    for index in 0..40 {
        let composition = street.compose(&recipe, index);
        let mut along: Vec<DVec2> = inserted(&composition)
            .map(|o| o.local_from_object.translation_m.truncate())
            .collect();
        along.sort_by(|a, b| a.x.total_cmp(&b.x));
        for pair in along.windows(2) {
            let gap = pair[1].x - pair[0].x - 4.2;
            assert!((0.5..3.1).contains(&gap), "gap of {gap} m");
            assert!((pair[1].y - pair[0].y).abs() < 0.6);
        }
        lengths.push(along.len());
    }
    let mean = lengths.iter().sum::<usize>() as f64 / lengths.len() as f64;
    assert!(mean > 3.0, "{lengths:?}");
}

#[test]
fn slopes_are_found_where_there_are_some() {
    let recipe = Recipe::new(PlacementPreset::OnSlope);
    let sloped = accepted(&Street::new(SLOPE), &recipe, 40);
    assert!(sloped.len() > 40, "{}", sloped.len());
    let flat = Street::new(0.0).compose(&recipe, 0);
    assert_eq!(inserted(&flat).count(), 0);
    assert!(
        flat.rejections["no_free_place"] >= 64,
        "{:?}",
        flat.rejections
    );
}

#[test]
fn occluded_objects_are_partly_hidden_by_what_stands_there() {
    let street = Street::new(SLOPE);
    let recipe = Recipe::new(PlacementPreset::Occluded);
    let hidden = accepted(&street, &recipe, 60);
    assert!(hidden.len() > 30, "{}", hidden.len());
    let mut partly = 0;
    for (object, composition) in &hidden {
        let eye = composition.local_from_camera.translation_m;
        let half = object.size_m * 0.45;
        let (mut cut, mut total) = (0, 0);
        for x in grid(half.x, 0.4) {
            for y in grid(half.y, 0.4) {
                for z in grid(half.z, 0.4) {
                    let target = object.local_from_object.point(DVec3::new(x, y, z));
                    let sight = target - eye;
                    let reach = sight.length() - 0.05;
                    let hit = street.world.trace(eye, sight.normalize(), reach);
                    total += 1;
                    cut += u32::from(hit.is_some());
                }
            }
        }
        let fraction = f64::from(cut) / f64::from(total);
        partly += usize::from((0.05..0.95).contains(&fraction));
    }
    assert!(
        partly * 10 >= hidden.len() * 8,
        "{partly} of {}",
        hidden.len()
    );
}
