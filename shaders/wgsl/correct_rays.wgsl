// Moves rays as the poses of their views are corrected; one thread a ray. A mirrored ray is moved where it was recorded, then mirrored
// again.

override WORKGROUP_SIZE: u32;

@group(0) @binding(0) var<uniform> params: TrainParams;
@group(0) @binding(1) var<storage, read> targets: array<RayTarget>;
@group(0) @binding(2) var<storage, read> views: array<View>;
@group(0) @binding(3) var<storage, read_write> rays: array<Ray>;
@group(0) @binding(4) var<storage, read_write> view_sums: array<atomic<u32>>;

@compute @workgroup_size(WORKGROUP_SIZE)
fn correct_rays(@builtin(global_invocation_id) id: vec3<u32>) {
    if id.x >= params.ray_count {
        return;
    }
    let goal = targets[id.x];
    atomicStore(&view_sums[VIEW_SUMS * goal.view + IS_SEEN], 1u);
    let view = views[goal.view];
    var origin_m = rays[id.x].origin_m;
    var direction = rays[id.x].direction;
    if goal.mirrored != 0u {
        origin_m = reflected(origin_m);
        direction = reflected(direction);
    }
    origin_m = rotated(view.rotation, origin_m) + view.translation_m.xyz;
    direction = rotated(view.rotation, direction);
    if goal.mirrored != 0u {
        origin_m = reflected(origin_m);
        direction = reflected(direction);
    }
    rays[id.x].origin_m = origin_m;
    rays[id.x].direction = direction;
}
