//! How a log's free masks were matched, against what they are.

use backlot_client::read_log::ReadLog;
use backlot_server::api::convert_drive_log::drive_log_from_wire;
use backlot_server::ingest::{LogMasks, MaskMatching, MatchedMasks, match_masks};

use crate::damaged_masks::{Truth, Truths};

/// Counts over all frames.
#[derive(Debug, Default)]
pub struct Score {
    pub intact: u32,
    pub right: u32,
    /// Whatever was matched to a track it does not show, or shows more than.
    pub wrong: Vec<String>,
    pub damaged: u32,
}

impl Score {
    pub fn of(masks: &MatchedMasks, truths: &Truths) -> Self {
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

    pub fn finds_enough(&self) -> bool {
        self.right * 100 >= self.intact * 95
    }

    pub fn add(&mut self, other: Self) {
        self.intact += other.intact;
        self.right += other.right;
        self.damaged += other.damaged;
        self.wrong.extend(other.wrong);
    }
}

/// The log's masks as the server matches them.
///
/// # Panics
/// If the log is none.
pub fn matched(log: &ReadLog, matching: &MaskMatching) -> MatchedMasks {
    let mut wire = log.drive_log.clone();
    wire.name = "driveLogs/crowded".to_owned();
    let drive_log = drive_log_from_wire(wire).expect("a generated log is valid");
    let masks = match_masks(&drive_log, log, &LogMasks(log), matching, |_, _| true);
    masks
        .expect("its masks are there")
        .expect("nothing stops it")
}
