//! Draws the rays of a step from the training views.

use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

use super::input::LidarBeam;
use super::ray::{Backdrop, Silhouette, TrainRay};
use crate::field::Ray;
use crate::scene::Draws;
use crate::view::{PixelLabel, Split, TrainView};

/// Redraws of a pixel that supervises nothing, before the ray goes without a target.
const REDRAWS: usize = 24;

/// What a pulse's way must keep from its return to be free for certain, as a part of its range and in metres: pulses graze the
/// ground at 3 degrees and less, and a voxel before it must not be cleared.
const BEAM_MARGIN: f32 = 0.1;
const BEAM_MARGIN_M: f32 = 0.5;

/// How many rays of each sort a step has, and the weight of their losses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RayMix {
    pub pixel_rays: usize,
    pub depth_rays: usize,
    /// LiDAR pulses that clear the space up to their returns.
    pub beam_rays: usize,
    pub color_weight: f32,
    pub depth_weight: f32,
    /// Opaque and transparent rays of objects, each sort a mean of its own.
    pub silhouette_weight: f32,
    /// Transparency of sky pixels.
    pub sky_weight: f32,
    /// Transparency of LiDAR pulses.
    pub beam_weight: f32,
    /// Objects: mirrored rays' share of rays, and the factor on their colour weight.
    pub mirror_share: f64,
    pub mirror_color: f32,
    /// Backgrounds: pixels that are not sky teach the sky map too.
    pub solid_teaches_sky: bool,
    /// Metres past a return at which its ray ends.
    pub depth_margin_m: f32,
}

/// Where rays may start in each view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PixelWindow {
    left: u32,
    top: u32,
    width: u32,
    height: u32,
}

impl PixelWindow {
    fn whole(view: &TrainView) -> Self {
        Self {
            left: 0,
            top: 0,
            width: view.camera.width,
            height: view.camera.height,
        }
    }
}

/// What the views show, which decides what lies behind the field.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Subject {
    /// A scene under the field's own sky.
    Background,
    /// Composited over random colours, so that transparency never explains a pixel.
    Object,
    /// In front of this colour.
    Bounded([f32; 3]),
}

/// Draws rays, a pure function of (seed, step, ray).
#[derive(Debug)]
pub(super) struct Sampler<'a> {
    views: Vec<(u32, &'a TrainView, PixelWindow)>,
    /// Views with depths.
    depth_views: Vec<(u32, &'a TrainView)>,
    beams: &'a [LidarBeam],
    subject: Subject,
    seed: u64,
}

impl<'a> Sampler<'a> {
    /// Rays through all pixels of the training views.
    pub(super) fn whole_images(views: &'a [TrainView], beams: &'a [LidarBeam], seed: u64) -> Self {
        let window = |view: &TrainView| Some(PixelWindow::whole(view));
        Self {
            beams,
            ..Self::new(views, window, Subject::Background, seed)
        }
    }

    /// Rays through all pixels of views of a scene in front of one colour.
    pub(super) fn before(views: &'a [TrainView], color: [f32; 3], seed: u64) -> Self {
        Self::new(
            views,
            |view| Some(PixelWindow::whole(view)),
            Subject::Bounded(color),
            seed,
        )
    }

    /// Rays through the pixels that the padded cuboid of half extents `half_m` covers.
    pub(super) fn around_cuboid(views: &'a [TrainView], half_m: DVec3, seed: u64) -> Self {
        Self::new(
            views,
            |view| cuboid_window(view, half_m),
            Subject::Object,
            seed,
        )
    }

    fn new(
        views: &'a [TrainView],
        window: impl Fn(&TrainView) -> Option<PixelWindow>,
        subject: Subject,
        seed: u64,
    ) -> Self {
        let train = (0u32..)
            .zip(views)
            .filter(|(_, view)| view.split == Split::Train);
        Self {
            views: train
                .clone()
                .filter_map(|(number, view)| Some((number, view, window(view)?)))
                .collect(),
            depth_views: train.filter(|(_, view)| !view.depth.is_empty()).collect(),
            beams: &[],
            subject,
            seed,
        }
    }

    /// Number of training views that rays come from.
    pub(super) fn view_count(&self) -> usize {
        self.views.len()
    }

    /// Pixels that rays are drawn from.
    pub(super) fn pixel_count(&self) -> u64 {
        let windows = self.views.iter().map(|(.., window)| window);
        windows
            .map(|w| u64::from(w.width) * u64::from(w.height))
            .sum()
    }

    pub(super) fn has_depth(&self) -> bool {
        !self.depth_views.is_empty()
    }

    /// Replaces `out` by the rays of one step.
    pub(super) fn draw(&self, step: u64, mix: &RayMix, out: &mut Vec<TrainRay>) {
        let depth_rays = if self.has_depth() { mix.depth_rays } else { 0 };
        let beam_rays = match self.beams.len() {
            0 => 0,
            _ => mix.beam_rays,
        };
        let count = mix.pixel_rays + depth_rays + beam_rays;
        (0..count)
            .into_par_iter()
            .with_min_len(256)
            .map(|number| {
                let mut draws = Draws::new(self.seed, step, number as u32);
                if number < mix.pixel_rays {
                    self.pixel_ray(mix, &mut draws)
                } else if number < mix.pixel_rays + depth_rays {
                    self.depth_ray(mix, depth_rays, &mut draws)
                } else {
                    self.beam_ray(mix, &mut draws)
                }
            })
            .collect_into_vec(out);
        if self.subject == Subject::Object {
            balance(mix, out);
        }
    }

    fn pixel_ray(&self, mix: &RayMix, draws: &mut Draws) -> TrainRay {
        let (number, view, window) = self.views[draws.below(self.views.len())];
        let mut pixel = (0, 0);
        let mut label = PixelLabel::Unknown;
        for _ in 0..REDRAWS {
            pixel = (
                window.left + draws.below(window.width as usize) as u32,
                window.top + draws.below(window.height as usize) as u32,
            );
            label = view.labels[(pixel.1 * view.camera.width + pixel.0) as usize];
            if label != PixelLabel::Unknown {
                break;
            }
        }
        let mut ray = bare_ray(
            number,
            view,
            DVec2::new(f64::from(pixel.0) + 0.5, f64::from(pixel.1) + 0.5),
            draws,
        );
        let at = 3 * (pixel.1 as usize * view.camera.width as usize + pixel.0 as usize);
        ray.color = std::array::from_fn(|c| f32::from(view.rgb[at + c]) / 255.0);
        let share = 1.0 / mix.pixel_rays as f32;
        match label {
            PixelLabel::Unknown => {}
            PixelLabel::Foreground => {
                ray.color_weight = mix.color_weight * share;
                if !mix.solid_teaches_sky {
                    ray.backdrop = Backdrop::SkyAsIs;
                }
                match self.subject {
                    Subject::Background => {}
                    Subject::Object => {
                        ray.silhouette = Silhouette::Opaque;
                        let color = std::array::from_fn(|_| draws.unit() as f32);
                        ray.backdrop = Backdrop::Color(color);
                    }
                    Subject::Bounded(color) => ray.backdrop = Backdrop::Color(color),
                }
            }
            PixelLabel::Background => ray.silhouette = Silhouette::Transparent,
            PixelLabel::Sky => {
                ray.color_weight = mix.color_weight * share;
                ray.silhouette = Silhouette::Transparent;
                ray.silhouette_weight = mix.sky_weight * share;
            }
        }
        self.maybe_mirrored(ray, mix, draws)
    }

    fn depth_ray(&self, mix: &RayMix, depth_rays: usize, draws: &mut Draws) -> TrainRay {
        let (number, view) = self.depth_views[draws.below(self.depth_views.len())];
        let depth = view.depth[draws.below(view.depth.len())];
        let [x, y] = depth.pixel.map(f64::from);
        let mut ray = bare_ray(number, view, DVec2::new(x, y), draws);
        ray.range_m = depth.range_m;
        ray.range_weight = mix.depth_weight * depth.weight / depth_rays as f32;
        ray.t_max = depth.range_m + mix.depth_margin_m;
        self.maybe_mirrored(ray, mix, draws)
    }

    fn beam_ray(&self, mix: &RayMix, draws: &mut Draws) -> TrainRay {
        let beam = self.beams[draws.below(self.beams.len())];
        let origin = Vec3::from(beam.origin_m);
        let way = Vec3::from(beam.return_m) - origin;
        let range_m = way.length();
        TrainRay {
            ray: Ray {
                origin,
                direction: way / range_m,
            },
            phase: draws.unit() as f32,
            t_max: range_m * (1.0 - BEAM_MARGIN) - BEAM_MARGIN_M,
            backdrop: Backdrop::SkyAsIs,
            silhouette: Silhouette::Transparent,
            silhouette_weight: mix.beam_weight / mix.beam_rays as f32,
            ..no_target(beam.view)
        }
    }

    /// The ray's reflection about the x-z plane, for a share of the rays. Geometry keeps its weight; baked-in light does not
    /// mirror, so colour is trusted less.
    fn maybe_mirrored(&self, mut ray: TrainRay, mix: &RayMix, draws: &mut Draws) -> TrainRay {
        if draws.chance(mix.mirror_share) {
            ray.ray.origin.y = -ray.ray.origin.y;
            ray.ray.direction.y = -ray.ray.direction.y;
            ray.color_weight *= mix.mirror_color;
            ray.mirrored = true;
        }
        ray
    }
}

fn bare_ray(number: u32, view: &TrainView, pixel: DVec2, draws: &mut Draws) -> TrainRay {
    TrainRay {
        ray: view.ray(pixel),
        phase: draws.unit() as f32,
        ..no_target(number)
    }
}

fn no_target(view: u32) -> TrainRay {
    TrainRay {
        ray: Ray {
            origin: Vec3::ZERO,
            direction: Vec3::X,
        },
        phase: 0.0,
        t_max: f32::INFINITY,
        color: [0.0; 3],
        color_weight: 0.0,
        backdrop: Backdrop::Sky,
        silhouette: Silhouette::Unknown,
        silhouette_weight: 0.0,
        range_m: 0.0,
        range_weight: 0.0,
        view,
        mirrored: false,
    }
}

/// Makes opaque and transparent rays weigh the same in sum, or the larger sort would decide every edge.
fn balance(mix: &RayMix, rays: &mut [TrainRay]) {
    let count = |sort| {
        rays.iter()
            .filter(|ray| ray.silhouette == sort)
            .count()
            .max(1) as f32
    };
    let opaque = mix.silhouette_weight / count(Silhouette::Opaque);
    let transparent = mix.silhouette_weight / count(Silhouette::Transparent);
    for ray in rays {
        ray.silhouette_weight = match ray.silhouette {
            Silhouette::Opaque => opaque,
            Silhouette::Transparent => transparent,
            Silhouette::Unknown => 0.0,
        };
    }
}

/// The image window around the cuboid's projected corners; `None` if the camera does not see it.
fn cuboid_window(view: &TrainView, half_m: DVec3) -> Option<PixelWindow> {
    let camera_from_local = view.local_from_camera.inverse();
    let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for corner in 0..8 {
        let sign = |bit: i32| if corner >> bit & 1 == 0 { -1.0 } else { 1.0 };
        let p = DVec3::new(sign(0), sign(1), sign(2)) * half_m;
        let pixel = view.camera.project(camera_from_local.point(p))?;
        low = low.min(pixel);
        high = high.max(pixel);
    }
    let size = DVec2::new(f64::from(view.camera.width), f64::from(view.camera.height));
    let low = low.floor().clamp(DVec2::ZERO, size);
    let high = high.ceil().clamp(DVec2::ZERO, size);
    let span = (high - low).as_uvec2();
    (span.x > 0 && span.y > 0).then_some(PixelWindow {
        left: low.x as u32,
        top: low.y as u32,
        width: span.x,
        height: span.y,
    })
}

#[cfg(test)]
mod tests {
    use super::super::tests::drive;
    use super::super::{Budget, TrainPreset};
    use super::*;

    #[test]
    fn beams_are_transparent_to_shortly_before_their_returns() {
        let mut input = drive();
        let (origin, hit) = (Vec3::new(0.0, 0.0, 1.8), Vec3::new(10.0, 2.0, 0.0));
        input.beams.push(LidarBeam {
            origin_m: origin.to_array(),
            return_m: hit.to_array(),
            view: 3,
        });
        let mix = RayMix {
            pixel_rays: 64,
            depth_rays: 0,
            ..TrainPreset::background(Budget::Quick).mix
        };
        let mut rays = Vec::new();
        Sampler::whole_images(&input.views, &input.beams, 1).draw(0, &mix, &mut rays);
        let beams = &rays[mix.pixel_rays..];
        assert!(!beams.is_empty() && beams.len() == mix.beam_rays);
        let range_m = origin.distance(hit);
        for beam in beams {
            let left_m = beam.ray.at(beam.t_max).distance(hit);
            assert!((left_m - 0.1 * range_m - 0.5).abs() < 1e-4, "{left_m}");
            assert_eq!(beam.silhouette, Silhouette::Transparent);
            assert_eq!((beam.color_weight, beam.range_weight), (0.0, 0.0));
            assert_eq!((beam.ray.origin, beam.view), (origin, 3));
        }
        let weight: f32 = beams.iter().map(|beam| beam.silhouette_weight).sum();
        assert!((weight - mix.beam_weight).abs() < 1e-6, "{weight}");
        Sampler::whole_images(&input.views, &[], 1).draw(0, &mix, &mut rays);
        assert_eq!(rays.len(), mix.pixel_rays);
    }
}
