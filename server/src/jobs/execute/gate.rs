//! The quality gate: which objects may be placed anywhere, and which only replay their own track.

use backlot_engine::quality::{QualityReport, ViewCoverage};

/// Worse reconstructions are recognisably wrong beside real cars.
const LEAST_PSNR_DB: f64 = 18.0;
/// Less opaque objects look translucent in front of a bright road.
const LEAST_ACCUMULATION: f64 = 0.85;
/// More haze around the object shows as a veil.
const MOST_HALO: f64 = 0.2;
/// Sectors of 15 degrees: one alone is a cardboard front.
const LEAST_SECTORS: usize = 2;

/// Why an object is replay-only; `None` if it may join the library.
pub(super) fn replay_only_reason(
    quality: &QualityReport,
    coverage: &ViewCoverage,
) -> Option<String> {
    let mut reasons = Vec::new();
    match quality.psnr_held_out.or(quality.psnr_train) {
        Some(psnr) if psnr >= LEAST_PSNR_DB => {}
        Some(psnr) => reasons.push(format!("{psnr:.1} dB, {LEAST_PSNR_DB} needed")),
        None => reasons.push("its quality is not known".to_owned()),
    }
    if let Some(opaque) = quality.accumulation_in_mask
        && opaque < LEAST_ACCUMULATION
    {
        reasons.push(format!("opacity {opaque:.2}, {LEAST_ACCUMULATION} needed"));
    }
    if let Some(halo) = quality.halo
        && halo > MOST_HALO
    {
        reasons.push(format!("halo {halo:.2}, at most {MOST_HALO} allowed"));
    }
    let sectors = (0..coverage.azimuth_views.len())
        .filter(|&s| coverage.azimuth_views[s] > 0 || coverage.azimuth_mirrored[s])
        .count();
    if sectors < LEAST_SECTORS {
        reasons.push(format!(
            "seen from {sectors} of 24 sides, {LEAST_SECTORS} needed"
        ));
    }
    (!reasons.is_empty()).then(|| reasons.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn coverage(sectors: usize) -> ViewCoverage {
        let mut coverage = ViewCoverage::default();
        coverage.azimuth_views[..sectors].fill(3);
        coverage
    }

    fn good() -> QualityReport {
        QualityReport {
            psnr_held_out: Some(26.0),
            accumulation_in_mask: Some(0.97),
            halo: Some(0.03),
            ..Default::default()
        }
    }

    #[test]
    fn the_gate_names_every_failing_figure() {
        assert_eq!(replay_only_reason(&good(), &coverage(3)), None);
        let translucent = QualityReport {
            accumulation_in_mask: Some(0.5),
            psnr_held_out: Some(15.0),
            ..good()
        };
        let reason = replay_only_reason(&translucent, &coverage(1)).unwrap();
        for part in ["15.0 dB", "opacity 0.50", "1 of 24 sides"] {
            assert!(reason.contains(part), "{reason}");
        }
        assert!(replay_only_reason(&QualityReport::default(), &coverage(3)).is_some());
    }
}
