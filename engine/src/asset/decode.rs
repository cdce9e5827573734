//! Bytes to asset. Nothing in the bytes is trusted.

use std::io::Read;

use glam::{UVec3, Vec3};
use half::f16;
use safetensors::tensor::{Metadata, SafeTensors};
use safetensors::{Dtype, tensor::TensorView};

use super::layout::{
    FIELD_KEY, FieldLayout, GridLayout, HEADER_KEY, MAX_LEVELS, MAX_SKY_GRIDS, MAX_UNPACKED_BYTES,
};
use super::{Asset, AssetHeader, FORMAT_VERSION};
use crate::field::{BRICK_NODES, ColorMlp, FEATURES, Field, Lattice, Occupancy, SkyGrid, SkyMap};
use crate::{Error, Result};

/// Texels per axis of a stored sky grid.
const MAX_SKY_SIDE: usize = 16_384;

impl Asset {
    /// Reads what [`Asset::encode`] wrote.
    ///
    /// # Errors
    /// [`Error::Corrupt`] naming the part that does not decode, also for a newer format version.
    pub fn decode(bytes: &[u8]) -> Result<Self> {
        let plain = unpack(bytes)?;
        let (_, metadata) = SafeTensors::read_metadata(&plain)
            .map_err(|e| corrupt(format!("tensor header: {e}")))?;
        let tensors =
            SafeTensors::deserialize(&plain).map_err(|e| corrupt(format!("tensors: {e}")))?;
        let header: AssetHeader = json(&metadata, HEADER_KEY)?;
        if header.format_version > FORMAT_VERSION {
            return Err(newer(header.format_version));
        }
        let layout: FieldLayout = json(&metadata, FIELD_KEY)?;
        let field = read_field(&tensors, &layout, header.format_version)?;
        Ok(Self {
            header,
            field: field.into(),
        })
    }
}

/// Longest safetensors header: JSON texts with a recording of 50,000 frames and a valid region.
const MAX_HEADER_BYTES: u64 = 256 << 20;

impl Asset {
    /// Reads the header alone, without unpacking the field.
    ///
    /// # Errors
    /// As [`Asset::decode`].
    pub fn decode_header(bytes: &[u8]) -> Result<AssetHeader> {
        let frame = |e: std::io::Error| corrupt(format!("zstd frame: {e}"));
        let mut decoder = zstd::stream::read::Decoder::with_buffer(bytes).map_err(frame)?;
        // A safetensors file begins with the length of its JSON header.
        let mut length = [0; 8];
        decoder.read_exact(&mut length).map_err(frame)?;
        let length_bytes = u64::from_le_bytes(length);
        if length_bytes > MAX_HEADER_BYTES {
            return Err(corrupt(format!("tensor header of {length_bytes} bytes")));
        }
        let mut text = Vec::new();
        decoder
            .take(length_bytes)
            .read_to_end(&mut text)
            .map_err(frame)?;
        let metadata: Metadata =
            serde_json::from_slice(&text).map_err(|e| corrupt(format!("tensor header: {e}")))?;
        let header: AssetHeader = json(&metadata, HEADER_KEY)?;
        if header.format_version > FORMAT_VERSION {
            return Err(newer(header.format_version));
        }
        Ok(header)
    }
}

fn newer(version: u32) -> Error {
    corrupt(format!(
        "format version {version} is newer than {FORMAT_VERSION}; update this program"
    ))
}

fn corrupt(what: impl Into<String>) -> Error {
    Error::Corrupt { what: what.into() }
}

fn unpack(bytes: &[u8]) -> Result<Vec<u8>> {
    let frame = |e: std::io::Error| corrupt(format!("zstd frame: {e}"));
    let decoder = zstd::stream::read::Decoder::with_buffer(bytes).map_err(frame)?;
    let mut plain = Vec::new();
    decoder
        .take(MAX_UNPACKED_BYTES + 1)
        .read_to_end(&mut plain)
        .map_err(frame)?;
    if plain.len() as u64 > MAX_UNPACKED_BYTES {
        return Err(corrupt(format!(
            "payload unpacks to more than {MAX_UNPACKED_BYTES} bytes"
        )));
    }
    Ok(plain)
}

fn json<T: serde::de::DeserializeOwned>(metadata: &Metadata, key: &str) -> Result<T> {
    let entries = metadata.metadata().as_ref();
    let text = entries
        .and_then(|entries| entries.get(key))
        .ok_or_else(|| corrupt(format!("{key} is missing")))?;
    serde_json::from_str(text).map_err(|e| corrupt(format!("{key}: {e}")))
}

fn read_field(tensors: &SafeTensors<'_>, layout: &FieldLayout, version: u32) -> Result<Field> {
    if layout.levels.is_empty() || layout.levels.len() > MAX_LEVELS {
        return Err(corrupt(format!("{} levels", layout.levels.len())));
    }
    let levels = layout.levels.iter().enumerate();
    let step = match version {
        1 => None,
        _ => Some(layout.density_step),
    };
    let levels = levels.map(|(l, grid)| read_level(tensors, l, grid, step));
    let bounds_m = layout.bounds_m.map(Vec3::from);
    let sound = bounds_m[0].cmplt(bounds_m[1]).all()
        && bounds_m.iter().all(|corner| corner.is_finite())
        && layout.activation.act_shift.is_finite()
        && layout.activation.base_voxel_m.is_finite()
        && layout.activation.base_voxel_m > 0.0
        && (0.0..1.0).contains(&layout.step_growth)
        && layout.density_step.is_finite();
    if !sound {
        return Err(corrupt(format!("{FIELD_KEY}: numbers out of range")));
    }
    let mlp = floats(tensors, "mlp", &[None])?;
    let mlp = ColorMlp::from_parameters(layout.mlp_width, mlp)
        .ok_or_else(|| corrupt(format!("mlp does not fit width {}", layout.mlp_width)))?;
    Ok(Field {
        bounds_m: (bounds_m[0], bounds_m[1]),
        levels: levels.collect::<Result<_>>()?,
        activation: layout.activation,
        mlp,
        sky: read_sky(tensors, layout.sky_grids)?,
        occupancy: read_occupancy(tensors, &layout.occupancy)?,
        step_growth: layout.step_growth,
    })
}

/// A tensor of the wanted type whose shape matches; `None` in `shape` is any length.
fn tensor<'a>(
    tensors: &SafeTensors<'a>,
    name: &str,
    dtype: Dtype,
    shape: &[Option<usize>],
) -> Result<TensorView<'a>> {
    let view = tensors
        .tensor(name)
        .map_err(|e| corrupt(format!("tensor {name}: {e}")))?;
    let fits = view.shape().len() == shape.len()
        && (view.shape().iter().zip(shape)).all(|(have, want)| want.is_none_or(|w| w == *have));
    if view.dtype() != dtype || !fits {
        return Err(corrupt(format!(
            "tensor {name} is {:?} {:?}, wanted {dtype:?} {shape:?}",
            view.dtype(),
            view.shape()
        )));
    }
    Ok(view)
}

/// An F32 or F16 tensor as finite f32.
fn floats(tensors: &SafeTensors<'_>, name: &str, shape: &[Option<usize>]) -> Result<Vec<f32>> {
    let values: Vec<f32> = match tensor(tensors, name, Dtype::F16, shape) {
        Ok(view) => (view.data().chunks_exact(2))
            .map(|b| f16::from_le_bytes([b[0], b[1]]).to_f32())
            .collect(),
        Err(_) => (tensor(tensors, name, Dtype::F32, shape)?
            .data()
            .chunks_exact(4))
        .map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        .collect(),
    };
    if let Some(at) = values.iter().position(|x| !x.is_finite()) {
        return Err(corrupt(format!("tensor {name}[{at}] is not finite")));
    }
    Ok(values)
}

/// Positions `[n, 3]` of a U16 tensor, each inside `extent` and none twice.
fn positions(tensors: &SafeTensors<'_>, name: &str, extent: UVec3) -> Result<Vec<[u16; 3]>> {
    let view = tensor(tensors, name, Dtype::U16, &[None, Some(3)])?;
    let read = |b: &[u8]| [0, 2, 4].map(|i| u16::from_le_bytes([b[i], b[i + 1]]));
    let positions: Vec<[u16; 3]> = view.data().chunks_exact(6).map(read).collect();
    let mut sorted = positions.clone();
    sorted.sort_unstable();
    sorted.dedup();
    let inside = |p: &[u16; 3]| UVec3::from(p.map(u32::from)).cmplt(extent).all();
    if sorted.len() != positions.len() || !positions.iter().all(inside) {
        return Err(corrupt(format!("tensor {name} repeats or leaves the grid")));
    }
    Ok(positions)
}

/// `density_step` is that of the rounded values of version 2; version 1 has f16 values.
fn read_level(
    tensors: &SafeTensors<'_>,
    l: usize,
    grid: &GridLayout,
    density_step: Option<f32>,
) -> Result<Lattice> {
    let extent = UVec3::from(grid.extent);
    let mut level = Lattice::with_bricks(grid.cell_m, grid.origin_m.into(), extent)
        .ok_or_else(|| corrupt(format!("level {l}: grid {grid:?}")))?;
    let bricks = positions(tensors, &format!("level{l}.positions"), extent)?;
    let (density, features) = match density_step {
        None => half_values(tensors, l, bricks.len())?,
        Some(step) => stepped_values(tensors, l, bricks.len(), step)?,
    };
    level.reserve(bricks.len());
    for position in bricks {
        level.allocate(position).expect("positions were checked");
    }
    let (to_density, to_features) = level.parameters_mut();
    to_density[BRICK_NODES..].copy_from_slice(&density);
    to_features[BRICK_NODES..]
        .as_flattened_mut()
        .copy_from_slice(&features);
    Ok(level)
}

/// Densities and features of version 1: f16.
fn half_values(tensors: &SafeTensors<'_>, l: usize, n: usize) -> Result<(Vec<f32>, Vec<f32>)> {
    let nodes = [Some(n), Some(BRICK_NODES), Some(FEATURES)];
    Ok((
        floats(tensors, &format!("level{l}.density"), &nodes[..2])?,
        floats(tensors, &format!("level{l}.features"), &nodes)?,
    ))
}

/// Densities in two planes of bytes, and features with a scale per brick and channel.
fn stepped_values(
    tensors: &SafeTensors<'_>,
    l: usize,
    n: usize,
    step: f32,
) -> Result<(Vec<f32>, Vec<f32>)> {
    let nodes = [Some(2), Some(n), Some(BRICK_NODES)];
    let planes = tensor(tensors, &format!("level{l}.density"), Dtype::U8, &nodes)?;
    let (low, high) = planes.data().split_at(n * BRICK_NODES);
    let density = low.iter().zip(high);
    let density = density.map(|(low, high)| f32::from(i16::from_le_bytes([*low, *high])) * step);
    let scales = format!("level{l}.feature_scales");
    let scales = floats(tensors, &scales, &[Some(n), Some(FEATURES)])?;
    let nodes = [Some(n), Some(BRICK_NODES), Some(FEATURES)];
    let steps = tensor(tensors, &format!("level{l}.features"), Dtype::I8, &nodes)?;
    let mut features = Vec::with_capacity(n * BRICK_NODES * FEATURES);
    let bricks = steps.data().chunks_exact(BRICK_NODES * FEATURES);
    for (brick, scales) in bricks.zip(scales.chunks_exact(FEATURES)) {
        for node in brick.chunks_exact(FEATURES) {
            let values = node.iter().zip(scales);
            features.extend(values.map(|(step, scale)| f32::from(*step as i8) * scale));
        }
    }
    Ok((density.collect(), features))
}

fn read_sky(tensors: &SafeTensors<'_>, grids: usize) -> Result<Option<SkyMap>> {
    if grids == 0 {
        return Ok(None);
    }
    if grids > MAX_SKY_GRIDS {
        return Err(corrupt(format!("{grids} sky grids")));
    }
    let mut maps = Vec::with_capacity(grids);
    for g in 0..grids {
        let name = format!("sky{g}");
        let view = tensor(tensors, &name, Dtype::F16, &[None, None, Some(3)])?;
        let (height, width) = (view.shape()[0], view.shape()[1]);
        if !(1..=MAX_SKY_SIDE).contains(&height) || !(1..=MAX_SKY_SIDE).contains(&width) {
            return Err(corrupt(format!("{name} is {width}x{height}")));
        }
        let logits = floats(tensors, &name, &[None, None, Some(3)])?;
        let mut grid = SkyGrid::new(width as u32, height as u32);
        grid.logits_mut()
            .as_flattened_mut()
            .copy_from_slice(&logits);
        maps.push(grid);
    }
    Ok(Some(SkyMap::new(maps)))
}

fn read_occupancy(tensors: &SafeTensors<'_>, grid: &GridLayout) -> Result<Occupancy> {
    let extent = UVec3::from(grid.extent);
    let mut occupancy = Occupancy::with_blocks(grid.cell_m, grid.origin_m.into(), extent)
        .ok_or_else(|| corrupt(format!("occupancy: grid {grid:?}")))?;
    let blocks = positions(tensors, "occupancy.blocks", extent)?;
    let m = Some(blocks.len());
    let masks = tensor(tensors, "occupancy.masks", Dtype::U64, &[m, Some(8)])?;
    let steps = floats(tensors, "occupancy.steps", &[m])?;
    if steps.iter().any(|step| *step <= 0.0) {
        return Err(corrupt("tensor occupancy.steps has a step of 0 or less"));
    }
    let words = masks.data().chunks_exact(64);
    for ((block, bytes), step_m) in blocks.iter().zip(words).zip(steps) {
        let mut mask = [0; 8];
        for (word, b) in mask.iter_mut().zip(bytes.chunks_exact(8)) {
            *word = u64::from_le_bytes(b.try_into().expect("eight bytes"));
        }
        occupancy.set_block(UVec3::from(block.map(u32::from)), mask, step_m);
    }
    Ok(occupancy)
}
