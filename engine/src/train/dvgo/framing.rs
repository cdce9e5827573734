//! What the cameras frame: the recipe's near and far distances and the box of the coarse stage.

use glam::{DVec2, DVec3};

use crate::train::bounded::nearest_to_axes;
use crate::view::{Split, TrainView};
use crate::{Error, Result};

/// The recipe's data sets have near 2 and far 6, seen by cameras this far from the scene's centre: sqrt(16.25).
const REFERENCE_DISTANCE: f64 = 4.031_128_874;
const REFERENCE_NEAR: f64 = 2.0;
const REFERENCE_FAR: f64 = 6.0;
const STRIDE_PX: usize = 4;

/// Distances along the optical axis, in metres, between which the scene lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Framing {
    pub(super) near_m: f64,
    pub(super) far_m: f64,
}

impl Framing {
    /// The reference data sets' near and far, scaled to the cameras' median distance from the point their axes pass nearest.
    pub(super) fn of(views: &[TrainView]) -> Self {
        let train: Vec<&TrainView> = views.iter().filter(|v| v.split == Split::Train).collect();
        let centre = nearest_to_axes(&train);
        let eyes = train.iter().map(|v| v.local_from_camera.translation_m);
        let mut distances: Vec<f64> = eyes.map(|eye| eye.distance(centre)).collect();
        distances.sort_by(f64::total_cmp);
        let middle = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
        let scale = middle / REFERENCE_DISTANCE;
        Self {
            near_m: REFERENCE_NEAR * scale,
            far_m: REFERENCE_FAR * scale,
        }
    }
}

/// The box of the coarse stage: around the points of all training rays at the near and the far distance.
///
/// # Errors
/// [`Error::Invalid`] if there is no training view or its box is not finite or empty.
pub fn frustum_box(views: &[TrainView]) -> Result<(DVec3, DVec3)> {
    let framing = Framing::of(views);
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for view in views.iter().filter(|view| view.split == Split::Train) {
        let camera = view.camera;
        // An end may be extreme anywhere in the image; between pixels of this stride it is flat.
        let along = |count: u32| (0..count).step_by(STRIDE_PX).chain([count - 1]);
        let pixels = along(camera.height).flat_map(|y| along(camera.width).map(move |x| (x, y)));
        for (x, y) in pixels {
            let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
            let pose = view.local_from_camera;
            let direction = pose.direction(camera.direction(pixel));
            for distance in [framing.near_m, framing.far_m] {
                let p = pose.translation_m + direction * distance;
                low = low.min(p);
                high = high.max(p);
            }
        }
    }
    let sound = low.is_finite() && high.is_finite() && low.cmplt(high).all();
    if sound {
        Ok((low, high))
    } else {
        Err(Error::invalid(
            "scene: the training cameras frame no box; check their poses",
        ))
    }
}
