//! Which frames train a field and which only measure it.

use backlot_engine::camera::Rigid;
use backlot_engine::view::Split;

/// A camera that moved less than this since the frame before sees the same picture again.
const SAME_PLACE_M: f64 = 0.1;
const SAME_HEADING_RAD: f64 = 0.005;
/// Of a standing camera's pictures one in this many is used: they add light changes and uncovered ground, not views.
const STANDING_KEEP: usize = 4;

/// Splits one camera's frames, given in time order by pose (any fixed frame from camera); `None` leaves a frame out.
///
/// Every `every`-th frame of those that moved is held out, never the first or last, and never one whose neighbour shows the
/// same picture: a standing car would turn the held-out figure into a copy test.
pub(crate) fn split_frames(poses: &[Rigid], every: usize) -> Vec<Option<Split>> {
    let stands = |i: usize| i > 0 && is_same_place(&poses[i - 1], &poses[i]);
    let mut moved = 0;
    let mut standing = 0;
    (0..poses.len())
        .map(|i| {
            if stands(i) {
                standing += 1;
                return (standing % STANDING_KEEP == 0).then_some(Split::Train);
            }
            let number = moved;
            moved += 1;
            standing = 0;
            let is_inner = i > 0 && i + 1 < poses.len();
            let is_alone = is_inner && !stands(i + 1);
            let is_due = every > 1 && number % every == every / 2;
            Some(if is_due && is_alone {
                Split::HeldOut
            } else {
                Split::Train
            })
        })
        .collect()
}

fn is_same_place(a: &Rigid, b: &Rigid) -> bool {
    a.translation_m.distance(b.translation_m) < SAME_PLACE_M
        && a.rotation.angle_between(b.rotation) < SAME_HEADING_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn drive(x_m: &[f64]) -> Vec<Rigid> {
        x_m.iter()
            .map(|&x| Rigid::from_heading(0.0, DVec3::new(x, 0.0, 0.0)))
            .collect()
    }

    #[test]
    fn every_eighth_moving_frame_is_held_out() {
        let x: Vec<f64> = (0..30).map(f64::from).collect();
        let split = split_frames(&drive(&x), 8);
        let held: Vec<usize> = (0..30)
            .filter(|&i| split[i] == Some(Split::HeldOut))
            .collect();
        assert_eq!(held, [4, 12, 20, 28]);
        assert!(split.iter().all(Option::is_some));
    }

    #[test]
    fn a_standing_car_gives_no_held_out_frame_and_few_views() {
        let mut x: Vec<f64> = (0..13).map(|i| 0.2 * f64::from(i)).collect();
        x.extend([2.4; 20]);
        let split = split_frames(&drive(&x), 8);
        let held: Vec<usize> = (0..33)
            .filter(|&i| split[i] == Some(Split::HeldOut))
            .collect();
        // Frame 12 is due, but its successors show the same picture.
        assert_eq!(held, [4]);
        assert_eq!(split[13..].iter().flatten().count(), 5);
    }

    #[test]
    fn tiny_logs_keep_all_their_frames_for_training() {
        assert_eq!(split_frames(&drive(&[0.0]), 8), [Some(Split::Train)]);
        assert!(split_frames(&[], 8).is_empty());
    }
}
