// Where `merge_scene` finds the other parts of split densities.

@group(0) @binding(19) var<storage, read> density_1: array<f32>;
@group(0) @binding(20) var<storage, read> density_2: array<f32>;
@group(0) @binding(21) var<storage, read> density_3: array<f32>;
