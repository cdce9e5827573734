//! Bounding volume hierarchy over a triangle mesh: nearest hit and occlusion.

use glam::{Vec3, Vec3A};

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

/// An indexed mesh ready for tracing.
#[derive(Debug)]
pub(super) struct Mesh {
    pub(super) triangles: Vec<Triangle>,
    edges: Vec<[Vec3A; 3]>,
    nodes: Vec<Node>,
}

#[derive(Clone, Copy, Debug)]
struct Node {
    min: Vec3A,
    max: Vec3A,
    /// First triangle of a leaf, or index of the right child; the left child follows its parent.
    first: u32,
    /// Triangles of a leaf; 0 for an inner node.
    count: u32,
    axis: u32,
}

/// Small leaves: a triangle test costs about as much as two box tests.
const LEAF_TRIANGLES: usize = 3;
const BINS: usize = 12;
/// Deeper than any tree over 2^32 triangles that splits by bins or by halves.
const STACK: usize = 64;

impl Mesh {
    /// Builds the hierarchy with binned surface-area splits.
    pub(super) fn new(mut triangles: Vec<Triangle>) -> Self {
        assert!(!triangles.is_empty(), "a mesh needs triangles");
        let mut nodes = Vec::with_capacity(triangles.len());
        build(&mut triangles, 0, &mut nodes);
        let edges = triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.corners.map(Vec3A::from);
                [a, b - a, c - a]
            })
            .collect();
        Self {
            triangles,
            edges,
            nodes,
        }
    }

    /// The nearest hit with `0 < t < t_max`.
    pub(super) fn nearest(&self, ray: &Ray, t_max: f32) -> Option<MeshHit> {
        let mut best: Option<MeshHit> = None;
        let mut limit = t_max;
        self.visit(ray, t_max, |triangle, t, b1, b2| {
            limit = t;
            best = Some(MeshHit {
                t,
                triangle,
                b1,
                b2,
            });
            Some(limit)
        });
        best
    }

    /// Whether anything lies on the ray with `0 < t < t_max`.
    pub(super) fn occludes(&self, ray: &Ray, t_max: f32) -> bool {
        let mut found = false;
        self.visit(ray, t_max, |_, _, _, _| {
            found = true;
            None
        });
        found
    }

    /// Calls `hit` for each triangle hit before the current limit; it returns the new limit or `None` to stop.
    fn visit(&self, ray: &Ray, t_max: f32, mut hit: impl FnMut(u32, f32, f32, f32) -> Option<f32>) {
        let origin = Vec3A::from(ray.origin);
        let direction = Vec3A::from(ray.direction);
        let inverse = direction.recip();
        let behind = [inverse.x < 0.0, inverse.y < 0.0, inverse.z < 0.0];
        let mut limit = t_max;
        let mut stack = [0_u32; STACK];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            if !slab(node, origin, inverse, limit) {
                continue;
            }
            if node.count == 0 {
                let (left, right) = (index + 1, node.first);
                let far_first = behind[node.axis as usize];
                stack[depth] = if far_first { left } else { right };
                stack[depth + 1] = if far_first { right } else { left };
                depth += 2;
                continue;
            }
            for triangle in node.first..node.first + node.count {
                if let Some((t, b1, b2)) =
                    meet(&self.edges[triangle as usize], origin, direction, limit)
                {
                    match hit(triangle, t, b1, b2) {
                        Some(new_limit) => limit = new_limit,
                        None => return,
                    }
                }
            }
        }
    }
}

fn slab(node: &Node, origin: Vec3A, inverse: Vec3A, limit: f32) -> bool {
    let a = (node.min - origin) * inverse;
    let b = (node.max - origin) * inverse;
    let near = a.min(b).max_element().max(0.0);
    let far = a.max(b).min_element().min(limit);
    near <= far
}

/// Moeller and Trumbore 1997, both sides of the triangle.
fn meet(
    edges: &[Vec3A; 3],
    origin: Vec3A,
    direction: Vec3A,
    limit: f32,
) -> Option<(f32, f32, f32)> {
    let [corner, e1, e2] = *edges;
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    if determinant.abs() < 1e-12 {
        return None;
    }
    let inverse = 1.0 / determinant;
    let s = origin - corner;
    let b1 = s.dot(p) * inverse;
    if !(-1e-6..=1.0 + 1e-6).contains(&b1) {
        return None;
    }
    let q = s.cross(e1);
    let b2 = direction.dot(q) * inverse;
    if b2 < -1e-6 || b1 + b2 > 1.0 + 2e-6 {
        return None;
    }
    let t = e2.dot(q) * inverse;
    (t > 0.0 && t < limit).then_some((t, b1, b2))
}

fn build(triangles: &mut [Triangle], first: usize, nodes: &mut Vec<Node>) {
    let (min, max) = bounds(triangles);
    let index = nodes.len();
    nodes.push(Node {
        min: min.into(),
        max: max.into(),
        first: first as u32,
        count: triangles.len() as u32,
        axis: 0,
    });
    if triangles.len() <= LEAF_TRIANGLES {
        return;
    }
    let (axis, middle) = split(triangles);
    let (left, right) = triangles.split_at_mut(middle);
    build(left, first, nodes);
    nodes[index].first = nodes.len() as u32;
    nodes[index].count = 0;
    nodes[index].axis = axis as u32;
    build(right, first + middle, nodes);
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

/// Reorders the triangles around the cheapest of the binned planes and returns the axis and the number on the left.
fn split(triangles: &mut [Triangle]) -> (usize, usize) {
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
            return (axis, middle);
        }
    }
    (axis, triangles.len() / 2)
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
