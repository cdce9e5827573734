//! Bounding volume hierarchy over a triangle mesh: nearest hit and occlusion.

use glam::{Vec3, Vec4};

use super::mesh::Triangle;

/// A ray; `direction` need not be of unit length, distances are in its units.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ray {
    pub(super) origin: Vec3,
    pub(super) direction: Vec3,
}

impl Ray {
    pub(super) fn at(&self, t: f32) -> Vec3 {
        self.origin + self.direction * t
    }
}

/// Where a ray meets a mesh: barycentric weights of corners 1 and 2.
#[derive(Clone, Copy, Debug)]
pub(super) struct MeshHit {
    pub(super) t: f32,
    pub(super) triangle: u32,
    pub(super) b1: f32,
    pub(super) b2: f32,
}

/// A mesh ready for tracing: a four-wide tree over packs of four triangles.
#[derive(Debug)]
pub(super) struct Mesh {
    pub(super) triangles: Vec<Triangle>,
    nodes: Vec<Node>,
    packs: Vec<Pack>,
}

/// Boxes of four children, one lane each.
#[derive(Clone, Copy, Debug)]
struct Node {
    min: [Vec4; 3],
    max: [Vec4; 3],
    children: [Child; 4],
}

#[derive(Clone, Copy, Debug)]
enum Child {
    None,
    Node(u32),
    /// Index of a pack.
    Leaf(u32),
}

/// Corners and edges of up to four triangles; unused lanes are degenerate.
#[derive(Clone, Copy, Debug)]
struct Pack {
    corner: [Vec4; 3],
    e1: [Vec4; 3],
    e2: [Vec4; 3],
    first: u32,
}

/// Lanes of a pack.
const LANES: usize = 4;
const BINS: usize = 12;
/// Three entries a level of a tree that is less than 40 levels deep; checked when it is built.
const STACK: usize = 3 * MAX_DEPTH + 1;
const MAX_DEPTH: usize = 40;

impl Mesh {
    /// Builds the hierarchy with binned surface-area splits.
    pub(super) fn new(mut triangles: Vec<Triangle>) -> Self {
        assert!(!triangles.is_empty(), "a mesh needs triangles");
        let mut mesh = Self {
            triangles: Vec::new(),
            nodes: Vec::new(),
            packs: Vec::new(),
        };
        mesh.add_node(&mut triangles, 0, 0);
        mesh.triangles = triangles;
        mesh
    }

    /// The nearest hit with `0 < t < t_max`.
    pub(super) fn nearest(&self, ray: &Ray, t_max: f32) -> Option<MeshHit> {
        let mut best: Option<MeshHit> = None;
        self.visit(ray, t_max, |hit| {
            best = Some(hit);
            Some(hit.t)
        });
        best
    }

    /// Whether anything lies on the ray with `0 < t < t_max`.
    pub(super) fn occludes(&self, ray: &Ray, t_max: f32) -> bool {
        let mut found = false;
        self.visit(ray, t_max, |_| {
            found = true;
            None
        });
        found
    }

    /// Calls `hit` for hits before the current limit; it returns the new limit or `None` to stop.
    fn visit(&self, ray: &Ray, t_max: f32, mut hit: impl FnMut(MeshHit) -> Option<f32>) {
        let lanes = RayLanes::new(ray);
        let mut limit = t_max;
        let mut stack = [(Child::None, 0.0_f32); STACK];
        stack[0] = (Child::Node(0), 0.0);
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let (child, near) = stack[depth];
            if near > limit {
                continue;
            }
            match child {
                Child::None => {}
                Child::Node(index) => {
                    depth =
                        self.nodes[index as usize].push_children(&lanes, limit, &mut stack, depth);
                }
                Child::Leaf(index) => {
                    if let Some(found) = self.packs[index as usize].meet(&lanes, limit) {
                        match hit(found) {
                            Some(new_limit) => limit = new_limit,
                            None => return,
                        }
                    }
                }
            }
        }
    }

    /// Adds a node for some of the triangles, the first of which has index `first`, and returns its index.
    fn add_node(&mut self, triangles: &mut [Triangle], first: usize, depth: usize) -> u32 {
        assert!(depth < MAX_DEPTH, "a tree of {depth} levels");
        let index = self.nodes.len();
        self.nodes.push(Node::EMPTY);
        let half = split(triangles);
        let (left, right) = triangles.split_at_mut(half);
        let quarters = [split(left), half, half + split(right)];
        let bounds_of = [0, quarters[0], quarters[1], quarters[2], triangles.len()];
        for lane in 0..4 {
            let part = &mut triangles[bounds_of[lane]..bounds_of[lane + 1]];
            if part.is_empty() {
                continue;
            }
            let (min, max) = bounds(part);
            let offset = first + bounds_of[lane];
            let child = if part.len() <= LANES {
                self.packs.push(Pack::new(part, offset as u32));
                Child::Leaf(self.packs.len() as u32 - 1)
            } else {
                Child::Node(self.add_node(part, offset, depth + 1))
            };
            self.nodes[index].set(lane, min, max, child);
        }
        index as u32
    }
}

/// A ray spread over four lanes.
struct RayLanes {
    origin: [Vec4; 3],
    direction: [Vec4; 3],
    inverse: [Vec4; 3],
}

impl RayLanes {
    fn new(ray: &Ray) -> Self {
        let spread = |v: Vec3| v.to_array().map(Vec4::splat);
        Self {
            origin: spread(ray.origin),
            direction: spread(ray.direction),
            inverse: spread(ray.direction.recip()),
        }
    }
}

impl Node {
    const EMPTY: Self = Self {
        min: [Vec4::INFINITY; 3],
        max: [Vec4::NEG_INFINITY; 3],
        children: [Child::None; 4],
    };

    fn set(&mut self, lane: usize, min: Vec3, max: Vec3, child: Child) {
        for axis in 0..3 {
            self.min[axis][lane] = min[axis];
            self.max[axis][lane] = max[axis];
        }
        self.children[lane] = child;
    }

    /// Pushes the children that the ray enters before `limit`, the nearest on top, and returns the new depth.
    #[inline]
    fn push_children(
        &self,
        ray: &RayLanes,
        limit: f32,
        stack: &mut [(Child, f32); STACK],
        mut depth: usize,
    ) -> usize {
        let mut near = Vec4::ZERO;
        let mut far = Vec4::splat(limit);
        for axis in 0..3 {
            let a = (self.min[axis] - ray.origin[axis]) * ray.inverse[axis];
            let b = (self.max[axis] - ray.origin[axis]) * ray.inverse[axis];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        let mut hits = near.cmple(far).bitmask();
        let bottom = depth;
        let near = near.to_array();
        while hits != 0 {
            let lane = hits.trailing_zeros() as usize;
            hits &= hits - 1;
            let entry = (self.children[lane], near[lane]);
            let mut slot = depth;
            while slot > bottom && stack[slot - 1].1 < entry.1 {
                stack[slot] = stack[slot - 1];
                slot -= 1;
            }
            stack[slot] = entry;
            depth += 1;
        }
        depth
    }
}

impl Pack {
    fn new(triangles: &[Triangle], first: u32) -> Self {
        let zero = [Vec4::ZERO; 3];
        let mut pack = Self {
            corner: zero,
            e1: zero,
            e2: zero,
            first,
        };
        for (lane, triangle) in triangles.iter().enumerate() {
            let [a, b, c] = triangle.corners;
            for axis in 0..3 {
                pack.corner[axis][lane] = a[axis];
                pack.e1[axis][lane] = b[axis] - a[axis];
                pack.e2[axis][lane] = c[axis] - a[axis];
            }
        }
        pack
    }

    /// Nearest hit in 0 < t < limit (Moeller and Trumbore 1997, both sides, four triangles at once).
    #[inline]
    fn meet(&self, ray: &RayLanes, limit: f32) -> Option<MeshHit> {
        /// Hits this far outside an edge count, so that no ray slips between neighbours.
        const SLACK: f32 = 1e-6;
        let p = cross(&ray.direction, &self.e2);
        let determinant = dot(&self.e1, &p);
        let inverse = determinant.recip();
        let s = [
            ray.origin[0] - self.corner[0],
            ray.origin[1] - self.corner[1],
            ray.origin[2] - self.corner[2],
        ];
        let b1 = dot(&s, &p) * inverse;
        let q = cross(&s, &self.e1);
        let b2 = dot(&ray.direction, &q) * inverse;
        let t = dot(&self.e2, &q) * inverse;
        // A degenerate lane has an infinite inverse and NaN weights, which fail every comparison.
        let inside = b1.cmpge(Vec4::splat(-SLACK))
            & b2.cmpge(Vec4::splat(-SLACK))
            & (b1 + b2).cmple(Vec4::splat(1.0 + SLACK))
            & t.cmpgt(Vec4::ZERO)
            & t.cmplt(Vec4::splat(limit));
        let mut hits = inside.bitmask();
        let mut best: Option<MeshHit> = None;
        while hits != 0 {
            let lane = hits.trailing_zeros() as usize;
            hits &= hits - 1;
            if best.is_none_or(|b| t[lane] < b.t) {
                best = Some(MeshHit {
                    t: t[lane],
                    triangle: self.first + lane as u32,
                    b1: b1[lane],
                    b2: b2[lane],
                });
            }
        }
        best
    }
}

fn cross(a: &[Vec4; 3], b: &[Vec4; 3]) -> [Vec4; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

fn dot(a: &[Vec4; 3], b: &[Vec4; 3]) -> Vec4 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn centroid(triangle: &Triangle) -> Vec3 {
    (triangle.corners[0] + triangle.corners[1] + triangle.corners[2]) / 3.0
}

fn bounds(triangles: &[Triangle]) -> (Vec3, Vec3) {
    let mut min = Vec3::INFINITY;
    let mut max = Vec3::NEG_INFINITY;
    for corner in triangles.iter().flat_map(|t| t.corners) {
        min = min.min(corner);
        max = max.max(corner);
    }
    (min, max)
}

/// Reorders the triangles around the cheapest of the binned planes and returns the number on the left.
fn split(triangles: &mut [Triangle]) -> usize {
    if triangles.len() <= LANES {
        return triangles.len();
    }
    let mut low = Vec3::INFINITY;
    let mut high = Vec3::NEG_INFINITY;
    for c in triangles.iter().map(centroid) {
        low = low.min(c);
        high = high.max(c);
    }
    let extent = high - low;
    let axis = extent.max_position();
    if extent[axis] > 0.0 {
        let scale = BINS as f32 / extent[axis];
        let bin = |t: &Triangle| (((centroid(t)[axis] - low[axis]) * scale) as usize).min(BINS - 1);
        let cut = cheapest_cut(triangles, bin);
        let middle = partition(triangles, |t| bin(t) < cut);
        if middle > 0 && middle < triangles.len() {
            return middle;
        }
    }
    triangles.len() / 2
}

fn cheapest_cut(triangles: &[Triangle], bin: impl Fn(&Triangle) -> usize) -> usize {
    let mut boxes = [(Vec3::INFINITY, Vec3::NEG_INFINITY, 0_u32); BINS];
    for triangle in triangles {
        let entry = &mut boxes[bin(triangle)];
        for corner in triangle.corners {
            entry.0 = entry.0.min(corner);
            entry.1 = entry.1.max(corner);
        }
        entry.2 += 1;
    }
    let cost = |part: &[(Vec3, Vec3, u32)]| {
        let mut min = Vec3::INFINITY;
        let mut max = Vec3::NEG_INFINITY;
        let mut count = 0;
        for entry in part {
            min = min.min(entry.0);
            max = max.max(entry.1);
            count += entry.2;
        }
        let d = (max - min).max(Vec3::ZERO);
        if count == 0 {
            0.0
        } else {
            count as f32 * (d.x * d.y + d.y * d.z + d.z * d.x)
        }
    };
    (1..BINS)
        .min_by(|&a, &b| {
            let (ca, cb) = (
                cost(&boxes[..a]) + cost(&boxes[a..]),
                cost(&boxes[..b]) + cost(&boxes[b..]),
            );
            ca.total_cmp(&cb)
        })
        .unwrap_or(1)
}

/// Moves the triangles that satisfy `left` to the front and returns their number.
fn partition(triangles: &mut [Triangle], left: impl Fn(&Triangle) -> bool) -> usize {
    let mut middle = 0;
    for i in 0..triangles.len() {
        if left(&triangles[i]) {
            triangles.swap(i, middle);
            middle += 1;
        }
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generator::noise::unit;

    fn random_vector(i: u32, stream: u32) -> Vec3 {
        Vec3::from_array(std::array::from_fn(|axis| {
            unit(i, axis as u32, stream) * 2.0 - 1.0
        }))
    }

    fn soup(count: u32) -> Vec<Triangle> {
        (0..count)
            .map(|i| {
                let centre = random_vector(i, 1) * 5.0;
                let corners = [2, 3, 4].map(|stream| centre + random_vector(i, stream) * 1.5);
                Triangle {
                    corners,
                    normals: [Vec3::Z; 3],
                    material: 0,
                }
            })
            .collect()
    }

    fn brute_force(triangles: &[Triangle], ray: &Ray) -> Option<f32> {
        let hits = triangles.iter().filter_map(|triangle| {
            let [a, b, c] = triangle.corners.map(|p| (p - ray.origin).as_dvec3());
            let d = ray.direction.as_dvec3();
            let normal = (b - a).cross(c - a);
            let t = normal.dot(a) / normal.dot(d);
            let p = d * t;
            let inside = [(a, b), (b, c), (c, a)]
                .iter()
                .all(|(u, v)| normal.dot((*v - *u).cross(p - *u)) >= 0.0);
            (inside && t > 0.0).then_some(t as f32)
        });
        hits.min_by(f32::total_cmp)
    }

    #[test]
    fn nearest_hits_agree_with_brute_force() {
        let triangles = soup(300);
        let mesh = Mesh::new(triangles.clone());
        let mut hits = 0;
        for i in 0..500 {
            let ray = Ray {
                origin: random_vector(i, 8) * 8.0,
                direction: random_vector(i, 9) * 4.0 - random_vector(i, 8) * 8.0,
            };
            let expected = brute_force(&triangles, &ray);
            let found = mesh.nearest(&ray, f32::INFINITY).map(|hit| hit.t);
            match (expected, found) {
                (Some(a), Some(b)) => {
                    assert!((a - b).abs() < 1e-3 * a.max(1.0), "ray {i}: {a} or {b}")
                }
                (a, b) => assert_eq!(a, b, "ray {i}"),
            }
            assert_eq!(mesh.occludes(&ray, f32::INFINITY), expected.is_some());
            hits += usize::from(expected.is_some());
        }
        assert!(hits > 100, "{hits} rays hit");
    }

    #[test]
    fn a_missing_triangle_is_noticed() {
        let triangles = soup(300);
        let mesh = Mesh::new(triangles[..200].to_vec());
        let differs = (0..500).any(|i| {
            let ray = Ray {
                origin: random_vector(i, 8) * 8.0,
                direction: random_vector(i, 9) * 4.0 - random_vector(i, 8) * 8.0,
            };
            brute_force(&triangles, &ray).is_some() != mesh.nearest(&ray, f32::INFINITY).is_some()
        });
        assert!(differs);
    }
}
