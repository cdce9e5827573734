//! Where the objects that a recipe places are during a clip, tested against everything else in it.

use glam::{DVec2, DVec3};

use super::acceptance::CLEARANCE_M;
use super::collision::Occupied;
use super::composition::{PlacedObject, Stage};
use super::footprint::{Footprint, GroundPlane};
use super::originals::pose_at;
use super::placement::{FOOTPRINT_MARGIN_M, ego_box};
use super::rejection::Rejection;
use super::timeline::{Instant, instants, recorded_velocity};
use super::valid_region::{Cell, ValidRegion};
use crate::camera::Rigid;

/// A placed object through a clip.
#[derive(Clone, Debug)]
pub(super) struct Movement {
    /// At the first frame.
    pub(super) object: PlacedObject,
    /// At each instant; `None` where it is not there.
    pub(super) poses: Vec<Option<Rigid>>,
}

/// What stands and drives in a clip.
#[derive(Debug)]
pub(super) struct ClipSpace<'a> {
    stage: Stage<'a>,
    /// Indices into the recording's frames; the first is the composition's.
    pub(super) frames: Vec<usize>,
    pub(super) instants: Vec<Instant>,
    /// Accepted so far, in the order of the composition's placed objects.
    pub(super) movements: Vec<Movement>,
    /// Tracks not shown where they were recorded.
    pub(super) absent: Vec<usize>,
}

/// How an object gets from its first pose to the later ones.
#[derive(Clone, Copy, Debug)]
pub(super) enum Course {
    /// Straight on at this speed.
    Straight { speed_mps: f64 },
    /// As the track drives, displaced in the track's frame.
    Slot {
        track: usize,
        track_from_object: Rigid,
    },
}

impl<'a> ClipSpace<'a> {
    pub(super) fn new(stage: Stage<'a>, frames: Vec<usize>) -> Self {
        let instants = instants(stage.recording, &frames);
        Self {
            stage,
            frames,
            instants,
            movements: Vec::new(),
            absent: Vec::new(),
        }
    }

    /// An object placed at the first frame, driven on from there.
    pub(super) fn drive(
        &self,
        mut object: PlacedObject,
        course: Course,
    ) -> Result<Movement, Rejection> {
        let start = object.local_from_object;
        let slot = match course {
            Course::Slot { track, .. } => Some(track),
            Course::Straight { .. } => None,
        };
        let mut poses = vec![Some(start)];
        for instant in &self.instants[1..] {
            poses.push(match course {
                Course::Straight { speed_mps: 0.0 } => Some(start),
                Course::Straight { speed_mps } => {
                    let heading = start.heading_rad();
                    let (sin, cos) = libm::sincos(heading);
                    let way = DVec2::new(cos, sin) * (speed_mps * instant.time_s);
                    let at = start.translation_m.truncate() + way;
                    Some(self.stand(at, heading, object.size_m, None)?)
                }
                Course::Slot {
                    track,
                    track_from_object,
                } => self
                    .recorded(track, instant)
                    .map(|pose| pose * track_from_object),
            });
        }
        object.velocity_mps = match course {
            Course::Straight { speed_mps } => Some(start.direction(DVec3::X) * speed_mps),
            Course::Slot { track, .. } => self.velocity_of(track, self.frames[0]),
        };
        self.test(&object, &poses, slot, 1)?;
        Ok(Movement { object, poses })
    }

    /// An object whose place at each instant is given; it stands on the ground that the log saw, or on which `track` drove.
    ///
    /// `still` is the velocity in a single image whose place does not change.
    pub(super) fn along(
        &self,
        mut object: PlacedObject,
        track: Option<usize>,
        still: Option<DVec3>,
        place: impl Fn(&Instant) -> Option<(DVec2, f64)>,
    ) -> Result<Movement, Rejection> {
        let stand = |instant: &Instant| {
            let Some((at, heading)) = place(instant) else {
                return Ok(None);
            };
            self.stand(at, heading, object.size_m, track).map(Some)
        };
        let poses = self.instants.iter().map(stand);
        let poses = poses.collect::<Result<Vec<_>, Rejection>>()?;
        let first = poses[0].ok_or(Rejection::OutOfView)?;
        object.local_from_object = first;
        let soon = Instant {
            time_s: VELOCITY_STEP_S,
            ..self.instants[0]
        };
        object.velocity_mps = match self.instants.len() {
            1 => match (place(&self.instants[0]), place(&soon)) {
                (Some((from, _)), Some((to, _))) if from != to => {
                    Some(((to - from) / VELOCITY_STEP_S).extend(0.0))
                }
                _ => still,
            },
            _ => self.velocity(&poses, 0),
        };
        self.test(&object, &poses, track, 0)?;
        Ok(Movement { object, poses })
    }

    pub(super) fn accept(&mut self, movement: Movement) {
        self.movements.push(movement);
    }

    /// Gives the movements the ids of the first frame's objects.
    pub(super) fn name(&mut self, objects: &[PlacedObject]) {
        let placed = objects.iter().filter(|o| !o.origin.is_as_recorded());
        for (movement, object) in self.movements.iter_mut().zip(placed) {
            movement.object.instance_id = object.instance_id;
        }
    }

    /// The object of a movement as it is at frame `k` of the clip; `None` where it is not there.
    pub(super) fn at_frame(&self, movement: &Movement, k: usize) -> Option<PlacedObject> {
        if k == 0 {
            return Some(movement.object.clone());
        }
        let is_frame = |i: &Instant| i.before == self.frames[k] && i.after == i.before;
        let instant = self.instants.iter().position(is_frame);
        let instant = instant.expect("every frame of the clip is an instant");
        Some(PlacedObject {
            local_from_object: movement.poses[instant]?,
            velocity_mps: self.velocity(&movement.poses, instant),
            ..movement.object.clone()
        })
    }

    pub(super) fn velocity_of(&self, track: usize, frame: usize) -> Option<DVec3> {
        let recording = self.stage.recording;
        recorded_velocity(recording, &recording.tracks[track], frame)
    }

    /// From the instants before and after.
    fn velocity(&self, poses: &[Option<Rigid>], instant: usize) -> Option<DVec3> {
        let there = |i: &usize| poses.get(*i).is_some_and(Option::is_some);
        let from = Some(instant.wrapping_sub(1))
            .filter(there)
            .unwrap_or(instant);
        let to = Some(instant + 1).filter(there).unwrap_or(instant);
        let span_s = self.instants[to].time_s - self.instants[from].time_s;
        let way = poses[to]?.translation_m - poses[from]?.translation_m;
        (span_s > 0.0).then(|| way / span_s)
    }

    fn recorded(&self, track: usize, instant: &Instant) -> Option<Rigid> {
        let track = &self.stage.recording.tracks[track];
        instant.pose(|frame| track.local_from_cuboid[frame])
    }

    /// The pose of an object that stands at a place.
    fn stand(
        &self,
        at: DVec2,
        heading: f64,
        size_m: DVec3,
        track: Option<usize>,
    ) -> Result<Rigid, Rejection> {
        let footprint = Footprint::new(at, heading, size_m).grown(FOOTPRINT_MARGIN_M);
        let region = self.stage.region;
        let plane = match (region.support(&footprint), track) {
            (Ok(plane), _) => plane,
            (Err(reason), None) => return Err(reason.into()),
            (Err(_), Some(track)) => self.driven_ground(&footprint, track)?,
        };
        Ok(plane.stand(at, heading, size_m.z))
    }

    /// The ground under a footprint, known from the region and from where the track itself drove: training left that out with the track,
    /// so that the region may call it unseen.
    fn driven_ground(&self, footprint: &Footprint, track: usize) -> Result<GroundPlane, Rejection> {
        let track = &self.stage.recording.tracks[track];
        let driven: Vec<(Footprint, Rigid)> = track
            .local_from_cuboid
            .iter()
            .flatten()
            .map(|pose| (Footprint::of_cuboid(pose, track.size_m), *pose))
            .collect();
        let region = self.stage.region;
        let points = footprint.points(region.cell_m * 0.5).map(|p| {
            let seen = region
                .index_at(p)
                .filter(|i| region.cells[*i] == Cell::Free);
            if let Some(index) = seen {
                return Ok(region.centre(index).extend(region.ground_m[index]));
            }
            let under = driven
                .iter()
                .find(|(f, _)| f.grown(DRIVEN_MARGIN_M).contains(p));
            let (_, pose) = under.ok_or_else(|| unsupported(region, p))?;
            Ok(p.extend(bottom_height(pose, track.size_m.z, p)))
        });
        let points = points.collect::<Result<Vec<DVec3>, Rejection>>()?;
        GroundPlane::fit(&points).ok_or(Rejection::Unseen)
    }

    /// Whether an object touches nothing at any instant from number `first` on. `slot` is the track whose place it takes.
    fn test(
        &self,
        object: &PlacedObject,
        poses: &[Option<Rigid>],
        slot: Option<usize>,
        first: usize,
    ) -> Result<(), Rejection> {
        for (i, pose) in poses.iter().enumerate().skip(first) {
            let Some(pose) = *pose else { continue };
            let occupied = Occupied {
                local_from_cuboid: pose,
                size_m: object.size_m,
            };
            let instant = &self.instants[i];
            if occupied.collides(&self.ego(instant), CLEARANCE_M) {
                return Err(Rejection::CollidesEgo);
            }
            let hits = |other: &Movement| {
                other.poses[i].is_some_and(|pose| {
                    let other = Occupied {
                        local_from_cuboid: pose,
                        size_m: other.object.size_m,
                    };
                    occupied.collides(&other, CLEARANCE_M)
                })
            };
            if self.movements.iter().any(hits) {
                return Err(Rejection::CollidesPlaced);
            }
            if self.hits_original(&occupied, instant, slot) {
                return Err(Rejection::CollidesOriginal);
            }
        }
        Ok(())
    }

    fn hits_original(&self, occupied: &Occupied, instant: &Instant, slot: Option<usize>) -> bool {
        let tracks = self.stage.recording.tracks.iter().enumerate();
        let mut staying = tracks.filter(|(i, _)| Some(*i) != slot && !self.absent.contains(i));
        staying.any(|(_, track)| {
            let pose = instant.pose(|frame| pose_at(track, frame));
            pose.is_some_and(|local_from_cuboid| {
                let original = Occupied {
                    local_from_cuboid,
                    size_m: track.size_m,
                };
                occupied.collides(&original, CLEARANCE_M)
            })
        })
    }

    fn ego(&self, instant: &Instant) -> Occupied {
        let frames = &self.stage.recording.frames;
        let pose = instant.pose(|frame| Some(frames[frame].local_from_ego));
        ego_box(&pose.expect("every frame has an ego pose"))
    }
}

/// Between these, a trajectory's direction is its velocity.
const VELOCITY_STEP_S: f64 = 0.05;
/// Boxes are this wrong at their edges, metres.
const DRIVEN_MARGIN_M: f64 = 0.3;

/// Height of the plane of a cuboid's bottom over a point.
fn bottom_height(pose: &Rigid, height_m: f64, p: DVec2) -> f64 {
    let up = pose.direction(DVec3::Z);
    let foot = pose.point(DVec3::new(0.0, 0.0, -0.5 * height_m));
    foot.z - (up.truncate().dot(p - foot.truncate())) / up.z
}

fn unsupported(region: &ValidRegion, p: DVec2) -> Rejection {
    match region.cell_at(p) {
        Cell::Blocked => Rejection::Blocked,
        Cell::Uneven => Rejection::Uneven,
        Cell::Free | Cell::Unseen => Rejection::Unseen,
    }
}
