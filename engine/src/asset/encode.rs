//! Asset to bytes.

use std::collections::HashMap;

use half::f16;
use half::slice::HalfFloatSliceExt;
use rayon::prelude::*;
use safetensors::Dtype;
use safetensors::tensor::TensorView;

use super::Asset;
use super::layout::{FIELD_KEY, FieldLayout, GridLayout, HEADER_KEY};
use super::quantize::{density_step, density_steps, feature_steps};
use super::visible::{NodeBits, VisibleCells};
use super::{AssetHeader, FORMAT_VERSION};
use crate::field::{BRICK_NODES, FEATURES, Field, Lattice, Occupancy, SkyGrid};

/// Trained grids shrink by under 1 % at level 9, which costs several times the time.
const ZSTD_LEVEL: i32 = 3;

/// One tensor waiting to be written.
struct Tensor {
    name: String,
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Asset {
    /// The stored form of the asset in the present format version; see the module `layout` for the format. Densities and
    /// features are rounded to fixed steps, and features that no visible sample reads are left out.
    pub fn encode(&self) -> Vec<u8> {
        let mut tensors = Vec::new();
        let visible = VisibleCells::of(&self.field);
        let raw = self.field.levels.iter().flat_map(|l| l.density());
        let step = density_step(raw.copied());
        let levels = self.field.levels.par_iter().enumerate();
        let levels = levels.map(|(l, level)| level_tensors(l, level, step, &visible.nodes(level)));
        tensors.extend(levels.collect::<Vec<_>>().into_iter().flatten());
        let mlp = self.field.mlp.parameters();
        tensors.push(Tensor {
            name: "mlp".to_owned(),
            dtype: Dtype::F32,
            shape: vec![mlp.len()],
            bytes: bytemuck::cast_slice(mlp).to_vec(),
        });
        let grids = self.field.sky.as_ref().map_or(&[][..], |sky| sky.grids());
        tensors.extend(grids.iter().enumerate().map(sky_tensor));
        tensors.extend(occupancy_tensors(&self.field.occupancy));
        let header = AssetHeader {
            format_version: self.header.format_version.max(FORMAT_VERSION),
            ..self.header.clone()
        };
        let metadata = HashMap::from([
            (HEADER_KEY.to_owned(), json(&header)),
            (FIELD_KEY.to_owned(), json(&field_layout(&self.field, step))),
        ]);
        let views = tensors.iter().map(|t| {
            let view = TensorView::new(t.dtype, t.shape.clone(), &t.bytes);
            (&t.name, view.expect("tensor bytes match their shape"))
        });
        let plain = safetensors::serialize(views, Some(metadata)).expect("tensors are sound");
        zstd::bulk::compress(&plain, ZSTD_LEVEL).expect("memory compresses")
    }
}

fn json(value: &impl serde::Serialize) -> String {
    serde_json::to_string(value).expect("headers are plain values")
}

fn field_layout(field: &Field, density_step: f32) -> FieldLayout {
    let occupancy = &field.occupancy;
    let grid = |level: &Lattice| GridLayout {
        cell_m: level.voxel_m(),
        origin_m: level.origin_m().to_array(),
        extent: level.bricks_per_axis().to_array(),
    };
    FieldLayout {
        bounds_m: [field.bounds_m.0.to_array(), field.bounds_m.1.to_array()],
        levels: field.levels.iter().map(grid).collect(),
        activation: field.activation,
        mlp_width: field.mlp.width(),
        sky_grids: field.sky.as_ref().map_or(0, |sky| sky.grids().len()),
        occupancy: GridLayout {
            cell_m: occupancy.cell_m(),
            origin_m: occupancy.origin_m().to_array(),
            extent: occupancy.blocks_per_axis().to_array(),
        },
        step_growth: field.step_growth,
        density_step,
    }
}

fn to_f16_bytes(values: &[f32]) -> Vec<u8> {
    let mut halves = vec![f16::ZERO; values.len()];
    halves.convert_from_f32_slice(values);
    bytemuck::cast_slice(&halves).to_vec()
}

fn level_tensors(
    l: usize,
    level: &Lattice,
    density_step: f32,
    visible: &[NodeBits],
) -> [Tensor; 4] {
    let mut positions: Vec<[u16; 3]> = Vec::new();
    let (mut density, mut features, mut scales) = (Vec::new(), Vec::new(), Vec::new());
    for (brick, seen) in visible.iter().enumerate().skip(1) {
        let nodes = brick * BRICK_NODES..(brick + 1) * BRICK_NODES;
        let raw = density_steps(&level.density()[nodes.clone()], density_step);
        let (color, scale) = feature_steps(&visible_features(&level.features()[nodes], seen));
        if raw.iter().all(|x| *x == 0) && color.as_flattened().iter().all(|x| *x == 0) {
            continue;
        }
        positions.push(level.positions()[brick]);
        density.extend(raw);
        features.extend_from_slice(color.as_flattened());
        scales.extend(scale);
    }
    let n = positions.len();
    let tensor = |name: &str, dtype, shape, bytes| Tensor {
        name: format!("level{l}.{name}"),
        dtype,
        shape,
        bytes,
    };
    // Low and high bytes apart: the high ones hardly vary, and zstd sees that.
    let plane = |shift: u32| density.iter().map(move |x| (*x as u16 >> shift) as u8);
    let planes: Vec<u8> = plane(0).chain(plane(8)).collect();
    let places = bytemuck::cast_slice(&positions).to_vec();
    let features = bytemuck::cast_slice(&features).to_vec();
    let scales = bytemuck::cast_slice(&scales).to_vec();
    [
        tensor("positions", Dtype::U16, vec![n, 3], places),
        tensor("density", Dtype::U8, vec![2, n, BRICK_NODES], planes),
        tensor(
            "features",
            Dtype::I8,
            vec![n, BRICK_NODES, FEATURES],
            features,
        ),
        tensor("feature_scales", Dtype::F16, vec![n, FEATURES], scales),
    ]
}

/// A brick's features, 0 where a node is not visible.
fn visible_features(features: &[[f32; FEATURES]], visible: &NodeBits) -> Vec<[f32; FEATURES]> {
    let nodes = features.iter().enumerate();
    let kept = nodes.map(
        |(node, values)| match visible[node >> 6] >> (node & 63) & 1 {
            1 => *values,
            _ => [0.0; FEATURES],
        },
    );
    kept.collect()
}

fn sky_tensor((g, grid): (usize, &SkyGrid)) -> Tensor {
    Tensor {
        name: format!("sky{g}"),
        dtype: Dtype::F16,
        shape: vec![grid.height() as usize, grid.width() as usize, 3],
        bytes: to_f16_bytes(grid.logits().as_flattened()),
    }
}

fn occupancy_tensors(occupancy: &Occupancy) -> [Tensor; 3] {
    let extent = occupancy.blocks_per_axis();
    let mut blocks: Vec<[u16; 3]> = Vec::new();
    let (mut masks, mut steps): (Vec<[u64; 8]>, Vec<f32>) = (Vec::new(), Vec::new());
    for (at, stored) in occupancy.index().iter().enumerate() {
        if *stored == 0 {
            continue;
        }
        let at = at as u32;
        let block = [
            at % extent.x,
            at / extent.x % extent.y,
            at / (extent.x * extent.y),
        ];
        blocks.push(block.map(|c| c as u16));
        masks.push(occupancy.masks()[*stored as usize]);
        steps.push(occupancy.steps_m()[*stored as usize]);
    }
    let m = blocks.len();
    let tensor = |name: &str, dtype, shape, bytes: &[u8]| Tensor {
        name: format!("occupancy.{name}"),
        dtype,
        shape,
        bytes: bytes.to_vec(),
    };
    [
        tensor(
            "blocks",
            Dtype::U16,
            vec![m, 3],
            bytemuck::cast_slice(&blocks),
        ),
        tensor(
            "masks",
            Dtype::U64,
            vec![m, 8],
            bytemuck::cast_slice(&masks),
        ),
        tensor("steps", Dtype::F32, vec![m], bytemuck::cast_slice(&steps)),
    ]
}
