//! The repr(C) mirrors have the sizes and offsets that naga computes for the WGSL structs of the same name.

use std::collections::BTreeMap;
use std::mem::offset_of;

use backlot_shaders::kernels;
use backlot_shaders::layout::{
    Block, BrickPlace, GradientPoint, LayerParams, Level, MarchParams, Moments, PartParams, Ray,
    RayLoss, RaySample, RaySummary, RayTarget, SkyGrid, SlotSample, StepState, TrainParams, View,
};

use backlot_shaders::grid_layout::{
    GridParams, GridPoint, GridSample, GridSlot, MaskBlock, PixelRay, RayLight,
};
use backlot_shaders::scene_layout::{
    EyeParams, ObjectBox, RayHit, RayPairs, RayRequest, SampleList, SceneParams, SlotRange,
    Weighted,
};

/// Structs that never leave a kernel, so they have no mirror.
const INTERNAL: [&str; 13] = [
    "ByExposure",
    "Cell",
    "Corners",
    "Features",
    "Light",
    "Loss",
    "RawDensity",
    "SkyTexels",
    "Slopes",
    "Space",
    "TileRow",
    "Totals",
    "Walk",
];
/// What naga declares for compare-and-exchange.
const PREDECLARED: &str = "__atomic_compare_exchange_result";

/// Field name -> byte offset, and the array stride under the key "(stride)".
type Layout = BTreeMap<String, usize>;

macro_rules! mirror {
    ($name:ident { $($field:ident),* $(,)? } $(padded by $padding:ident)?) => {{
        let mut layout = Layout::from([("(stride)".to_owned(), size_of::<$name>())]);
        $( layout.insert(stringify!($field).to_owned(), offset_of!($name, $field)); )*
        // Names every field, so that one added to the struct alone does not compile.
        let $name { $($field: _,)* $($padding: _)? } = <$name as Default>::default();
        (stringify!($name).to_owned(), layout)
    }};
}

fn mirrors() -> BTreeMap<String, Layout> {
    BTreeMap::from([
        mirror!(Level {
            origin_m,
            voxel_m,
            bricks,
            index_start
        }),
        mirror!(Block { mask, step_m }),
        mirror!(Ray { origin_m, t_min, direction, t_max, stop_tau, phase } padded by padding),
        mirror!(RaySummary {
            tau,
            accumulation,
            weighted_distance_m,
            sample_count
        }),
        mirror!(RaySample { t, dt, sigma }),
        mirror!(MarchParams {
            low_m, base_voxel_m, high_m, act_shift, occupancy_origin_m, cell_m, blocks, level_count,
            step_growth, sigma_min, nudge_m, ray_count, sample_capacity, groups_x, first_ray
        } padded by padding),
        mirror!(TrainParams {
            base_voxel_m,
            level_count,
            sky_grid_count,
            ray_count,
            first_ray,
            step_ray_count,
            sample_capacity,
            step,
            min_weight,
            sample_color,
            entropy,
            depth_scale_m,
            depth_cap_m,
            depth_trim_m,
            depth_is_composited,
            rectified_is_printed,
            distortion,
            distortion_scale_m,
            density_rate,
            feature_rate,
            network_rate,
            sky_rate,
            density_variation_rate,
            feature_variation_rate,
            view_count,
            exposure_rate,
            pose_rate,
            exposure_prior,
            pose_prior,
            first_touched,
            touched_end,
            trim_quantile,
            sky_texel_count
        }),
        mirror!(RayTarget {
            color, color_weight, backdrop, silhouette_weight, range_m, range_weight, backdrop_kind, silhouette,
            view, mirrored
        } padded by padding),
        mirror!(SlotSample { ray, t }),
        mirror!(GradientPoint { position_m, raw, slot } padded by padding),
        mirror!(SkyGrid {
            width,
            height,
            start
        }),
        mirror!(RayLoss {
            squared_error,
            loss,
            range_error_m,
            is_color
        }),
        mirror!(StepState {
            squared_error,
            loss,
            color_rays,
            samples,
            colored,
            depth_trim_m,
            finite_steps,
            diverged
        }),
        mirror!(View {
            log_gain,
            bias,
            rotation,
            translation_m
        }),
        mirror!(Moments { mean, square }),
        mirror!(BrickPlace { position, level }),
        mirror!(LayerParams {
            input_quads,
            output_quads,
            shares,
            weight_blocks,
            first_block,
            first_bias
        }),
        mirror!(EyeParams {
            right, focal_x_px, down, focal_y_px, forward, principal_x_px, origin_m, principal_y_px, k, k3,
            distortion, stop_tau, first_ray, ray_count, groups_x
        } padded by padding),
        mirror!(RayRequest { x, y, sub, side }),
        mirror!(SceneParams {
            tone_gain, lowest_m, tone_offset, min_weight, first, count, groups_x, capacity, ray_capacity,
            slot_capacity, sky_grid_count, object, stop_tau, stop_tau_through_object, half_tau
        } padded by padding),
        mirror!(ObjectBox { half_m, floor_m }),
        mirror!(RayPairs { start, count }),
        mirror!(SampleList {
            count,
            cursor,
            object,
            total_weight,
            alone
        }),
        mirror!(Weighted { t, weight }),
        mirror!(RayHit {
            transmittance,
            half_t,
            background_half_t,
            z_per_m
        }),
        mirror!(SlotRange { first, count }),
        mirror!(PartParams {
            level_count,
            first_node,
            node_count,
            first_density
        }),
        mirror!(GridParams {
            nodes,
            ray_count,
            bricks,
            first_ray,
            low_m,
            step_m,
            high_m,
            sample_capacity,
            nodes_per_m,
            act_shift,
            backdrop,
            interval,
            raw_min,
            weight_min,
            ray_share,
            entropy,
            sample_color,
            density_rate,
            color_rate,
            step,
            is_masked,
            has_shares,
            first_brick,
            brick_end
        }),
        mirror!(PixelRay { origin_m, near_m, direction, stop_tau, color } padded by padding),
        mirror!(MaskBlock { bits, any }),
        mirror!(GridSample { q, tau, slope, weight, slot } padded by padding),
        mirror!(RayLight {
            left,
            sample_count,
            first_point
        }),
        mirror!(GridSlot { ray, sample }),
        mirror!(GridPoint { q, raw, slot } padded by padding),
    ])
}

#[test]
fn every_struct_of_every_kernel_has_an_equal_mirror() {
    let mirrors = mirrors();
    let mut compared = BTreeMap::new();
    for kernel in kernels::ALL {
        for (name, layout) in wgsl_structs(kernel.source) {
            let mirror = mirrors
                .get(&name)
                .unwrap_or_else(|| panic!("{name} has no mirror in layout.rs"));
            assert_eq!(mirror, &layout, "{name} (left: host, right: WGSL)");
            *compared.entry(name).or_insert(0) += layout.len() - 1;
        }
    }
    let fields: usize = compared.values().sum();
    println!("{} structs, {fields} fields compared", compared.len());
    assert_eq!(
        compared.len(),
        mirrors.len(),
        "a mirror was compared with nothing"
    );
}

#[test]
fn a_moved_field_is_noticed() {
    let source = kernels::MARCH_DENSITY.source;
    let moved = source.replacen("t_min: f32,", "pad: f32, t_min: f32,", 1);
    assert_ne!(moved, source, "the struct was not changed");
    assert_ne!(wgsl_structs(&moved)["Ray"], mirrors()["Ray"]);
}

fn wgsl_structs(source: &str) -> BTreeMap<String, Layout> {
    let module = naga::front::wgsl::parse_str(source).expect("the kernel parses");
    let structs = module
        .types
        .iter()
        .filter_map(|(_, ty)| match (&ty.name, &ty.inner) {
            (Some(name), naga::TypeInner::Struct { members, span })
                if !INTERNAL.contains(&name.as_str()) && !name.starts_with(PREDECLARED) =>
            {
                let mut layout = Layout::from([("(stride)".to_owned(), *span as usize)]);
                layout.extend(
                    members
                        .iter()
                        .map(|m| (m.name.clone().unwrap_or_default(), m.offset as usize)),
                );
                Some((name.clone(), layout))
            }
            _ => None,
        });
    structs.collect()
}
