//! A grid's values on a grid of another resolution over the same box.

use glam::{UVec3, Vec3};

use super::grid::Shape;

/// Trilinear interpolation of `values` at the nodes of `to`; the boxes' corners are nodes of both.
pub(super) fn resample<const C: usize>(
    from: &Shape,
    values: &[[f32; C]],
    to: &Shape,
) -> Vec<[f32; C]> {
    let mut out = vec![[0.0; C]; to.len()];
    to.for_each_node(|node, at| {
        out[at] = from
            .cell(same_place(from, to, node))
            .interpolate_rows(values);
    });
    out
}

/// Node coordinates in `from` of a node of `to`.
pub(super) fn same_place(from: &Shape, to: &Shape, node: UVec3) -> Vec3 {
    let scale = (from.nodes - 1).as_dvec3() / (to.nodes - 1).as_dvec3();
    (node.as_dvec3() * scale).as_vec3()
}
