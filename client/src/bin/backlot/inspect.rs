//! `backlot logs inspect`.

use std::path::Path;

use anyhow::Context;
use backlot_client::inspect::{
    CameraReport, DepthReport, LidarReport, LogReport, MaskPictures, TrackReport, overlay,
    overlay_frames,
};
use backlot_client::read_log::ReadLog;

use crate::args::{InspectOptions, Output};
use crate::input::{self, LogSource};
use crate::output::{self, Row, figure};

/// Reads a log, prints what was understood, and writes `report.json` and the pictures.
pub(crate) fn run(options: &InspectOptions, output: Output) -> anyhow::Result<()> {
    let log = input::read(&LogSource {
        path: options.path.as_deref(),
        format: options.format,
        parts: &options.parts,
        seed: options.seed,
        street: &options.street,
    })?;
    log.check_images()?;
    let report = LogReport::new(&log.drive_log);
    let text = serde_json::to_string_pretty(&report)?;
    std::fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let path = options.out.join("report.json");
    std::fs::write(&path, &text).with_context(|| format!("writing {}", path.display()))?;
    let pictures = write_pictures(&log, options)?;
    match output {
        Output::Json => println!("{text}"),
        Output::Table => print_tables(&report)?,
    }
    eprintln!(
        "{pictures} pictures and report.json are in {}",
        options.out.display()
    );
    Ok(())
}

fn write_pictures(log: &ReadLog, options: &InspectOptions) -> anyhow::Result<usize> {
    let frames = overlay_frames(&log.drive_log, options.pictures);
    let masks = options.masks.then(|| MaskPictures::new(log)).transpose()?;
    let mut written = 0;
    for frame in &frames {
        let (camera, index) = (&frame.camera_id, frame.frame_index);
        let named = || format!("camera {camera}, frame {index}");
        let mut write = |picture: image::RgbImage, kind: &str| {
            let name = format!("{}_{index:06}{kind}.png", file_name(camera));
            written += 1;
            save(&picture, &options.out.join(name))
        };
        write(overlay(log, frame).with_context(named)?, "")?;
        if let Some(masks) = &masks {
            write(masks.draw(frame).with_context(named)?, "_masks")?;
        }
    }
    Ok(written)
}

/// A camera's name is the data set's and may hold anything.
fn file_name(camera_id: &str) -> String {
    let plain = |c: char| {
        if c.is_ascii_alphanumeric() || "-_".contains(c) {
            c
        } else {
            '_'
        }
    };
    camera_id.chars().map(plain).collect()
}

fn save(picture: &image::RgbImage, path: &Path) -> anyhow::Result<()> {
    picture
        .save(path)
        .with_context(|| format!("writing {}", path.display()))
}

fn print_tables(report: &LogReport) -> anyhow::Result<()> {
    println!(
        "{}: {:.1} s, {:.1} m travelled, {} ego poses\n",
        report.dataset, report.duration_s, report.travel_m, report.ego_poses
    );
    output::print(Output::Table, &report.cameras)?;
    println!();
    output::print(Output::Table, &report.lidars)?;
    println!();
    if !report.depths.is_empty() {
        output::print(Output::Table, &report.depths)?;
        println!();
    }
    output::print(Output::Table, &report.tracks)?;
    println!();
    for missing in &report.missing {
        println!("missing: {missing}");
    }
    Ok(())
}

impl Row for CameraReport {
    const COLUMNS: &'static [&'static str] = &[
        "CAMERA",
        "SIZE",
        "FOCAL",
        "DISTORTION",
        "READOUT",
        "HEIGHT",
        "AZIMUTH",
        "IMAGES",
        "RATE",
    ];

    fn cells(&self) -> Vec<String> {
        vec![
            self.camera.clone(),
            format!("{}x{}", self.width, self.height),
            format!("{:.1} px", self.focal_px[0]),
            self.distortion.to_owned(),
            format!("{:.0} ms", self.readout_ms),
            format!("{:.2} m", self.height_m),
            format!("{:.0} deg", self.azimuth_deg),
            self.images.to_string(),
            format!("{:.1} Hz", self.rate_hz),
        ]
    }
}

impl Row for LidarReport {
    const COLUMNS: &'static [&'static str] = &["LIDAR", "SWEEPS", "RATE", "POINTS"];

    fn cells(&self) -> Vec<String> {
        vec![
            self.lidar.clone(),
            self.sweeps.to_string(),
            format!("{:.1} Hz", self.rate_hz),
            self.points.to_string(),
        ]
    }
}

impl Row for DepthReport {
    const COLUMNS: &'static [&'static str] = &["DEPTH", "IMAGES", "POINTS", "UNIT", "WEIGHT"];

    fn cells(&self) -> Vec<String> {
        let unit = |[least, most]: [f64; 2]| format!("{least:.3} to {most:.3} mm");
        vec![
            self.source.to_owned(),
            self.images.to_string(),
            self.points.to_string(),
            self.unit_mm.map_or_else(String::new, unit),
            self.weight
                .map_or_else(|| "default".to_owned(), |weight| weight.to_string()),
        ]
    }
}

impl Row for TrackReport {
    const COLUMNS: &'static [&'static str] = &[
        "TRACK", "CLASS", "SIZE", "STATES", "IMAGES", "NEAREST", "FARTHEST", "MOVED", "MOVES",
    ];

    fn cells(&self) -> Vec<String> {
        let [length, width, height] = self.size_m;
        vec![
            self.track.clone(),
            self.class.clone(),
            format!("{length:.2} x {width:.2} x {height:.2} m"),
            self.states.to_string(),
            self.images.to_string(),
            figure(self.nearest_m, 1),
            figure(self.farthest_m, 1),
            format!("{:.1} m", self.moved_m),
            if self.moves { "yes" } else { "no" }.to_owned(),
        ]
    }
}
