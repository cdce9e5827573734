//! Triangle meshes and the primitives they are built from.

use glam::{Vec2, Vec3};

/// One triangle: corners, unit shading normals and what it is made of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Triangle {
    pub(super) corners: [Vec3; 3],
    pub(super) normals: [Vec3; 3],
    pub(super) material: u16,
}

/// A growing list of triangles, metres, z up.
#[derive(Clone, Debug, Default)]
pub(super) struct MeshBuilder {
    pub(super) triangles: Vec<Triangle>,
}

impl MeshBuilder {
    /// A flat triangle, counter-clockwise seen from outside.
    pub(super) fn triangle(&mut self, a: Vec3, b: Vec3, c: Vec3, material: u16) {
        let normal = (b - a).cross(c - a).normalize_or_zero();
        if normal != Vec3::ZERO {
            self.triangles.push(Triangle {
                corners: [a, b, c],
                normals: [normal; 3],
                material,
            });
        }
    }

    /// A flat quadrilateral, counter-clockwise seen from outside.
    pub(super) fn quad(&mut self, corners: [Vec3; 4], material: u16) {
        let [a, b, c, d] = corners;
        self.triangle(a, b, c, material);
        self.triangle(a, c, d, material);
    }

    /// A box with axis-aligned faces.
    pub(super) fn cuboid(&mut self, min: Vec3, max: Vec3, material: u16) {
        let p = |x: bool, y: bool, z: bool| {
            Vec3::new(
                if x { max.x } else { min.x },
                if y { max.y } else { min.y },
                if z { max.z } else { min.z },
            )
        };
        let (f, t) = (false, true);
        self.quad([p(f, f, f), p(f, t, f), p(t, t, f), p(t, f, f)], material);
        self.quad([p(f, f, t), p(t, f, t), p(t, t, t), p(f, t, t)], material);
        self.quad([p(f, f, f), p(t, f, f), p(t, f, t), p(f, f, t)], material);
        self.quad([p(t, t, f), p(f, t, f), p(f, t, t), p(t, t, t)], material);
        self.quad([p(f, t, f), p(f, f, f), p(f, f, t), p(f, t, t)], material);
        self.quad([p(t, f, f), p(t, t, f), p(t, t, t), p(t, f, t)], material);
    }

    /// A smooth tube or cone between two centres, open at both ends.
    pub(super) fn tube(&mut self, ends: [Vec3; 2], radii: [f32; 2], sides: u32, material: u16) {
        let axis = (ends[1] - ends[0]).normalize();
        let (u, v) = axis.any_orthonormal_pair();
        let spoke = |i: u32| {
            let angle = std::f32::consts::TAU * i as f32 / sides as f32;
            u * angle.cos() + v * angle.sin()
        };
        for i in 0..sides {
            let (n0, n1) = (spoke(i), spoke(i + 1));
            let corners = [
                ends[0] + n0 * radii[0],
                ends[0] + n1 * radii[0],
                ends[1] + n1 * radii[1],
                ends[1] + n0 * radii[1],
            ];
            self.smooth_quad(corners, [n0, n1, n1, n0], material);
        }
    }

    /// A flat disc facing `normal`.
    pub(super) fn disc(
        &mut self,
        centre: Vec3,
        normal: Vec3,
        radius: f32,
        sides: u32,
        material: u16,
    ) {
        let (u, v) = normal.any_orthonormal_pair();
        let rim = |i: u32| {
            let angle = std::f32::consts::TAU * i as f32 / sides as f32;
            centre + (u * angle.cos() + v * angle.sin()) * radius
        };
        for i in 0..sides {
            self.triangle(centre, rim(i), rim(i + 1), material);
        }
    }

    /// A quadrilateral with its own normals.
    pub(super) fn smooth_quad(&mut self, c: [Vec3; 4], n: [Vec3; 4], material: u16) {
        for [i, j, k] in [[0, 1, 2], [0, 2, 3]] {
            if (c[j] - c[i]).cross(c[k] - c[i]).length_squared() > 1e-14 {
                self.triangles.push(Triangle {
                    corners: [c[i], c[j], c[k]],
                    normals: [n[i], n[j], n[k]],
                    material,
                });
            }
        }
    }

    /// A sphere whose radius is scaled by `bump` of the unit direction, smooth-shaded.
    pub(super) fn bumpy_sphere(
        &mut self,
        centre: Vec3,
        radii: Vec3,
        rings: usize,
        bump: impl Fn(Vec3) -> f32,
        material: u16,
    ) {
        let sides = rings * 2;
        let points: Vec<Vec3> = (0..=rings)
            .flat_map(|ring| (0..sides).map(move |side| (ring, side)))
            .map(|(ring, side)| {
                let polar = std::f32::consts::PI * ring as f32 / rings as f32;
                let around = std::f32::consts::TAU * side as f32 / sides as f32;
                let direction = (Vec2::from_angle(around) * polar.sin()).extend(polar.cos());
                centre + direction * radii * bump(direction)
            })
            .collect();
        let at = |ring: usize, side: usize| points[ring * sides + side % sides];
        let normal = |ring: usize, side: usize| {
            let down = at((ring + 1).min(rings), side) - at(ring.saturating_sub(1), side);
            let around = at(ring, side + 1) - at(ring, side + sides - 1);
            down.cross(around).normalize_or(at(ring, side) - centre)
        };
        for ring in 0..rings {
            for side in 0..sides {
                let square = [
                    (ring, side),
                    (ring + 1, side),
                    (ring + 1, side + 1),
                    (ring, side + 1),
                ];
                let corners = square.map(|(r, s)| at(r, s));
                self.smooth_quad(corners, square.map(|(r, s)| normal(r, s)), material);
            }
        }
    }

    pub(super) fn transform(&mut self, map: impl Fn(Vec3) -> Vec3, turn: impl Fn(Vec3) -> Vec3) {
        for triangle in &mut self.triangles {
            triangle.corners = triangle.corners.map(&map);
            triangle.normals = triangle.normals.map(|n| turn(n).normalize_or(Vec3::Z));
        }
    }
}
