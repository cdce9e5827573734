//! The recorded frames of a clip, and the instants between them at which its objects are tested.

use glam::DVec3;
use serde::{Deserialize, Serialize};

use super::recording::{RecordedTrack, Recording};
use crate::camera::Rigid;
use crate::{Error, Result};

/// How many frames a sample has and how its objects move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Clip {
    /// 1 is a single image.
    pub frames: u32,
    /// Recorded frames of the camera from one frame of the clip to the next.
    pub stride: u32,
    /// Speeds of inserted objects along their heading are drawn evenly from this range.
    pub speed_mps: [f64; 2],
}

/// Frames of one clip: two nuScenes scenes' key frames, four seconds of KITTI.
pub const MAX_CLIP_FRAMES: u32 = 40;
/// Faster is no traffic.
const MAX_SPEED_MPS: f64 = 60.0;
/// Longer is no clip: every tenth of a second of it is tested at every attempt.
const MAX_CLIP_NS: u64 = 120_000_000_000;
/// At 15 m/s a car moves a third of its length in this time; over 40 m/s it may pass through another between two tests.
const TEST_STEP_S: f64 = 0.1;
/// Poses further apart in time say nothing of the speed between them.
const MAX_VELOCITY_SPAN_S: f64 = 1.5;

impl Default for Clip {
    fn default() -> Self {
        Self {
            frames: 1,
            stride: 1,
            speed_mps: [0.0; 2],
        }
    }
}

impl Clip {
    /// # Errors
    /// [`Error::Invalid`] naming the field.
    pub fn validate(&self) -> Result<()> {
        if self.frames == 0 || self.frames > MAX_CLIP_FRAMES {
            return Err(Error::invalid(format!(
                "recipe: clip.frame_count {} is not 1 to {MAX_CLIP_FRAMES}",
                self.frames
            )));
        }
        if self.stride == 0 {
            return Err(Error::invalid("recipe: clip.stride must be at least 1"));
        }
        let [low, high] = self.speed_mps;
        if !(0.0 <= low && low <= high && high <= MAX_SPEED_MPS) {
            return Err(Error::invalid(format!(
                "recipe: clip speeds {low}..{high} m/s are not an ascending range within 0..={MAX_SPEED_MPS}"
            )));
        }
        Ok(())
    }

    /// The recorded frames of the clip that begins at frame `first`: indices into [`Recording::frames`]. `None` if the log ends before,
    /// or the clip would last over two minutes.
    pub fn frames_from(&self, recording: &Recording, first: usize) -> Option<Vec<usize>> {
        let camera_id = &recording.frames[first].camera_id;
        let own = (first..recording.frames.len())
            .filter(|i| recording.frames[*i].camera_id == *camera_id);
        let frames: Vec<usize> = own
            .step_by(self.stride as usize)
            .take(self.frames as usize)
            .collect();
        let time_ns = |i: &usize| recording.frames[*i].timestamp_ns;
        let span_ns = time_ns(frames.last()?).abs_diff(time_ns(frames.first()?));
        (frames.len() == self.frames as usize && span_ns <= MAX_CLIP_NS).then_some(frames)
    }
}

/// A time of a clip, between two recorded frames of its camera or at one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Instant {
    /// Since the clip's first frame.
    pub(super) time_s: f64,
    /// Indices into [`Recording::frames`]; the same at a frame.
    pub(super) before: usize,
    pub(super) after: usize,
    /// 0 at `before`, 1 at `after`.
    pub(super) fraction: f64,
}

impl Instant {
    /// A pose between those at two frames; where only one is known, that one.
    pub(super) fn pose(&self, at: impl Fn(usize) -> Option<Rigid>) -> Option<Rigid> {
        match (at(self.before), at(self.after)) {
            (Some(before), Some(after)) if self.fraction > 0.0 => {
                Some(between(&before, &after, self.fraction))
            }
            (before, after) => before.or(after),
        }
    }
}

/// Linear in translation and, without the platform's trigonometry, in the quaternion: frames are a fraction of a second apart.
fn between(before: &Rigid, after: &Rigid, fraction: f64) -> Rigid {
    Rigid::new(
        before.rotation.lerp(after.rotation, fraction),
        before.translation_m.lerp(after.translation_m, fraction),
    )
}

/// The instants of a clip in order: every frame of `frames`, every recorded frame of the camera between them, and enough between those
/// that no two are further apart than [`TEST_STEP_S`].
pub(super) fn instants(recording: &Recording, frames: &[usize]) -> Vec<Instant> {
    let (first, last) = (frames[0], frames[frames.len() - 1]);
    let camera_id = &recording.frames[first].camera_id;
    let own: Vec<usize> = (first..=last)
        .filter(|i| recording.frames[*i].camera_id == *camera_id)
        .collect();
    let time = |frame: usize| {
        let since = recording.frames[frame].timestamp_ns - recording.frames[first].timestamp_ns;
        since as f64 * 1e-9
    };
    let at = |frame: usize| Instant {
        time_s: time(frame),
        before: frame,
        after: frame,
        fraction: 0.0,
    };
    let mut instants = vec![at(first)];
    for pair in own.windows(2) {
        let (from, to) = (time(pair[0]), time(pair[1]));
        // A hair under the step, so that frames a rounding error further apart than it get nothing between them.
        let steps = libm::ceil((to - from) / TEST_STEP_S - 1e-6).max(1.0) as u32;
        instants.extend((1..steps).map(|i| {
            let fraction = f64::from(i) / f64::from(steps);
            Instant {
                time_s: from + fraction * (to - from),
                before: pair[0],
                after: pair[1],
                fraction,
            }
        }));
        instants.push(at(pair[1]));
    }
    instants
}

/// Velocity of a track at a frame, in the recording's frame, from its poses in the frames of the same camera before and after.
/// `None` if they are too far apart in time or there is only one; zero for tracks that never move.
pub(super) fn recorded_velocity(
    recording: &Recording,
    track: &RecordedTrack,
    frame: usize,
) -> Option<DVec3> {
    if !track.moving {
        return Some(DVec3::ZERO);
    }
    let camera_id = &recording.frames[frame].camera_id;
    let posed = |i: &usize| {
        recording.frames[*i].camera_id == *camera_id && track.local_from_cuboid[*i].is_some()
    };
    let before = (0..frame).rev().find(posed);
    let after = (frame + 1..recording.frames.len()).find(posed);
    let from = before.unwrap_or(frame);
    let to = after.unwrap_or(frame);
    let at = |i: usize| track.local_from_cuboid[i].map(|p| p.translation_m);
    let span_ns = recording.frames[to].timestamp_ns - recording.frames[from].timestamp_ns;
    let span_s = span_ns as f64 * 1e-9;
    if span_s <= 0.0 || span_s > MAX_VELOCITY_SPAN_S {
        return None;
    }
    Some((at(to)? - at(from)?) / span_s)
}

#[cfg(test)]
mod tests {
    use super::super::box_world::{drive, street_car};
    use super::*;

    #[test]
    fn a_clip_has_its_frames_and_tests_between_them() {
        let mut recording = drive(0.0, 10, 1.0);
        for (i, frame) in recording.frames.iter_mut().enumerate() {
            frame.timestamp_ns = i as i64 * 250_000_000;
        }
        let clip = Clip {
            frames: 3,
            stride: 2,
            ..Clip::default()
        };
        let frames = clip.frames_from(&recording, 3).unwrap();
        assert_eq!(frames, [3, 5, 7]);
        assert_eq!(clip.frames_from(&recording, 6), None, "the log ends");
        let instants = instants(&recording, &frames);
        let times: Vec<f64> = instants.iter().map(|i| i.time_s).collect();
        assert_eq!((times[0], times[times.len() - 1]), (0.0, 1.0));
        assert!(times.windows(2).all(|t| t[1] > t[0] && t[1] - t[0] < 0.101));
        let at_frames: Vec<usize> = instants
            .iter()
            .filter(|i| i.before == i.after)
            .map(|i| i.before)
            .collect();
        assert_eq!(at_frames, [3, 4, 5, 6, 7]);
        let middle = instants.iter().find(|i| i.fraction > 0.3).unwrap();
        let ego = middle.pose(|f| Some(recording.frames[f].local_from_ego));
        let x = ego.unwrap().translation_m.x;
        assert!((x - 3.0 - middle.time_s / 0.25).abs() < 1e-12, "{x}");
    }

    #[test]
    fn tracks_have_the_speed_they_were_recorded_with() {
        let recording = drive(0.0, 5, 1.0);
        let mut track = street_car(&recording, "a", DVec3::ZERO, true);
        for (i, pose) in track.local_from_cuboid.iter_mut().enumerate() {
            let x = 0.8 * i as f64;
            *pose = Some(Rigid::from_heading(0.0, DVec3::new(x, 2.0, 0.5)));
        }
        for frame in 0..5 {
            let velocity = recorded_velocity(&recording, &track, frame).unwrap();
            assert!((velocity - DVec3::X * 8.0).length() < 1e-9, "{velocity}");
        }
        track.local_from_cuboid[1..].fill(None);
        assert_eq!(recorded_velocity(&recording, &track, 0), None);
        track.moving = false;
        assert_eq!(recorded_velocity(&recording, &track, 0), Some(DVec3::ZERO));
    }

    #[test]
    fn bad_clips_are_named() {
        let says = |clip: Clip| clip.validate().unwrap_err().to_string();
        let clip = Clip::default();
        assert!(says(Clip { frames: 0, ..clip }).contains("frame_count 0"));
        assert!(says(Clip { stride: 0, ..clip }).contains("stride"));
        let reversed = [3.0, 1.0];
        assert!(
            says(Clip {
                speed_mps: reversed,
                ..clip
            })
            .contains("speeds 3..1")
        );
        clip.validate().unwrap();
    }
}
