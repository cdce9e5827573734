//! What the LiDAR returns in a free mask say about whose it is.
//!
//! Where a farther object is seen in a corner of a nearer one's hull, pixels speak for neither, but a return on it does: a mask
//! that holds returns of another cuboid than its own shows that object too. The scanner sits elsewhere than the camera and
//! measures at other times, so it also meets what the camera sees hidden: such a return counts only if the mask covers the
//! scanner's whole way past the mask's own cuboid, where that cuboid's object cannot be. What lies amid nearer returns was met
//! through glass.

use backlot_engine::camera::{Camera, Rigid};
use glam::{DVec2, DVec3};

use super::lidar::OWNER_MARGIN_M;
use super::object_labels::GROUND_BAND_M;
use super::object_plan::Outline;
use super::projected::ProjectedReturn;
use crate::domain::drive_log::Track;

/// Masks are believed this far inside their edges, in pixels: calibration and segmenters are off by about that.
const EDGE_PX: f64 = 1.0;

/// The returns on objects in each free mask of one image.
#[derive(Debug, Default)]
pub(super) struct MaskReturns {
    /// By the mask's index in `Overlaps::masks`.
    of_mask: Vec<Vec<Sighting>>,
}

/// A return on an object, in the camera's frame at the frame's time.
#[derive(Clone, Copy, Debug)]
struct Sighting {
    /// Index into the outlines.
    outline: usize,
    point_m: DVec3,
    scanner_m: DVec3,
}

/// An image's free masks and what else is known of it.
#[derive(Clone, Copy, Debug)]
pub(super) struct MaskedImage<'a> {
    pub camera: &'a Camera,
    /// One value a pixel, row-major.
    pub free: &'a [u16],
    /// The values that are masks, ascending.
    pub masks: &'a [u16],
    pub outlines: &'a [Outline],
    pub tracks: &'a [Track],
}

impl MaskReturns {
    /// Returns on the ground under an object are nobody's.
    pub(super) fn of(
        image: &MaskedImage<'_>,
        camera_from_world: &Rigid,
        returns: &[ProjectedReturn],
    ) -> Self {
        let mut of_mask = vec![Vec::new(); image.masks.len()];
        let mut outline_of = vec![None; image.tracks.len()];
        for (index, outline) in image.outlines.iter().enumerate() {
            outline_of[outline.track] = Some(index);
        }
        for r in returns.iter().filter(|r| !r.occluded) {
            let Some(owner) = r.owner else { continue };
            let ground_m = -image.tracks[owner.track].size_m.z / 2.0 + GROUND_BAND_M;
            let Some(outline) = outline_of[owner.track].filter(|_| owner.cuboid_m.z > ground_m)
            else {
                continue;
            };
            if let Some(mask) = image.mask_around(r.pixel) {
                of_mask[mask].push(Sighting {
                    outline,
                    point_m: camera_from_world.point(r.world_m),
                    scanner_m: camera_from_world.point(r.origin_m),
                });
            }
        }
        Self { of_mask }
    }

    /// The share of a mask's returns that prove that it shows another object than the one at the outline `own`; 0 without returns.
    pub(super) fn share_of_others(
        &self,
        image: &MaskedImage<'_>,
        (mask, own): (usize, usize),
    ) -> f64 {
        let Some(sightings) = self.of_mask.get(mask).filter(|s| !s.is_empty()) else {
            return 0.0;
        };
        let others = sightings
            .iter()
            .filter(|s| s.outline != own && image.shows(mask, own, s));
        others.count() as f64 / sightings.len() as f64
    }
}

impl MaskedImage<'_> {
    /// The mask that a pixel position lies in, off its edges.
    fn mask_around(&self, pixel: DVec2) -> Option<usize> {
        let value = self.value_at(pixel)?;
        let mask = self.masks.binary_search(&value).ok()?;
        let around = [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y];
        let inside = |step: DVec2| self.value_at(pixel + step * EDGE_PX) == Some(value);
        around.into_iter().all(inside).then_some(mask)
    }

    /// Where the pixel at a position lies in `free`, if it is in the image.
    pub(super) fn index_of(&self, position: DVec2) -> Option<usize> {
        let size = DVec2::new(f64::from(self.camera.width), f64::from(self.camera.height));
        let inside = position.cmpge(DVec2::ZERO).all() && position.cmplt(size).all();
        inside.then(|| position.y as usize * self.camera.width as usize + position.x as usize)
    }

    fn value_at(&self, position: DVec2) -> Option<u16> {
        self.index_of(position).map(|at| self.free[at])
    }

    /// Whether a return of another object can only be in the mask because the mask shows that object.
    fn shows(&self, mask: usize, own: usize, sighting: &Sighting) -> bool {
        let outline = &self.outlines[own];
        let half_m = self.tracks[outline.track].size_m / 2.0;
        let in_own = outline.camera_from_cuboid.inverse().point(sighting.point_m);
        if in_own.abs().cmple(half_m + OWNER_MARGIN_M).all() {
            return false;
        }
        // The scanner's way at the distances between which the own object is.
        let far_m = sighting.point_m.length();
        let ranges = [-1.0, 0.0, 1.0].map(|side| outline.distance_m + side * half_m.length());
        ranges
            .into_iter()
            .filter(|range_m| *range_m < far_m)
            .all(|range_m| {
                let part = range_m.max(0.0) / far_m;
                let way_m = sighting.scanner_m.lerp(sighting.point_m, part);
                let pixel = self.camera.project(way_m);
                pixel.and_then(|p| self.value_at(p)) == Some(self.masks[mask])
            })
    }
}

#[cfg(test)]
mod tests {
    use backlot_engine::camera::Distortion;
    use backlot_engine::class::ObjectClass;
    use backlot_engine::view::DepthSource;
    use glam::{DMat3, DQuat};

    use super::super::lidar::Owner;
    use super::*;

    const NEAR_M: DVec3 = DVec3::new(0.0, 0.0, 10.0);
    const FAR_M: DVec3 = DVec3::new(2.4, -1.0, 20.0);
    const NEAR: usize = 0;

    fn tracks() -> Vec<Track> {
        let track = |size_m: DVec3| Track {
            track_id: String::new(),
            class: ObjectClass::Car,
            source_class: String::new(),
            size_m,
            states: Vec::new(),
        };
        vec![track(DVec3::new(4.0, 2.0, 2.0)), track(DVec3::splat(2.0))]
    }

    /// Cuboids are upright and as wide as the image: x right, y ahead, z up.
    fn outlines() -> Vec<Outline> {
        let axes = DMat3::from_cols(DVec3::X, DVec3::Z, DVec3::NEG_Y);
        let outline = |(track, centre_m): (usize, DVec3)| Outline {
            track,
            hull: Vec::new(),
            distance_m: centre_m.length(),
            camera_from_cuboid: Rigid::new(DQuat::from_mat3(&axes), centre_m),
        };
        [NEAR_M, FAR_M]
            .into_iter()
            .enumerate()
            .map(outline)
            .collect()
    }

    /// A mask over the near object, and over a corner of its hull where the far one is seen if it is `merged`.
    fn mask(merged: bool) -> Vec<u16> {
        let value = |(x, y): (usize, usize)| match (x, y) {
            (30..58, 30..50) => 7,
            (58..68, 31..40) if merged => 7,
            _ => 0,
        };
        (0..100 * 80).map(|i| value((i % 100, i / 100))).collect()
    }

    /// Twenty returns on the near object, and these on the far one, seen by a scanner beside the camera.
    fn share(free: &[u16], far_m: &[DVec3], scanner_m: DVec3) -> f64 {
        share_if(free, far_m, scanner_m, false)
    }

    fn share_if(free: &[u16], far_m: &[DVec3], scanner_m: DVec3, occluded: bool) -> f64 {
        let camera = Camera {
            width: 100,
            height: 80,
            focal_px: DVec2::splat(100.0),
            principal_px: DVec2::new(50.0, 40.0),
            distortion: Distortion::None,
        };
        let outlines = outlines();
        let on = |(track, cuboid_m): (usize, DVec3)| {
            let world_m = outlines[track].camera_from_cuboid.point(cuboid_m);
            ProjectedReturn {
                pixel: camera.project(world_m).unwrap(),
                range_m: world_m.length(),
                world_m,
                origin_m: scanner_m,
                owner: Some(Owner { track, cuboid_m }),
                occluded: occluded && track != NEAR,
                source: DepthSource::Lidar,
                weight: 1.0,
            }
        };
        let near = (0..20).map(|i| (NEAR, DVec3::X * (0.1 * f64::from(i) - 1.5)));
        let nobodys = ProjectedReturn {
            owner: None,
            ..on((NEAR, DVec3::ZERO))
        };
        let far = far_m.iter().map(|&p| (1, p));
        let returns: Vec<_> = near.chain(far).map(on).chain([nobodys]).collect();
        let image = MaskedImage {
            camera: &camera,
            free,
            masks: &[7],
            outlines: &outlines,
            tracks: &tracks(),
        };
        let found = MaskReturns::of(&image, &Rigid::IDENTITY, &returns);
        found.share_of_others(&image, (0, NEAR))
    }

    #[test]
    fn a_merged_mask_holds_returns_of_the_object_behind() {
        let far = [-0.4, 0.0, 0.4].map(|x| DVec3::X * x);
        let beside = DVec3::new(0.1, -0.3, 0.0);
        assert_eq!(share(&mask(true), &far, beside), 3.0 / 23.0);
        assert_eq!(share(&mask(false), &far, beside), 0.0);
        assert_eq!(share(&mask(true), &[], beside), 0.0);
        assert_eq!(share_if(&mask(true), &far, beside, true), 0.0, "glass");
        // Under the object is ground.
        let ground = [DVec3::new(0.0, 0.0, -0.9)];
        assert_eq!(share(&mask(true), &ground, beside), 0.0);
        // A mask without returns.
        assert_eq!(share(&vec![0; 100 * 80], &far, beside), 0.0);
    }

    #[test]
    fn what_only_the_scanner_sees_past_the_object_is_not_in_its_mask() {
        // The camera sees the near object where this return is.
        let hidden = [DVec3::new(-2.0, 0.0, -0.7)];
        let beside = DVec3::new(0.1, -0.1, 0.0);
        assert!(share(&mask(false), &hidden, beside) > 0.0);
        let far_off = DVec3::new(6.0, 0.0, 0.0);
        assert_eq!(share(&mask(false), &hidden, far_off), 0.0);
    }

    #[test]
    fn returns_where_two_cuboids_overlap_are_the_masks_own() {
        // Found in the far cuboid, and half a metre above the middle of the near one.
        let shared = [DVec3::new(-2.4, -10.0, -0.5)];
        assert_eq!(share(&mask(false), &shared, DVec3::ZERO), 0.0);
    }
}
