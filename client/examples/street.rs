//! Writes frames of the generated street as PNG and times it: `cargo run --release --example street -- OUT_DIR [FRAME ...]`.
//!
//! Without frames it generates the whole log of the demo and prints its size.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use backlot_client::generator::{StreetConfig, StreetWorld, psnr, warp_by_depth};

fn main() -> Result<()> {
    let mut arguments = std::env::args().skip(1);
    let out = PathBuf::from(
        arguments
            .next()
            .context("usage: street OUT_DIR [FRAME ...]")?,
    );
    std::fs::create_dir_all(&out)?;
    let frames: Vec<usize> = arguments.map(|a| a.parse()).collect::<Result<_, _>>()?;
    let world = StreetWorld::new(&StreetConfig::default())?;
    if frames.is_empty() {
        return whole_log(&world);
    }
    frames
        .iter()
        .try_for_each(|&frame| one_frame(&world, frame, &out))
}

fn whole_log(world: &StreetWorld) -> Result<()> {
    let started = Instant::now();
    let log = world.read_log()?;
    let bytes: u64 = log
        .drive_log
        .frames
        .iter()
        .flat_map(|f| {
            [
                &f.image,
                &f.instance_mask,
                &f.sky_mask,
                &f.free_instance_mask,
            ]
        })
        .chain(log.drive_log.sweeps.iter().map(|s| &s.points))
        .flatten()
        .map(|blob| blob.size_bytes)
        .sum();
    println!(
        "{:.2} s, {} blobs, {:.1} MiB",
        started.elapsed().as_secs_f64(),
        log.blobs.len(),
        bytes as f64 / f64::from(1 << 20)
    );
    Ok(())
}

fn one_frame(world: &StreetWorld, frame: usize, out: &Path) -> Result<()> {
    let timestamps = world.frame_timestamps_ns();
    let (view, exact) = (
        world.view_at(timestamps[frame]),
        world.frame_at(timestamps[frame])?,
    );
    let path = out.join(format!("{frame:03}.png"));
    image::save_buffer(
        &path,
        &exact.rgb8,
        exact.width,
        exact.height,
        image::ColorType::Rgb8,
    )?;
    let near = [frame.wrapping_sub(1), frame + 1];
    for neighbour in near.into_iter().filter(|&n| n < timestamps.len()) {
        let source = (
            world.view_at(timestamps[neighbour]),
            world.frame_at(timestamps[neighbour])?,
        );
        let warped = warp_by_depth((&source.0, &source.1), (&view, &exact));
        let counted = |i: usize| !exact.sky[i] && exact.instance[i] == 0;
        println!(
            "{frame} warped from {neighbour}: {:.2} dB",
            psnr(&warped, &exact.rgb8, counted)
        );
    }
    Ok(())
}
