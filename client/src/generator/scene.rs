//! The street with cars at given poses: nearest hits and shadow tests, exact for the meshes.

use backlot_engine::camera::Rigid;
use glam::{Mat3, Vec3};

use super::bvh::{Mesh, MeshHit, Ray};
use super::car::CarDesign;
use super::street::Street;

/// One car placed in the scene.
#[derive(Debug)]
pub(super) struct Instance<'a> {
    pub(super) design: &'a CarDesign,
    pub(super) casts_shadow: bool,
    mesh: &'a Mesh,
    world_from_cuboid: Mat3,
    centre: Vec3,
    /// World bounds.
    min: Vec3,
    max: Vec3,
}

impl<'a> Instance<'a> {
    pub(super) fn new(
        mesh: &'a Mesh,
        design: &'a CarDesign,
        pose: &Rigid,
        casts_shadow: bool,
    ) -> Self {
        let world_from_cuboid = pose.rotation_matrix().as_mat3();
        let centre = pose.translation_m.as_vec3();
        let half = 0.5 * design.size_m;
        let m = world_from_cuboid;
        let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
        Self {
            design,
            casts_shadow,
            mesh,
            world_from_cuboid,
            centre,
            min: centre - reach - Vec3::splat(1e-3),
            max: centre + reach + Vec3::splat(1e-3),
        }
    }

    pub(super) fn point_in_cuboid(&self, p_world: Vec3) -> Vec3 {
        self.world_from_cuboid.transpose() * (p_world - self.centre)
    }

    fn ray_in_cuboid(&self, ray: &Ray) -> Ray {
        Ray {
            origin: self.point_in_cuboid(ray.origin),
            direction: self.world_from_cuboid.transpose() * ray.direction,
        }
    }

    fn may_meet(&self, ray: &Ray, inverse: Vec3, t_max: f32) -> bool {
        let a = (self.min - ray.origin) * inverse;
        let b = (self.max - ray.origin) * inverse;
        a.min(b).max_element().max(0.0) <= a.max(b).min_element().min(t_max)
    }

    /// Fraction of ambient light that reaches a world point on the ground or a kerb beside or under the car.
    fn open_sky(&self, p_world: Vec3) -> f32 {
        let p = self.point_in_cuboid(p_world);
        let half = 0.5 * self.design.size_m;
        let outside = Vec3::new(p.x.abs() - half.x + 0.15, p.y.abs() - half.y + 0.12, 0.0);
        let beside = outside.max(Vec3::ZERO).length();
        let inside = outside.max_element().min(0.0);
        // Under the body the light dies off with depth, beside it within about half its height.
        let shade = 0.62 * (-beside / 0.38).exp() + 0.30 * (1.0 - (inside / 0.5).exp());
        let height = p.z + half.z;
        1.0 - shade * (-height.max(0.0) / 0.5).exp()
    }
}

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub(super) enum Target {
    Ground,
    Street(MeshHit),
    Actor(usize, MeshHit),
}

/// The nearest surface on a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hit {
    pub(super) t: f32,
    pub(super) target: Target,
}

/// Everything that rays can meet.
#[derive(Debug)]
pub(super) struct Scene<'a> {
    pub(super) street: &'a Street,
    pub(super) instances: Vec<Instance<'a>>,
}

impl Scene<'_> {
    pub(super) fn nearest(&self, ray: &Ray) -> Option<Hit> {
        let mut best = None;
        let mut t_max = f32::INFINITY;
        if ray.direction.z < 0.0 && ray.origin.z > 0.0 {
            t_max = -ray.origin.z / ray.direction.z;
            best = Some(Target::Ground);
        }
        let inverse = ray.direction.recip();
        for (index, instance) in self.instances.iter().enumerate() {
            if !instance.may_meet(ray, inverse, t_max) {
                continue;
            }
            if let Some(hit) = instance.mesh.nearest(&instance.ray_in_cuboid(ray), t_max) {
                t_max = hit.t;
                best = Some(Target::Actor(index, hit));
            }
        }
        if let Some(hit) = self.street.mesh.nearest(ray, t_max) {
            t_max = hit.t;
            best = Some(Target::Street(hit));
        }
        best.map(|target| Hit { t: t_max, target })
    }

    /// Whether the sun is hidden from a point; `own` is the car the point lies on, which always shades itself.
    pub(super) fn in_shadow(&self, ray: &Ray, own: Option<usize>) -> bool {
        let inverse = ray.direction.recip();
        let by_car = self.instances.iter().enumerate().any(|(index, instance)| {
            (instance.casts_shadow || own == Some(index))
                && instance.may_meet(ray, inverse, f32::INFINITY)
                && instance
                    .mesh
                    .occludes(&instance.ray_in_cuboid(ray), f32::INFINITY)
        });
        by_car || self.street.mesh.occludes(ray, f32::INFINITY)
    }

    /// Ambient occlusion by cars near the ground at a point that is not on a car.
    pub(super) fn contact(&self, p_world: Vec3) -> f32 {
        self.instances
            .iter()
            .filter(|instance| {
                let reach = Vec3::splat(2.0);
                instance.casts_shadow
                    && p_world.cmpge(instance.min - reach).all()
                    && p_world.cmple(instance.max + reach).all()
            })
            .map(|instance| instance.open_sky(p_world))
            .product()
    }

    /// Geometric and shading normals of a hit, facing the ray's origin.
    pub(super) fn normals(&self, hit: &Hit, direction: Vec3) -> (Vec3, Vec3) {
        let (flat, smooth) = match hit.target {
            Target::Ground => (Vec3::Z, Vec3::Z),
            Target::Street(hit) => mesh_normals(&self.street.mesh, &hit),
            Target::Actor(index, hit) => {
                let instance = &self.instances[index];
                let (flat, smooth) = mesh_normals(instance.mesh, &hit);
                (
                    instance.world_from_cuboid * flat,
                    instance.world_from_cuboid * smooth,
                )
            }
        };
        let flat = if flat.dot(direction) > 0.0 {
            -flat
        } else {
            flat
        };
        let smooth = if smooth.dot(flat) < 0.0 {
            -smooth
        } else {
            smooth
        };
        (flat, smooth)
    }

    /// Material number of a car's triangle and its shading normal in the cuboid frame.
    pub(super) fn car_surface(&self, index: usize, hit: &MeshHit) -> (u16, Vec3) {
        let mesh = self.instances[index].mesh;
        (
            mesh.triangles[hit.triangle as usize].material,
            mesh_normals(mesh, hit).1,
        )
    }
}

fn mesh_normals(mesh: &Mesh, hit: &MeshHit) -> (Vec3, Vec3) {
    let triangle = &mesh.triangles[hit.triangle as usize];
    let [a, b, c] = triangle.corners;
    let flat = (b - a).cross(c - a).normalize();
    let [na, nb, nc] = triangle.normals;
    let smooth = na * (1.0 - hit.b1 - hit.b2) + nb * hit.b1 + nc * hit.b2;
    (flat, smooth.normalize_or(flat))
}
