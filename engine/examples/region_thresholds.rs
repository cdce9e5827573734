//! Measures the densities that the valid region's thresholds separate: over road that was driven, and inside labelled parked cars.
//!
//! `cargo run --release -p backlot-engine --no-default-features --example region_thresholds -- ASSET...`, with payloads of
//! backgrounds as `backlot assets export` writes them.

use std::env;

use anyhow::{Context, ensure};
use backlot_engine::Asset;
use backlot_engine::scene::{DensityField, RegionConfig};
use glam::{DVec2, DVec3};

/// Density of a pillar above the ground in 1/m.
#[derive(Clone, Copy, Debug)]
struct Pillar {
    max: f64,
    mean: f64,
}

const SIDE_M: f64 = 2.0;
const STEP_M: f64 = 0.1;
/// Cells of this side are looked at inside cars: their middle may be hollow, their sides are not.
const MARGIN_M: f64 = 0.3;

fn main() -> anyhow::Result<()> {
    let paths: Vec<String> = env::args().skip(1).collect();
    ensure!(!paths.is_empty(), "usage: region_thresholds ASSET...");
    let (mut road, mut cars) = (Vec::new(), Vec::new());
    for path in &paths {
        let bytes = std::fs::read(path).with_context(|| format!("reading {path}"))?;
        let asset = Asset::decode(&bytes).with_context(|| format!("decoding {path}"))?;
        let before = (road.len(), cars.len());
        collect(&asset, &mut road, &mut cars)?;
        println!(
            "{path}: {} road pillars, {} car pillars",
            road.len() - before.0,
            cars.len() - before.1
        );
    }
    ensure!(
        !road.is_empty() || !cars.is_empty(),
        "neither driven road nor labelled cars were found"
    );
    for (name, pillars) in [("road", &road), ("cars", &cars)] {
        if pillars.is_empty() {
            println!("{name}: none, so nothing is said of it");
            continue;
        }
        print_quantiles(name, "max", pillars.iter().map(|p| p.max).collect());
        print_quantiles(name, "mean", pillars.iter().map(|p| p.mean).collect());
    }
    for (name, config) in [
        ("default", RegionConfig::default()),
        ("paper, raw, 0.25 m", RegionConfig::paper(0.25)),
        ("paper, raw, 0.1 m", RegionConfig::paper(0.1)),
    ] {
        let dense = |p: &&Pillar| p.max >= config.max_sigma || p.mean >= config.mean_sigma;
        let share = |pillars: &[Pillar]| {
            let dense = pillars.iter().filter(dense).count();
            match pillars.len() {
                0 => "none".to_owned(),
                all => format!("{:.1} %", 100.0 * dense as f64 / all as f64),
            }
        };
        println!(
            "{name}: max {} mean {}: of road {} refused, of cars {} found",
            config.max_sigma,
            config.mean_sigma,
            share(&road),
            share(&cars)
        );
    }
    Ok(())
}

fn collect(asset: &Asset, road: &mut Vec<Pillar>, cars: &mut Vec<Pillar>) -> anyhow::Result<()> {
    let header = &asset.header;
    let region = header.valid_region.as_ref().context("no valid region")?;
    let recording = header.recording.as_ref().context("no recording")?;
    let last = recording.frames.last().context("no frames")?;
    let last = last.local_from_ego.translation_m;
    let config = RegionConfig::default();
    for frame in &recording.frames {
        let at = frame.local_from_ego.translation_m;
        // Where the ego stands at the end, nothing looked.
        if (at - last).length() < 6.0 {
            continue;
        }
        if let Some(ground) = region.ground_height(at.truncate()) {
            let low = at.truncate().extend(ground);
            road.push(pillar(asset.field.as_ref(), low, SIDE_M, &config));
        }
    }
    for track in recording.tracks.iter().filter(|t| !t.moving) {
        let Some(pose) = track.local_from_cuboid.iter().flatten().next() else {
            continue;
        };
        let seen = recording.frames.iter().any(|frame| {
            let gap = frame.local_from_ego.translation_m - pose.translation_m;
            gap.length() < 20.0
        });
        if !seen || !track.class.is_vehicle() {
            continue;
        }
        // Along the length axis, so that a pillar stays inside.
        let side = track.size_m.y.min(SIDE_M) - MARGIN_M;
        for along in [-0.3, 0.0, 0.3] {
            let offset = DVec3::new(along * track.size_m.x, 0.0, -0.5 * track.size_m.z);
            cars.push(pillar(
                asset.field.as_ref(),
                pose.point(offset),
                side,
                &config,
            ));
        }
    }
    Ok(())
}

fn pillar(field: &dyn DensityField, bottom: DVec3, side: f64, config: &RegionConfig) -> Pillar {
    let (mut max, mut sum, mut count) = (0.0f64, 0.0, 0.0);
    let across = (side / STEP_M) as i32;
    let levels = ((config.pillar_to_m - config.pillar_from_m) / STEP_M) as i32;
    for x in 0..=across {
        for y in 0..=across {
            let offset = DVec2::new(f64::from(x), f64::from(y)) * STEP_M - 0.5 * side;
            for level in 0..=levels {
                let up = config.pillar_from_m + f64::from(level) * STEP_M;
                let sigma = field.sigma(bottom + offset.extend(up));
                max = max.max(sigma);
                sum += sigma;
                count += 1.0;
            }
        }
    }
    Pillar {
        max,
        mean: sum / count,
    }
}

fn print_quantiles(name: &str, figure: &str, mut values: Vec<f64>) {
    values.sort_by(f64::total_cmp);
    let Some(last) = values.len().checked_sub(1) else {
        return;
    };
    let at = |q: f64| values[(q * last as f64).round() as usize];
    println!(
        "{name} {figure} in 1/m: least {:.3}, 1 % {:.3}, 10 % {:.3}, half {:.3}, 90 % {:.3}, 99 % {:.3}, most {:.3}",
        at(0.0),
        at(0.01),
        at(0.1),
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0)
    );
}
