use std::sync::Arc;

use glam::{DVec3, UVec3, Vec3};
use half::f16;
use proptest::prelude::*;
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use super::*;
use crate::camera::Rigid;
use crate::class::ObjectClass;
use crate::field::occupancy::Space;
use crate::field::{
    BRICK_NODES, ColorMlp, DensityActivation, FEATURES, Lattice, Occupancy, SkyGrid, SkyMap,
};
use crate::quality::QualityReport;

/// A field with two levels, a sky and uneven values, from a small multiplicative generator.
fn asset() -> Asset {
    let mut state = 1u64;
    let mut unit = move || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 40) as f64 / (1u64 << 24) as f64
    };
    let low = Vec3::new(-1.0, 2.0, -0.5);
    let mut levels = Vec::new();
    for voxel in [0.4f32, 0.1] {
        let mut level = Lattice::new(voxel, low, Vec3::new(4.0, 3.0, 2.0)).unwrap();
        level.allocate([0, 0, 0]).unwrap();
        level.allocate([1, 0, 0]).unwrap();
        let (density, features) = level.parameters_mut();
        // Dense enough to be visible in every occupied cell.
        density[BRICK_NODES..].fill_with(|| (unit() * 9.0 + 1.0) as f32);
        features[BRICK_NODES..].fill_with(|| [(unit() * 2.0 - 1.0) as f32; FEATURES]);
        levels.push(level);
    }
    let mut occupancy = Occupancy::new(0.2, low, Vec3::new(4.0, 3.0, 2.0)).unwrap();
    occupancy.set_block(UVec3::ZERO, [u64::MAX, 3, 0, 0, 7, 0, 0, 1], 0.05);
    let mut sky = SkyGrid::new(8, 4);
    sky.logits_mut().fill_with(|| [unit() as f32, 0.5, -1.0]);
    Asset {
        header: header(),
        field: Arc::new(Field {
            bounds_m: (low, low + Vec3::new(4.0, 3.0, 2.0)),
            levels,
            activation: DensityActivation::from_alpha(1e-3, 0.1),
            mlp: ColorMlp::new(16, &mut unit),
            sky: Some(SkyMap::new(vec![sky])),
            occupancy,
            step_growth: 0.004,
        }),
    }
}

fn header() -> AssetHeader {
    AssetHeader {
        format_version: FORMAT_VERSION,
        kind: AssetKind::Object,
        class: ObjectClass::Car,
        size_m: DVec3::new(4.5, 1.8, 1.5),
        symmetric: true,
        usage: Usage::Library,
        usage_reason: String::new(),
        local_from_world: Rigid::from_heading(0.3, DVec3::new(1e6, -2e6, 3.0)),
        source_log: "driveLogs/a".to_owned(),
        source_track_id: "7".to_owned(),
        synthetic: true,
        quality: QualityReport::default(),
        coverage: None,
        recording: None,
        valid_region: None,
        ego_from_object: Vec::new(),
        color_space: ColorSpace::Srgb,
        exposure_ev: 0.0,
    }
}

#[test]
fn decodes_to_the_same_header_and_a_field_within_half_a_step() {
    let asset = asset();
    let back = Asset::decode(&asset.encode()).unwrap();
    assert_eq!(back.header, asset.header);
    assert_eq!(back.field.occupancy, asset.field.occupancy);
    assert_eq!(back.field.mlp, asset.field.mlp);
    let mut compared = 0;
    for i in 0..200 {
        let p = Vec3::new(-1.0, 2.0, -0.5) + Vec3::new(0.0123, 0.0051, 0.0039) * i as f32;
        let (a, b) = (asset.field.raw_density(p), back.field.raw_density(p));
        // Half a step of 1/32 on each of two levels.
        assert!((a - b).abs() <= 1.01 / 32.0, "{p}: {a} {b}");
        if !matches!(asset.field.occupancy.at(p), Space::Occupied { .. }) {
            continue;
        }
        compared += 1;
        let (a, b) = (asset.field.features(p), back.field.features(p));
        for (a, b) in a.iter().zip(b) {
            // Values up to 1 in steps of 1/31, on two levels.
            assert!((a - b).abs() < 1.02 / 31.0, "{p}: {a} {b}");
        }
    }
    assert!(compared > 40, "{compared}");
}

#[test]
fn large_densities_that_levels_hold_against_each_other_are_stored() {
    let mut asset = asset();
    let field = Arc::get_mut(&mut asset.field).unwrap();
    for (level, shift) in field.levels.iter_mut().zip([-3000.0, 3000.0]) {
        let (density, _) = level.parameters_mut();
        for value in &mut density[BRICK_NODES..] {
            *value += shift;
        }
    }
    let back = Asset::decode(&asset.encode()).unwrap();
    for i in 0..200 {
        let p = Vec3::new(-1.0, 2.0, -0.5) + Vec3::new(0.0123, 0.0051, 0.0039) * i as f32;
        let (a, b) = (asset.field.raw_density(p), back.field.raw_density(p));
        // Half a step of 1/8, the finest in which an i16 holds 3,000, on each of two levels.
        assert!((a - b).abs() <= 1.02 / 8.0, "{p}: {a} {b}");
    }
    assert_eq!(Asset::decode(&back.encode()).unwrap(), back);
}

#[test]
fn decoding_twice_changes_nothing_more() {
    let once = Asset::decode(&asset().encode()).unwrap();
    assert_eq!(Asset::decode(&once.encode()).unwrap(), once);
}

#[test]
fn zero_bricks_are_not_stored() {
    let mut asset = asset();
    let field = Arc::get_mut(&mut asset.field).unwrap();
    field.levels[1].allocate([2, 1, 0]).unwrap();
    let back = Asset::decode(&asset.encode()).unwrap();
    assert_eq!(back.field.levels[1].brick_count(), 3);
    assert_eq!(asset.field.levels[1].brick_count(), 4);
}

#[test]
fn the_header_is_read_without_the_field() {
    let asset = asset();
    let bytes = asset.encode();
    assert_eq!(Asset::decode_header(&bytes).unwrap(), asset.header);
    assert!(Asset::decode_header(&bytes[..12]).is_err());
    assert!(Asset::decode_header(b"not zstd").is_err());
}

#[test]
fn a_newer_version_is_refused_by_name() {
    let mut asset = asset();
    asset.header.format_version = FORMAT_VERSION + 1;
    let error = Asset::decode(&asset.encode()).unwrap_err().to_string();
    assert!(error.contains("newer"), "{error}");
}

#[test]
fn version_1_is_still_read_and_becomes_the_present_one_when_written() {
    let asset = asset();
    let back = Asset::decode(&version_1(&asset, f32::to_owned)).unwrap();
    assert_eq!(back.header.format_version, 1);
    for i in 0..200 {
        let p = Vec3::new(-1.0, 2.0, -0.5) + Vec3::new(0.0123, 0.0051, 0.0039) * i as f32;
        let (a, b) = (asset.field.raw_density(p), back.field.raw_density(p));
        // f16 has 11 bits: values up to 10 on two levels are within 2 * 10 * 2^-11.
        assert!((a - b).abs() < 0.01, "{p}: {a} {b}");
    }
    let again = Asset::decode(&back.encode()).unwrap();
    assert_eq!(again.header.format_version, FORMAT_VERSION);
}

#[test]
fn not_finite_values_in_the_bytes_are_refused_by_tensor() {
    let bytes = version_1(&asset(), |x| if *x > 0.9 { f32::NAN } else { *x });
    let error = Asset::decode(&bytes).unwrap_err().to_string();
    assert!(error.contains("level0.features"), "{error}");
}

/// The asset as version 1 stored it: f16, with features as `feature` changes them.
fn version_1(asset: &Asset, feature: impl Fn(&f32) -> f32) -> Vec<u8> {
    let plain = zstd::bulk::decompress(&asset.encode(), 1 << 24).unwrap();
    let (_, metadata) = SafeTensors::read_metadata(&plain).unwrap();
    let mut texts = metadata.metadata().clone().unwrap();
    for text in texts.values_mut() {
        *text = text
            .replace(
                &format!("\"format_version\":{FORMAT_VERSION}"),
                "\"format_version\":1",
            )
            .replace(",\"density_step\":0.03125", "");
    }
    let stored = SafeTensors::deserialize(&plain).unwrap();
    let halves = |values: &mut dyn Iterator<Item = f32>| -> Vec<u8> {
        values
            .flat_map(|x| f16::from_f32(x).to_le_bytes())
            .collect()
    };
    let mut tensors: Vec<(String, Dtype, Vec<usize>, Vec<u8>)> = Vec::new();
    for (name, view) in stored.tensors() {
        if !name.starts_with("level") || name.ends_with("positions") {
            tensors.push((
                name,
                view.dtype(),
                view.shape().to_vec(),
                view.data().to_vec(),
            ));
        }
    }
    for (l, level) in asset.field.levels.iter().enumerate() {
        let n = level.brick_count() - 1;
        let density = halves(&mut level.density()[BRICK_NODES..].iter().copied());
        let features = level.features()[BRICK_NODES..].as_flattened();
        let features = halves(&mut features.iter().map(&feature));
        let shape = vec![n, BRICK_NODES, FEATURES];
        tensors.push((
            format!("level{l}.density"),
            Dtype::F16,
            shape[..2].to_vec(),
            density,
        ));
        tensors.push((format!("level{l}.features"), Dtype::F16, shape, features));
    }
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (name, TensorView::new(*dtype, shape.clone(), bytes).unwrap())
    });
    let plain = safetensors::serialize(views, Some(texts)).unwrap();
    zstd::bulk::compress(&plain, 3).unwrap()
}

proptest! {
    #[test]
    fn damaged_bytes_never_panic(cut in 0usize..4_000, flips in prop::collection::vec((0usize..100_000, 0u8..8), 0..4)) {
        let mut plain = zstd::bulk::decompress(&asset().encode(), 1 << 24).unwrap();
        let len = plain.len();
        for (at, bit) in flips {
            // Half of the flips go to the header, which is where structure is.
            let at = if bit < 4 { at % 4_000.min(len) } else { at % len };
            plain[at] ^= 1 << bit;
        }
        plain.truncate(len - cut.min(len));
        let _ = Asset::decode(&zstd::bulk::compress(&plain, 1).unwrap());
        let _ = Asset::decode(&plain);
    }
}
