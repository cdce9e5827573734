// Where `march_density` finds the other parts of split densities.

@group(0) @binding(9) var<storage, read> density_1: array<f32>;
@group(0) @binding(10) var<storage, read> density_2: array<f32>;
@group(0) @binding(11) var<storage, read> density_3: array<f32>;
