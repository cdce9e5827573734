//! Masks that name no track, damaged as segmenters damage them, matched to the tracks of a generated log.

use backlot_client::read_log::ReadLog;
use backlot_e2e::damaged_masks::{Truth, Truths, damage};
use backlot_e2e::logs;
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::ingest::{LogMasks, MaskMatching, MaskOutcome, MatchedMasks, match_masks};

/// How the masks of a log were matched, against what they are.
#[derive(Debug, Default)]
struct Score {
    intact: u32,
    right: u32,
    /// Whatever was matched to a track it does not show, or shows more than.
    wrong: Vec<String>,
    damaged: u32,
}

impl Score {
    fn of(masks: &MatchedMasks, truths: &Truths) -> Self {
        let mut score = Self::default();
        for (frame, truths) in truths.iter().enumerate() {
            for (&mask, &truth) in truths {
                let track = masks.track_of(frame, mask);
                match truth {
                    Truth::Intact(own) => {
                        score.intact += 1;
                        score.right += u32::from(track == Some(own));
                    }
                    Truth::Merged | Truth::False => score.damaged += 1,
                }
                if track.is_some() && track.map(Truth::Intact) != Some(truth) {
                    score
                        .wrong
                        .push(format!("frame {frame}: {truth:?} matched to {track:?}"));
                }
            }
        }
        score
    }

    fn finds_enough(&self) -> bool {
        self.right * 100 >= self.intact * 95
    }
}

fn matched(log: ReadLog, matching: &MaskMatching) -> MatchedMasks {
    let mut wire = log.drive_log.clone();
    wire.name = "driveLogs/crowded".to_owned();
    let drive_log = drive_log_from_wire(wire).unwrap();
    let masks = match_masks(&drive_log, &LogMasks(&log), matching, |_, _| true);
    masks.unwrap().unwrap()
}

#[test]
fn damaged_masks_are_matched_right_or_refused_but_for_one() {
    let whole = logs::crowded(5);
    let mut wrong = Vec::new();
    for seed in 11..19 {
        let mut log = copy(&whole);
        let truths = damage(&mut log, seed);
        let masks = matched(copy(&log), &MaskMatching::default());
        let score = Score::of(&masks, &truths);
        println!("seed {seed}: {score:?} {:?}", masks.counts());
        assert!(score.intact > 150 && score.damaged > 30, "{score:?}");
        assert!(score.finds_enough(), "{score:?}");
        // Every mask has an outcome, and what is not matched has a reason.
        let counts = masks.counts();
        assert_eq!(counts.values().sum::<u32>(), score.intact + score.damaged);
        let all_matched = score.right + score.wrong.len() as u32;
        assert_eq!(counts[&MaskOutcome::Matched], all_matched);
        wrong.extend(score.wrong);

        let careless = MaskMatching {
            most_of_farther: 1.0,
            most_of_nearer: 1.0,
            most_outside: 1.0,
            least_follow_iou: 0.0,
            ..MaskMatching::default()
        };
        let score = Score::of(&matched(log, &careless), &truths);
        assert!(
            !score.wrong.is_empty(),
            "merged masks pass unseen: {score:?}"
        );
    }
    // Seed 13, not solved: what is seen of the farther of two merged cars, 93 of 1,773 pixels, lies in the nearer one's hull, where
    // pixels speak for neither. Not one more may pass.
    assert_eq!(wrong, ["frame 10: Merged matched to Some(10)"]);
}

fn copy(log: &ReadLog) -> ReadLog {
    ReadLog {
        drive_log: log.drive_log.clone(),
        blobs: log.blobs.clone(),
    }
}
