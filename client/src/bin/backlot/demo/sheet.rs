//! The contact sheet of a run.

use std::path::Path;

use backlot_client::picture::{Tile, contact_sheet, draw_boxes};
use backlot_proto::v1;

use super::exact::ExactComparison;
use super::source::Source;
use super::{figures, sample_boxes};

/// Writes `contact_sheet.png`: each recorded frame beside its sample, boxes drawn.
pub(crate) fn write(
    source: &Source,
    samples: &[v1::Sample],
    exact: &[ExactComparison],
    out: &Path,
) -> anyhow::Result<()> {
    let mut pairs = Vec::new();
    for sample in samples {
        let frame = &sample.frames[0];
        let recorded = source.image(source.frame(frame.frame_index)?)?;
        let name = format!("{:06}.png", sample.index);
        let mut augmented = figures::read_rgb(&out.join("images").join(name))?;
        draw_boxes(&mut augmented, sample, frame);
        let comparison = exact.iter().find(|e| e.index == sample.index);
        pairs.push([
            Tile {
                image: recorded,
                caption: format!("recorded frame {}", frame.frame_index),
            },
            Tile {
                image: augmented,
                caption: caption(sample, comparison),
            },
        ]);
    }
    let log = &source.log.drive_log;
    let kind = if log.synthetic {
        "synthetic"
    } else {
        "recorded"
    };
    let title = format!(
        "backlot demo, {} ({kind}): green inserted, orange replaced or moved, blue replayed original, white static original",
        log.dataset
    );
    contact_sheet(&title, &pairs).save(out.join("contact_sheet.png"))?;
    Ok(())
}

fn caption(sample: &v1::Sample, exact: Option<&ExactComparison>) -> String {
    let boxes = sample_boxes(sample);
    let counts = boxes.iter().map(|(origin, n)| format!("{n} {origin}"));
    let mut caption = format!(
        "sample {}: {}",
        sample.index,
        counts.collect::<Vec<_>>().join(", ")
    );
    if let Some(exact) = exact {
        caption += &format!(", {:.1} db against exact", exact.psnr);
    }
    caption
}
