//! Fields made of analytic densities, for tests.

use glam::Vec3;

use crate::field::{
    BRICK_NODES, BRICK_SIDE, ColorMlp, DensityActivation, Field, Lattice, Occupancy, SkyGrid,
    SkyMap,
};

/// A field over a box whose nodes hold `sigma` (1/m), of one colour, marched by half a voxel.
pub(super) fn solid_field(
    low: Vec3,
    high: Vec3,
    voxel_m: f32,
    rgb: [f32; 3],
    sigma: impl Fn(Vec3) -> f32,
) -> Field {
    stepped_field((low, high), voxel_m, rgb, 0.5 * voxel_m, sigma)
}

/// [`solid_field`], marched by `step_m`.
pub(super) fn stepped_field(
    (low, high): (Vec3, Vec3),
    voxel_m: f32,
    rgb: [f32; 3],
    step_m: f32,
    sigma: impl Fn(Vec3) -> f32,
) -> Field {
    let activation = DensityActivation::from_alpha(1e-6, voxel_m);
    let mut level = Lattice::new(voxel_m, low, high - low).unwrap();
    let bricks = level.bricks_per_axis();
    for z in 0..bricks.z as u16 {
        for y in 0..bricks.y as u16 {
            for x in 0..bricks.x as u16 {
                level.allocate([x, y, z]).unwrap();
            }
        }
    }
    let origins: Vec<Vec3> = (0..level.brick_count())
        .map(|b| level.brick_origin(level.positions()[b]))
        .collect();
    let (density, _) = level.parameters_mut();
    for (node, raw) in density.iter_mut().enumerate().skip(BRICK_NODES) {
        let (brick, within) = (node / BRICK_NODES, node % BRICK_NODES);
        let step = |shift: u32| (within >> shift & (BRICK_SIDE - 1)) as f32;
        let p = origins[brick] + Vec3::new(step(0), step(3), step(6)) * voxel_m;
        *raw = activation.raw(sigma(p).max(1e-6));
    }
    let mut mlp = ColorMlp::new(16, || 0.5);
    let bias = mlp.layout().b3();
    for (parameter, value) in mlp.parameters_mut()[bias].iter_mut().zip(rgb) {
        *parameter = (value / (1.0 - value)).ln();
    }
    Field {
        bounds_m: (low, high),
        occupancy: full(voxel_m, low, high, step_m),
        levels: vec![level],
        activation,
        mlp,
        sky: Some(SkyMap::new(vec![SkyGrid::new(8, 4)])),
        step_growth: 0.0,
    }
}

/// Adds `logit(p)` to what the field's colours are before the logistic.
pub(super) fn tint(field: &mut Field, logit: impl Fn(Vec3) -> f32) {
    /// Keeps the network's first unit above 0.
    const LIFT: f32 = 10.0;
    let level = &mut field.levels[0];
    let voxel_m = level.voxel_m();
    let origins: Vec<Vec3> = (0..level.brick_count())
        .map(|b| level.brick_origin(level.positions()[b]))
        .collect();
    let (_, features) = level.parameters_mut();
    for (node, own) in features.iter_mut().enumerate().skip(BRICK_NODES) {
        let (brick, within) = (node / BRICK_NODES, node % BRICK_NODES);
        let step = |shift: u32| (within >> shift & (BRICK_SIDE - 1)) as f32;
        own[0] = logit(origins[brick] + Vec3::new(step(0), step(3), step(6)) * voxel_m);
    }
    let layout = field.mlp.layout();
    let parameters = field.mlp.parameters_mut();
    parameters[layout.w1().start] = 1.0;
    parameters[layout.b1().start] = LIFT;
    parameters[layout.w2().start] = 1.0;
    for c in 0..3 {
        parameters[layout.w3().start + c] = 1.0;
        parameters[layout.b3().start + c] -= LIFT;
    }
}

fn full(voxel_m: f32, low: Vec3, high: Vec3, step_m: f32) -> Occupancy {
    let mut occupancy = Occupancy::new(voxel_m, low, high - low).unwrap();
    occupancy.fill(step_m);
    occupancy
}
