//! Masks that name no track, damaged as segmenters damage them, matched to the tracks of a generated log.

use backlot_client::read_log::ReadLog;
use backlot_e2e::damaged_masks::{Truths, damage};
use backlot_e2e::logs;
use backlot_e2e::mask_score::{Score, matched};
use backlot_server::ingest::{MaskMatching, MaskOutcome};

const SEEDS: std::ops::Range<u64> = 11..19;

#[test]
fn damaged_masks_are_matched_right_or_refused() {
    let careless = MaskMatching {
        most_of_farther: 1.0,
        most_of_nearer: 1.0,
        most_outside: 1.0,
        least_follow_iou: 0.0,
        ..by_pixels()
    };
    for (seed, log, truths) in damaged_logs() {
        let masks = matched(&log, &MaskMatching::default());
        let score = Score::of(&masks, &truths);
        println!("seed {seed}: {score:?} {:?}", masks.counts());
        assert!(score.intact > 150 && score.damaged > 30, "{score:?}");
        assert!(score.finds_enough(), "{score:?}");
        assert_eq!(score.wrong, [""; 0], "seed {seed}");
        // Every mask has an outcome, and what is not matched has a reason.
        let counts = masks.counts();
        assert_eq!(counts.values().sum::<u32>(), score.intact + score.damaged);
        assert_eq!(counts[&MaskOutcome::Matched], score.right);

        let score = Score::of(&matched(&log, &careless), &truths);
        assert!(
            !score.wrong.is_empty(),
            "merged masks pass unseen: {score:?}"
        );
    }
}

/// What is seen of the farther of two merged cars may lie in the nearer one's hull: there returns tell, and the frames beside.
#[test]
fn returns_and_neighbouring_frames_each_tell_what_pixels_cannot() {
    let only_returns = MaskMatching {
        most_grown: 1.0,
        ..MaskMatching::default()
    };
    let mut wrong_by_pixels = 0;
    for (seed, mut log, truths) in damaged_logs() {
        let score =
            |log: &ReadLog, matching: &MaskMatching| Score::of(&matched(log, matching), &truths);
        wrong_by_pixels += score(&log, &by_pixels()).wrong.len();
        let of_returns = score(&log, &only_returns);
        log.drive_log.sweeps.clear();
        let of_neighbours = score(&log, &MaskMatching::default());
        for score in [of_returns, of_neighbours] {
            assert_eq!(score.wrong, [""; 0], "seed {seed}");
            assert!(score.finds_enough(), "{score:?}");
        }
    }
    assert!(wrong_by_pixels > 0, "nothing was left to them");
}

/// The overlap of masks and hulls alone.
fn by_pixels() -> MaskMatching {
    MaskMatching {
        most_returns_of_others: 1.0,
        most_grown: 1.0,
        ..MaskMatching::default()
    }
}

fn damaged_logs() -> impl Iterator<Item = (u64, ReadLog, Truths)> {
    let whole = logs::crowded(5);
    SEEDS.map(move |seed| {
        let mut log = logs::copy(&whole);
        let truths = damage(&mut log, seed);
        (seed, log, truths)
    })
}
