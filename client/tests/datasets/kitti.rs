//! The readers of KITTI.

use std::path::Path;

use backlot_client::log_format::{LogFormat, LogInputs};
use backlot_client::read_log::ReadLog;
use tempfile::TempDir;

use crate::kitti_files::{ASSUMED_STEP_NS, DRIVE, synchronous, write_raw_log, write_tracking_log};
use crate::same_log::{Comparison, Deviation, FLAWS, LIMITS, deviation};

/// The two forms; both number the tracks in the order of the log.
#[derive(Clone, Copy, Debug)]
enum Form {
    Raw,
    Tracking,
}

impl Form {
    fn there_and_back(self, log: &ReadLog) -> Deviation {
        let folder = TempDir::new().expect("a temporary folder");
        let mut got = match self {
            Self::Raw => {
                write_raw_log(log, folder.path());
                read(LogFormat::KittiRaw, &folder.path().join(DRIVE))
            }
            Self::Tracking => {
                write_tracking_log(log, folder.path());
                read(LogFormat::KittiTracking, folder.path())
            }
        };
        let expected = synchronous();
        let times: Vec<i64> = expected
            .drive_log
            .frames
            .iter()
            .map(|f| f.timestamp_ns)
            .collect();
        if matches!(self, Self::Tracking) {
            restore_times(&mut got, &times);
        }
        let number = |id: &str| {
            let mut tracks = expected.drive_log.tracks.iter();
            tracks
                .position(|t| t.track_id == id)
                .expect("a track of the street")
                .to_string()
        };
        let how = Comparison {
            box_times_ns: &times,
            camera_id: &str::to_owned,
            track_id: &number,
        };
        deviation(&expected, &got, &how)
    }
}

fn read(format: LogFormat, path: &Path) -> ReadLog {
    let inputs = LogInputs {
        path: path.to_owned(),
        ..LogInputs::default()
    };
    format.read(&inputs).expect("the log reads")
}

/// The benchmark has no timestamps: frame `i` is read at `i` assumed steps.
fn restore_times(log: &mut ReadLog, times: &[i64]) {
    let restored = |ns: &mut i64| {
        assert_eq!(*ns % ASSUMED_STEP_NS, 0, "a frame's time");
        *ns = times[(*ns / ASSUMED_STEP_NS) as usize];
    };
    let log = &mut log.drive_log;
    log.frames
        .iter_mut()
        .for_each(|f| restored(&mut f.timestamp_ns));
    log.sweeps
        .iter_mut()
        .for_each(|s| restored(&mut s.timestamp_ns));
    log.world_from_ego
        .iter_mut()
        .for_each(|p| restored(&mut p.timestamp_ns));
    let states = log.tracks.iter_mut().flat_map(|t| &mut t.states);
    states.for_each(|s| restored(&mut s.timestamp_ns));
}

#[test]
fn a_log_comes_back_the_same() {
    for form in [Form::Raw, Form::Tracking] {
        let found = form.there_and_back(&synchronous());
        println!("kitti, {form:?}: {found:?}");
        assert!(found.is_within(&LIMITS), "{form:?}: {found:?}");
    }
}

#[test]
fn logs_that_differ_are_told_apart() {
    for form in [Form::Raw, Form::Tracking] {
        for (flaw, break_it) in FLAWS {
            // The world of a drive begins at its first frame, wherever that is, and the scanner is the origin of its ego frame;
            // the tracking benchmark has no times.
            let unseen = flaw.starts_with("ego") || flaw.starts_with("scanner");
            let untimed = matches!(form, Form::Tracking) && flaw.starts_with("images");
            if unseen || untimed {
                continue;
            }
            let mut log = synchronous();
            break_it(&mut log.drive_log);
            let found = form.there_and_back(&log);
            assert!(!found.is_within(&LIMITS), "{form:?}, {flaw}: {found:?}");
        }
        // Instead: a vehicle that is 2 mm further on at one frame.
        let mut log = synchronous();
        let at = log.drive_log.frames[2].timestamp_ns;
        for pose in log
            .drive_log
            .world_from_ego
            .iter_mut()
            .filter(|p| p.timestamp_ns >= at)
        {
            let t = pose.pose.as_mut().and_then(|p| p.translation_m.as_mut());
            t.expect("a pose").x += 2e-3;
        }
        let found = form.there_and_back(&log);
        assert!(!found.is_within(&LIMITS), "{form:?}, ego: {found:?}");
    }
}
