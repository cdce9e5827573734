//! The valid region of an analytic street: wall, parked car, a hole in the ground, and a 5 % slope.

use glam::{DVec2, DVec3};

use super::box_world::{BoxWorld, drive};
use super::region_builder::RegionConfig;
use super::valid_region::{Cell, ValidRegion};
use super::voxel_street::VoxelStreet;

const SLOPE: f64 = 0.05;
const VOXEL_M: f32 = 0.25;

pub(super) fn street() -> BoxWorld {
    BoxWorld {
        slope: SLOPE,
        boxes: vec![
            // A wall along the left side, a parked car on the right, and a post that leaves 1 m to the wall.
            (DVec3::new(10.0, 4.0, 0.0), DVec3::new(30.0, 4.5, 3.0)),
            (DVec3::new(22.0, -5.0, 0.0), DVec3::new(26.5, -3.0, 1.5)),
            (DVec3::new(14.0, 2.5, 0.0), DVec3::new(14.5, 3.0, 3.0)),
        ],
        half_width: 10.0,
        length: 60.0,
    }
}

pub(super) fn config() -> RegionConfig {
    RegionConfig {
        ahead_m: 20.0,
        max_lateral_m: 7.0,
        max_views: usize::MAX,
        ..RegionConfig::default()
    }
}

/// What each cell must be, from the definition and sight lines that share no code with the region's; `seen` holds what hides.
pub(super) fn expected(
    world: &BoxWorld,
    seen: &BoxWorld,
    region: &ValidRegion,
    config: &RegionConfig,
) -> Vec<Cell> {
    let is_open = |eye: DVec3, target: DVec3, slack_m: f64| {
        let offset = target - eye;
        let reach = offset.length() - slack_m;
        seen.trace(eye, offset.normalize(), reach).is_none()
    };
    expected_with(world, region, config, |eye, ground| {
        is_open(eye, ground, 0.1) && is_open(eye, ground + DVec3::Z * 0.8, 0.3)
    })
}

/// [`expected`], with what one eye must see of a place on the ground.
fn expected_with(
    world: &BoxWorld,
    region: &ValidRegion,
    config: &RegionConfig,
    sees: impl Fn(DVec3, DVec3) -> bool,
) -> Vec<Cell> {
    let recording = drive(SLOPE, 31, 1.0);
    let inside = |c: DVec2| {
        let mut boxes = world.boxes.iter();
        boxes.any(|(low, high)| c.x > low.x && c.x < high.x && c.y > low.y && c.y < high.y)
    };
    // Cells of half a metre: a pillar of 2 m x 2 m has four by four.
    let offsets = || (0..16).map(|i| DVec2::new(f64::from(i % 4), f64::from(i / 4)) * 0.5);
    let is_clear = |c: DVec2| region.index_at(c).is_some() && !inside(c);
    let in_clear_pillar =
        |c: DVec2| offsets().any(|corner| offsets().all(|cell| is_clear(c - corner + cell)));
    let is_seen = |ground: DVec3| {
        let views = recording.frames.iter().filter(|frame| {
            let eye = frame.local_from_camera.translation_m;
            let p = frame.local_from_camera.inverse().point(ground);
            let pixel = recording.cameras[0].camera.project(p);
            let in_image =
                pixel.is_some_and(|px| px.x >= 0.0 && px.x < 640.0 && px.y >= 0.0 && px.y < 384.0);
            in_image
                && (3.0..config.view_range_m).contains(&(ground - eye).length())
                && sees(eye, ground)
        });
        views.take(config.min_views).count() >= config.min_views
    };
    (0..region.cells.len())
        .map(|cell| {
            let c = region.centre(cell);
            // The path along the slope is driven for 30 m on the level and goes on up it.
            let end = 30.0 + config.ahead_m / (1.0 + SLOPE * SLOPE).sqrt();
            if c.y.abs() > config.max_lateral_m || c.x < 0.0 || c.x > end {
                Cell::Unseen
            } else if !in_clear_pillar(c) {
                Cell::Blocked
            } else if is_seen(c.extend(world.ground(c.x))) {
                Cell::Free
            } else {
                Cell::Unseen
            }
        })
        .collect()
}

/// What each cell must be by the voxelised street's own density: sight lines are sums of it in small steps.
fn expected_of_voxels(world: &BoxWorld, region: &ValidRegion, config: &RegionConfig) -> Vec<Cell> {
    let street = VoxelStreet::new(world, f64::from(VOXEL_M));
    expected_with(world, region, config, |eye, ground| {
        street.sees(eye, ground)
    })
}

/// Cells that are free and must not be or the other way round.
///
/// Whether cells that are not free say blocked or unseen is the same: the interior of things was never reached from the road.
fn wrong_cells(world: &BoxWorld, region: &ValidRegion, config: &RegionConfig) -> Vec<usize> {
    let expected = expected_of_voxels(world, region, config);
    let is_free = |cells: &[Cell], i: usize| cells[i] == Cell::Free;
    let cells = 0..expected.len();
    cells
        .filter(|i| is_free(&region.cells, *i) != is_free(&expected, *i))
        .collect()
}

pub(super) fn draw(region: &ValidRegion, cells: &[Cell]) -> String {
    (0..region.rows)
        .rev()
        .map(|row| {
            let line = &cells[row * region.columns..(row + 1) * region.columns];
            let letters = line.iter().map(|c| match c {
                Cell::Unseen => '.',
                Cell::Free => 'f',
                Cell::Blocked => '#',
                Cell::Uneven => 'u',
            });
            letters.chain(['\n']).collect::<String>()
        })
        .collect()
}

#[test]
fn a_voxelised_street_gives_exactly_the_expected_map() {
    let (world, config) = (street(), config());
    let field = world.voxelised(VOXEL_M);
    let region = ValidRegion::build(&field, &drive(SLOPE, 31, 1.0), &config);
    let wrong = wrong_cells(&world, &region, &config);
    assert!(
        wrong.is_empty(),
        "{} cells differ, first at {:?}\n{}\n{}",
        wrong.len(),
        region.centre(wrong[0]),
        draw(&region, &region.cells),
        draw(&region, &expected_of_voxels(&world, &region, &config))
    );
    let free = region.free_cells().count();
    assert!(free > 1000, "{free} free cells");
    for cell in region.free_cells() {
        let true_z = world.ground(region.centre(cell).x);
        assert!((region.ground_m[cell] - true_z).abs() < 0.03);
    }
    for (x, y, state) in [
        (20.0, 4.2, Cell::Blocked),
        (24.0, -3.2, Cell::Blocked),
        (15.0, 0.2, Cell::Free),
        (25.2, -5.2, Cell::Unseen),
        (20.0, 5.5, Cell::Unseen),
        (14.2, 3.7, Cell::Blocked),
        (16.2, 3.7, Cell::Free),
    ] {
        assert_eq!(region.cell_at(DVec2::new(x, y)), state, "at {x}, {y}");
    }
}

#[test]
fn free_space_nobody_saw_is_not_free() {
    // Without the wall's shadow the same place is free; with the drive cut short it is unseen.
    let mut open = street();
    open.boxes.remove(0);
    let at = DVec2::new(20.0, 5.5);
    let full = ValidRegion::build(&open, &drive(SLOPE, 31, 1.0), &config());
    assert_eq!(full.cell_at(at), Cell::Free);
    let far = RegionConfig {
        view_range_m: 12.0,
        ..config()
    };
    let short = ValidRegion::build(&open, &drive(SLOPE, 2, 1.0), &far);
    assert_eq!(short.cell_at(at), Cell::Unseen);
}

#[test]
fn pavements_are_not_road() {
    let mut world = street();
    world.boxes = vec![(DVec3::new(-2.0, 3.0, -0.4), DVec3::new(60.0, 10.0, 0.14))];
    let region = ValidRegion::build(&world, &drive(SLOPE, 31, 1.0), &config());
    assert_eq!(region.cell_at(DVec2::new(15.0, 2.2)), Cell::Free);
    assert_ne!(region.cell_at(DVec2::new(15.0, 4.2)), Cell::Free);
    assert_ne!(region.cell_at(DVec2::new(15.0, 3.2)), Cell::Free);
}

/// The comparison above must notice a region that is wrong by one rule.
#[test]
fn a_region_that_breaks_a_rule_differs_from_the_expected_map() {
    let (world, right) = (street(), config());
    let recording = drive(SLOPE, 31, 1.0);
    let wrong: [(&str, RegionConfig); 4] = [
        (
            "unseen is free",
            RegionConfig {
                min_views: 0,
                ..right
            },
        ),
        (
            "no pillar is dense",
            RegionConfig {
                max_sigma: 1e9,
                mean_sigma: 1e9,
                ..right
            },
        ),
        (
            "pillars hold the ground",
            RegionConfig {
                pillar_from_m: -0.3,
                ..right
            },
        ),
        (
            "pillars are cells",
            RegionConfig {
                pillar_m: 0.5,
                ..right
            },
        ),
    ];
    let build =
        |config: &RegionConfig| ValidRegion::build(&world.voxelised(VOXEL_M), &recording, config);
    for (rule, config) in wrong {
        let wrong = wrong_cells(&world, &build(&config), &right);
        println!("{rule}: {} cells differ", wrong.len());
        assert!(!wrong.is_empty(), "{rule}");
    }
}

#[test]
fn the_papers_thresholds_judge_a_raster_of_pillars_on_raw_units() {
    let build = |base_voxel_m: f64| {
        let config = RegionConfig {
            max_views: usize::MAX,
            ..RegionConfig::paper(base_voxel_m)
        };
        ValidRegion::build(&street(), &drive(SLOPE, 31, 1.0), &config)
    };
    // The car's density of 100/m is under 30 / 0.25 m: its wall of voxels does not count, and it is a step in the ground.
    let beside_car = DVec2::new(24.0, -2.7);
    assert_eq!(build(0.25).cell_at(DVec2::new(24.0, -3.2)), Cell::Uneven);
    assert_eq!(build(0.25).cell_at(beside_car), Cell::Free);
    // Over 30 / 0.5 m, it blocks the whole pillar.
    assert_eq!(build(0.5).cell_at(beside_car), Cell::Blocked);
}

#[test]
fn nothing_recorded_or_no_road_gives_nothing_free() {
    let empty = ValidRegion::build(&street(), &Default::default(), &config());
    assert_eq!(empty.free_cells().count(), 0);
    let void = BoxWorld {
        half_width: -1.0,
        boxes: Vec::new(),
        ..street()
    };
    let region = ValidRegion::build(&void, &drive(SLOPE, 5, 1.0), &config());
    assert_eq!(region.free_cells().count(), 0);
}
