//! Light: sun with shadows, ambient sky and ground, mirror-like gloss, haze, and the camera's response.

use glam::Vec3;

use super::bvh::Ray;
use super::noise::smoothstep;
use super::scene::{Hit, Scene, Target};
use super::sky;
use super::texture::{self, Finish, Point};
use super::{paint, road};

/// The colour of one ray and what tells its pixel from its neighbours.
#[derive(Clone, Copy, Debug)]
pub(super) struct Shaded {
    /// Linear radiance before the camera's response.
    pub(super) radiance: Vec3,
    /// Material, region and shadow state; differs across a visible edge.
    pub(super) key: u32,
    pub(super) normal: Vec3,
}

/// A camera ray with its derivatives by one pixel to the right and one down.
#[derive(Clone, Copy, Debug)]
pub(super) struct PixelRay {
    pub(super) ray: Ray,
    pub(super) right: Vec3,
    pub(super) down: Vec3,
}

/// Exposure of the camera, fixed over a log.
const EXPOSURE: f32 = 0.92;
/// Radiance that maps to white.
const WHITE: f32 = 3.2;

/// Key of the sky.
const SKY_KEY: u32 = u32::MAX;

pub(super) fn shade(scene: &Scene<'_>, pixel: &PixelRay, hit: Option<&Hit>, seed: u32) -> Shaded {
    let view = pixel.ray.direction.normalize();
    let Some(hit) = hit else {
        return Shaded {
            radiance: sky::radiance(view, seed),
            key: SKY_KEY,
            normal: Vec3::ZERO,
        };
    };
    let position = pixel.ray.at(hit.t);
    let (flat, normal) = scene.normals(hit, pixel.ray.direction);
    let extent = extent(pixel, hit.t, flat);
    let (finish, key) = surface(
        scene,
        hit,
        &Point {
            position,
            normal: flat,
            extent,
        },
        seed,
    );
    let own = match hit.target {
        Target::Actor(index, _) => Some(index),
        Target::Ground | Target::Street(_) => None,
    };
    let sun = sky::sun_direction().as_vec3();
    // A flat normal that faces away stays dark even where the smooth one would catch light.
    let facing = normal.dot(sun) * smoothstep(-0.05, 0.10, flat.dot(sun));
    let lit = facing > 0.0 && {
        let origin = position + flat * (2e-3 + 2e-5 * position.length());
        !scene.in_shadow(
            &Ray {
                origin,
                direction: sun,
            },
            own,
        )
    };
    let open = if own.is_none() {
        scene.contact(position)
    } else {
        own_contact(position)
    };
    let tilt = 0.5 + 0.5 * normal.z;
    let ambient = sky::GROUND_AMBIENT.lerp(sky::SKY_AMBIENT, tilt) * open * canyon(position);
    let direct = if lit { sky::SUN * facing } else { Vec3::ZERO };
    let mut radiance = finish.albedo * (direct + ambient);
    if finish.mirror > 0.0 {
        radiance += gloss(&finish, view, normal, sun, lit, seed);
    }
    let distance_m = hit.t * pixel.ray.direction.length();
    Shaded {
        radiance: sky::haze(radiance, distance_m),
        key: key << 1 | u32::from(lit),
        normal,
    }
}

/// Camera response: exposure, a soft shoulder and the sRGB transfer function.
pub(super) fn develop(radiance: Vec3) -> Vec3 {
    let e = radiance * EXPOSURE;
    let compressed = e * (Vec3::ONE + e / (WHITE * WHITE)) / (Vec3::ONE + 0.62 * e);
    compressed.clamp(Vec3::ZERO, Vec3::ONE)
}

/// 8-bit sRGB of a developed linear colour.
pub(super) fn encode(linear: Vec3) -> [u8; 3] {
    linear.to_array().map(|v| {
        let encoded = if v <= 0.003_130_8 {
            12.92 * v
        } else {
            1.055 * v.powf(1.0 / 2.4) - 0.055
        };
        (encoded * 255.0 + 0.5) as u8
    })
}

/// Extent of a pixel on the tangent plane of a hit along each world axis.
fn extent(pixel: &PixelRay, t: f32, normal: Vec3) -> Vec3 {
    let direction = pixel.ray.direction;
    let slope = normal.dot(direction).min(-1e-3 * direction.length());
    let on_plane = |step: Vec3| (t * (step - direction * (normal.dot(step) / slope))).abs();
    on_plane(pixel.right) + on_plane(pixel.down)
}

fn surface(scene: &Scene<'_>, hit: &Hit, point: &Point, seed: u32) -> (Finish, u32) {
    match hit.target {
        Target::Ground => (road::ground(point, seed), 0),
        Target::Street(mesh_hit) => {
            let number = scene.street.mesh.triangles[mesh_hit.triangle as usize].material;
            let material = scene.street.materials[number as usize];
            let finish = texture::fixed(material, point, &scene.street.buildings, seed);
            (finish, 0x1000 + u32::from(number))
        }
        Target::Actor(index, mesh_hit) => {
            let instance = &scene.instances[index];
            let (material, normal) = scene.car_surface(index, &mesh_hit);
            let finish = paint::finish(
                instance.design,
                material,
                instance.point_in_cuboid(point.position),
                normal,
            );
            (
                finish,
                0x10_0000
                    + ((index as u32) << 8)
                    + (u32::from(material) << 5)
                    + u32::from(finish.region),
            )
        }
    }
}

/// Schlick's Fresnel mirror of the surroundings and a soft highlight of the sun.
fn gloss(finish: &Finish, view: Vec3, normal: Vec3, sun: Vec3, lit: bool, seed: u32) -> Vec3 {
    let cosine = (-view.dot(normal)).clamp(0.0, 1.0);
    let fresnel = finish.mirror + (1.0 - finish.mirror) * 0.7 * (1.0 - cosine).powi(5);
    let mirrored = view - 2.0 * view.dot(normal) * normal;
    let mut sum = sky::mirrored(mirrored, seed) * fresnel;
    if lit {
        sum += sky::SUN * (4.0 * finish.mirror * mirrored.dot(sun).max(0.0).powi(90));
    }
    sum
}

/// Ambient light lost to the buildings on both sides: less sky is seen from the ground than from the roofs.
fn canyon(position: Vec3) -> f32 {
    0.80 + 0.20 * smoothstep(0.0, 9.0, position.z)
}

/// The lower flanks of a car see mostly the road.
fn own_contact(position: Vec3) -> f32 {
    0.55 + 0.45 * smoothstep(0.05, 0.75, position.z)
}

/// LiDAR intensity in 0..1 of a hit, and whether it is glass.
pub(super) fn reflectance(scene: &Scene<'_>, ray: &Ray, hit: &Hit, seed: u32) -> (f32, bool) {
    /// Beam diameter on the target.
    const SPOT_M: f32 = 0.03;
    let (normal, _) = scene.normals(hit, ray.direction);
    let point = Point {
        position: ray.at(hit.t),
        normal,
        extent: Vec3::splat(SPOT_M),
    };
    let (finish, _) = surface(scene, hit, &point, seed);
    let cosine = -normal.dot(ray.direction.normalize());
    let albedo = finish.albedo.dot(Vec3::splat(1.0 / 3.0));
    (
        (albedo * (0.3 + 0.7 * cosine)).clamp(0.0, 1.0),
        finish.mirror > 0.07,
    )
}
