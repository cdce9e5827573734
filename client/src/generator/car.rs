//! Cars: a body lofted from cross-sections along x, with wheels. Mirror-symmetric in y; the mesh exactly fills its cuboid.

use glam::Vec3;

use super::bvh::Mesh;
use super::mesh::MeshBuilder;
use super::noise::{smoothstep, unit};

pub(super) const BODY: u16 = 0;
pub(super) const TYRE: u16 = 1;
pub(super) const RIM: u16 = 2;
pub(super) const UNDERSIDE: u16 = 3;

/// Shape and paint of one car.
#[derive(Clone, Debug)]
pub(super) struct CarDesign {
    pub(super) shape: &'static Shape,
    /// Full extents: length, width, height in metres.
    pub(super) size_m: Vec3,
    /// Linear RGB.
    pub(super) paint: Vec3,
    /// Seed of the number plate.
    pub(super) seed: u32,
}

/// A body style in normalised coordinates: x from -1 (rear) to 1 (front), heights as fractions of the car's height.
#[derive(Debug)]
pub(super) struct Shape {
    pub(super) name: &'static str,
    size_m: [f32; 3],
    /// Side view of the top, from rear to front.
    top: &'static [(f32, f32)],
    /// Height of the lower edge of the side windows.
    pub(super) belt: f32,
    /// x range of the side windows, rear window and windscreen.
    pub(super) side_glass: (f32, f32),
    pub(super) rear_glass: (f32, f32),
    pub(super) windscreen: (f32, f32),
    /// Pillars between the side windows.
    pub(super) pillars: &'static [f32],
}

const SHAPES: [Shape; 4] = [
    Shape {
        name: "sedan",
        size_m: [4.62, 1.80, 1.45],
        top: &[
            (-1.0, 0.44),
            (-0.985, 0.60),
            (-0.95, 0.70),
            (-0.66, 0.735),
            (-0.36, 0.955),
            (-0.16, 0.995),
            (0.04, 1.0),
            (0.20, 0.965),
            (0.50, 0.70),
            (0.88, 0.60),
            (0.965, 0.54),
            (1.0, 0.40),
        ],
        belt: 0.645,
        side_glass: (-0.56, 0.42),
        rear_glass: (-0.63, -0.37),
        windscreen: (0.22, 0.48),
        pillars: &[-0.08],
    },
    Shape {
        name: "hatchback",
        size_m: [4.05, 1.74, 1.49],
        top: &[
            (-1.0, 0.42),
            (-0.985, 0.60),
            (-0.93, 0.70),
            (-0.74, 0.945),
            (-0.45, 0.99),
            (-0.05, 1.0),
            (0.18, 0.965),
            (0.54, 0.69),
            (0.88, 0.59),
            (0.965, 0.53),
            (1.0, 0.40),
        ],
        belt: 0.63,
        side_glass: (-0.76, 0.46),
        rear_glass: (-0.92, -0.76),
        windscreen: (0.20, 0.52),
        pillars: &[-0.10, -0.56],
    },
    Shape {
        name: "suv",
        size_m: [4.50, 1.86, 1.68],
        top: &[
            (-1.0, 0.42),
            (-0.99, 0.62),
            (-0.94, 0.72),
            (-0.82, 0.95),
            (-0.55, 0.99),
            (-0.05, 1.0),
            (0.20, 0.97),
            (0.50, 0.71),
            (0.90, 0.64),
            (0.975, 0.56),
            (1.0, 0.40),
        ],
        belt: 0.645,
        side_glass: (-0.82, 0.43),
        rear_glass: (-0.94, -0.83),
        windscreen: (0.22, 0.48),
        pillars: &[-0.10, -0.54],
    },
    Shape {
        name: "van",
        size_m: [4.95, 1.92, 1.94],
        top: &[
            (-1.0, 0.40),
            (-0.995, 0.80),
            (-0.97, 0.94),
            (-0.80, 0.99),
            (0.0, 1.0),
            (0.36, 0.97),
            (0.68, 0.64),
            (0.90, 0.53),
            (0.975, 0.46),
            (1.0, 0.34),
        ],
        belt: 0.60,
        side_glass: (-0.90, 0.58),
        rear_glass: (-1.0, -0.965),
        windscreen: (0.40, 0.66),
        pillars: &[-0.46, 0.06],
    },
];

/// Linear RGB of common paints.
const PAINTS: [[f32; 3]; 9] = [
    [0.42, 0.030, 0.024],
    [0.60, 0.60, 0.58],
    [0.035, 0.080, 0.26],
    [0.30, 0.31, 0.32],
    [0.030, 0.032, 0.036],
    [0.70, 0.52, 0.06],
    [0.05, 0.17, 0.10],
    [0.74, 0.74, 0.72],
    [0.30, 0.10, 0.04],
];

/// Radius of a wheel as a fraction of the car's height, and axle positions as fractions of half its length.
const WHEEL_RADIUS: f32 = 0.222;
pub(super) const AXLES: [f32; 2] = [-0.60, 0.62];

impl CarDesign {
    /// The `index`-th car of a street; sizes vary by a few percent.
    pub(super) fn draw(seed: u32, index: u32) -> Self {
        let shape = &SHAPES[[0, 1, 2, 1, 3, 0, 2][((index + seed) % 7) as usize]];
        let stretch = |k| 0.97 + 0.06 * unit(seed, index, k);
        let [length, width, height] = shape.size_m;
        let round = |v: f32| (v * 100.0).round() / 100.0;
        Self {
            shape,
            size_m: Vec3::new(
                round(length * stretch(1)),
                round(width * stretch(2)),
                round(height * stretch(3)),
            ),
            paint: Vec3::from(PAINTS[((index * 4 + seed) % 9) as usize]),
            seed: seed.wrapping_mul(31).wrapping_add(index),
        }
    }

    /// Height of the roof line above the ground as a fraction of the car's height, at normalised `x`.
    pub(super) fn top(&self, x: f32) -> f32 {
        // A short box filter rounds the corners of the side view.
        let taps = [-0.035_f32, -0.0175, 0.0, 0.0175, 0.035];
        let edge = 1.0 - x.abs();
        let reach = (edge / 0.035).clamp(0.0, 1.0);
        taps.iter()
            .map(|d| polyline(self.shape.top, x + d * reach))
            .sum::<f32>()
            / taps.len() as f32
    }

    /// Radius of the wheels in metres.
    pub(super) fn wheel_radius_m(&self) -> f32 {
        WHEEL_RADIUS * self.size_m.z
    }

    /// Half width of the body at normalised `x` and height fraction `z`, in metres: the cabin leans inwards above the belt.
    pub(super) fn half_width_m(&self, x: f32, z: f32) -> f32 {
        let nose = smoothstep(0.80, 1.0, x.abs());
        let plan = 1.0 - 0.05 * x.abs().powi(4) - 0.16 * nose * nose;
        let lean = (z - self.shape.belt).max(0.0) * self.size_m.z * 0.27;
        0.5 * self.size_m.y * plan * 0.985 - lean
    }

    /// The car as a mesh in its cuboid frame.
    pub(super) fn mesh(&self) -> Mesh {
        let mut mesh = MeshBuilder::default();
        self.loft(&mut mesh);
        let half_width = 0.5 * self.size_m.y;
        for axle in AXLES {
            for side in [-1.0, 1.0] {
                self.wheel(&mut mesh, axle * 0.5 * self.size_m.x, side * half_width);
            }
        }
        fit(&mut mesh, self.size_m);
        Mesh::new(mesh.triangles)
    }

    fn loft(&self, mesh: &mut MeshBuilder) {
        let stations: Vec<f32> = (0..=56)
            .map(|i| {
                // Stations crowd at both ends, where the plan turns.
                let s = i as f32 / 28.0 - 1.0;
                s * (1.5 - 0.5 * s * s)
            })
            .collect();
        let rings: Vec<Vec<Vec3>> = stations.iter().map(|&x| self.ring(x)).collect();
        let (m, k) = (rings.len(), rings[0].len());
        let normal = |i: usize, j: usize| {
            let along = rings[(i + 1).min(m - 1)][j] - rings[i.saturating_sub(1)][j];
            let around = rings[i][(j + 1) % k] - rings[i][(j + k - 1) % k];
            along
                .cross(around)
                .normalize_or(Vec3::X * (i as f32 / m as f32 - 0.5).signum())
        };
        for i in 0..m - 1 {
            for j in 0..k {
                let next = (j + 1) % k;
                let c = [
                    rings[i][j],
                    rings[i + 1][j],
                    rings[i + 1][next],
                    rings[i][next],
                ];
                let n = [
                    normal(i, j),
                    normal(i + 1, j),
                    normal(i + 1, next),
                    normal(i, next),
                ];
                let material = if next <= 1 || j + 1 >= k {
                    UNDERSIDE
                } else {
                    BODY
                };
                mesh.smooth_quad(c, n, material);
            }
        }
        for (ring, outward) in [(&rings[0], Vec3::NEG_X), (&rings[m - 1], Vec3::X)] {
            let centre = ring.iter().sum::<Vec3>() / k as f32;
            for j in 0..k {
                mesh.smooth_quad(
                    [centre, ring[j], ring[(j + 1) % k], centre],
                    [outward; 4],
                    BODY,
                );
            }
        }
    }

    /// One closed cross-section at normalised `x`: bottom centre, left side up, roof, right side down.
    fn ring(&self, x: f32) -> Vec<Vec3> {
        let height = self.size_m.z;
        let top = self.top(x);
        let belt = self.shape.belt.min(top - 0.03);
        let end = smoothstep(0.86, 1.0, x.abs());
        let bottom = 0.135 + 0.075 * end;
        let roof = (top - 0.075).max(belt + 0.012);
        let w = |z: f32| self.half_width_m(x, z);
        let middle = 0.5 * (bottom + belt);
        let left = [
            (w(belt) * 0.82, bottom),
            (w(belt) * 0.955, bottom + 0.03),
            (w(belt) * 0.985, bottom + 0.11),
            (w(belt), middle),
            (w(belt) * 0.992, belt - 0.05),
            (w(belt) * 0.968, belt),
            (w(0.5 * (belt + roof)) * 0.966, 0.5 * (belt + roof)),
            (w(roof) * 0.955, roof),
            (w(roof) * 0.90, top - 0.028),
            (w(roof) * 0.72, top - 0.007),
            (w(roof) * 0.36, top),
        ];
        let at = |y: f32, z: f32| Vec3::new(x * 0.5 * self.size_m.x, y, (z - 0.5) * height);
        let mut ring = vec![at(0.0, bottom)];
        ring.extend(left.iter().map(|&(y, z)| at(y, z)));
        ring.push(at(0.0, top));
        ring.extend(left.iter().rev().map(|&(y, z)| at(-y, z)));
        ring
    }

    fn wheel(&self, mesh: &mut MeshBuilder, x: f32, y_outer: f32) {
        const SIDES: u32 = 28;
        let radius = self.wheel_radius_m();
        let outward = Vec3::Y * y_outer.signum();
        let centre = Vec3::new(x, y_outer, radius - 0.5 * self.size_m.z);
        let inner = centre - outward * 0.24;
        mesh.tube([inner, centre - outward * 0.02], [radius; 2], SIDES, TYRE);
        mesh.tube(
            [centre - outward * 0.02, centre],
            [radius, radius * 0.93],
            SIDES,
            TYRE,
        );
        for i in 0..SIDES {
            // The side wall is a ring so that the rim can sit deeper.
            let spoke = |j: u32| {
                let angle = std::f32::consts::TAU * j as f32 / SIDES as f32;
                Vec3::new(angle.cos(), 0.0, angle.sin())
            };
            let (a, b) = (spoke(i), spoke(i + 1));
            let wall = [
                a * radius * 0.93,
                b * radius * 0.93,
                b * radius * 0.68,
                a * radius * 0.68,
            ];
            mesh.smooth_quad(wall.map(|p| centre + p), [outward; 4], TYRE);
        }
        mesh.disc(centre - outward * 0.025, outward, radius * 0.69, SIDES, RIM);
        mesh.disc(inner, -outward, radius, SIDES, TYRE);
    }
}

/// Stretches the mesh so that its bounds are the cuboid.
fn fit(mesh: &mut MeshBuilder, size_m: Vec3) {
    let mut min = Vec3::INFINITY;
    let mut max = Vec3::NEG_INFINITY;
    for p in mesh.triangles.iter().flat_map(|t| t.corners) {
        min = min.min(p);
        max = max.max(p);
    }
    let scale = size_m / (max - min);
    let centre = 0.5 * (min + max);
    mesh.transform(|p| (p - centre) * scale, |n| n / scale);
}

fn polyline(points: &[(f32, f32)], x: f32) -> f32 {
    let after = points
        .partition_point(|p| p.0 < x)
        .clamp(1, points.len() - 1);
    let ((x0, y0), (x1, y1)) = (points[after - 1], points[after]);
    y0 + (y1 - y0) * ((x - x0) / (x1 - x0)).clamp(0.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::bvh::Ray;
    use crate::generator::paint::finish;

    #[test]
    fn the_mesh_fills_its_cuboid() {
        for index in 0..7 {
            let design = CarDesign::draw(3, index);
            let mesh = design.mesh();
            let corners = mesh.triangles.iter().flat_map(|t| t.corners);
            let (min, max) = corners.fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(min, max), p| {
                (min.min(p), max.max(p))
            });
            let half = 0.5 * design.size_m;
            assert!(
                (max - half).abs().max_element() < 1e-5,
                "{}: {max}",
                design.shape.name
            );
            assert!(
                (min + half).abs().max_element() < 1e-5,
                "{}: {min}",
                design.shape.name
            );
        }
    }

    #[test]
    fn cars_are_symmetric_in_shape_and_colour() {
        let mirror = Vec3::new(1.0, -1.0, 1.0);
        let design = CarDesign::draw(3, 0);
        let mesh = design.mesh();
        let look = |origin: Vec3, direction: Vec3| {
            let ray = Ray { origin, direction };
            mesh.nearest(&ray, f32::INFINITY).map(|hit| {
                let triangle = &mesh.triangles[hit.triangle as usize];
                let normal = triangle.normals[0] * (1.0 - hit.b1 - hit.b2)
                    + triangle.normals[1] * hit.b1
                    + triangle.normals[2] * hit.b2;
                (
                    hit.t,
                    finish(
                        &design,
                        triangle.material,
                        ray.at(hit.t),
                        normal.normalize(),
                    )
                    .albedo,
                )
            })
        };
        let (mut hits, mut same_colour, mut shifted_depth) = (0, 0, 0);
        for i in 0..600 {
            let aim = Vec3::from_array(std::array::from_fn(|k| {
                (unit(i, k as u32, 5) - 0.5) * design.size_m[k]
            }));
            let eye = Vec3::new(12.0 * (unit(i, 4, 5) - 0.5), 7.0, 2.5 * unit(i, 5, 5));
            let Some((t, albedo)) = look(eye, aim - eye) else {
                continue;
            };
            let (t_mirrored, albedo_mirrored) = look(eye * mirror, (aim - eye) * mirror).unwrap();
            assert!(
                (t - t_mirrored).abs() < 1e-3,
                "ray {i}: {t} and {t_mirrored}"
            );
            // Rounding may put a ray on the other side of a seam.
            same_colour += usize::from((albedo - albedo_mirrored).length() < 1e-4);
            let shifted = look(eye * mirror + Vec3::Y * 0.05, (aim - eye) * mirror);
            shifted_depth += usize::from(shifted.is_none_or(|s| (s.0 - t).abs() > 1e-3));
            hits += 1;
        }
        assert!(
            hits > 300 && same_colour > hits * 98 / 100,
            "{same_colour} of {hits}"
        );
        assert!(
            shifted_depth > hits / 2,
            "a shift of 5 cm must show: {shifted_depth} of {hits}"
        );
    }
}
