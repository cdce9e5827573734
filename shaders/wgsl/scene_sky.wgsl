// Fills the light that a ray has left with the sky; one thread a ray.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: SceneParams;
@group(0) @binding(1) var<storage, read> rays: array<Ray>;
@group(0) @binding(2) var<storage, read> hits: array<RayHit>;
@group(0) @binding(3) var<storage, read> sky_grids: array<SkyGrid>;
@group(0) @binding(4) var<storage, read> sky_logits: array<f32>;
@group(0) @binding(5) var<storage, read_write> colors: array<vec4<f32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn scene_sky(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let number = (group.y * params.groups_x + group.x) * WORKGROUP_SIZE + local;
    if number >= params.count {
        return;
    }
    let ray = params.first + number;
    let sky = hits[ray].transmittance * sky_color(rays[ray].direction);
    colors[ray] = vec4<f32>(colors[ray].xyz + sky, 0.0);
}
