//! Writes frames of the generated street as PNG: `cargo run --release --example street -- OUT_DIR [FRAME ...]`.

use std::path::PathBuf;
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
    let timestamps = world.frame_timestamps_ns();
    for frame in frames {
        let started = Instant::now();
        let target = (
            world.view_at(timestamps[frame]),
            world.frame_at(timestamps[frame])?,
        );
        println!("frame {frame}: {:.3} s", started.elapsed().as_secs_f64());
        let path = out.join(format!("{frame:03}.png"));
        image::save_buffer(
            &path,
            &target.1.rgb8,
            target.1.width,
            target.1.height,
            image::ColorType::Rgb8,
        )?;
        for neighbour in [frame.wrapping_sub(1), frame + 1]
            .into_iter()
            .filter(|&n| n < timestamps.len())
        {
            let source = (
                world.view_at(timestamps[neighbour]),
                world.frame_at(timestamps[neighbour])?,
            );
            let warped = warp_by_depth((&source.0, &source.1), (&target.0, &target.1));
            let counted = |i: usize| !target.1.sky[i] && target.1.instance[i] == 0;
            println!(
                "  warped from {neighbour}: {:.2} dB",
                psnr(&warped, &target.1.rgb8, counted)
            );
        }
    }
    Ok(())
}
