use glam::{DVec3, UVec3, Vec3};
use proptest::prelude::*;

use super::*;
use crate::camera::Rigid;
use crate::class::ObjectClass;
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
        density[BRICK_NODES..].fill_with(|| (unit() * 20.0 - 10.0) as f32);
        features[BRICK_NODES..].fill_with(|| [(unit() * 2.0 - 1.0) as f32; FEATURES]);
        levels.push(level);
    }
    let mut occupancy = Occupancy::new(0.2, low, Vec3::new(4.0, 3.0, 2.0)).unwrap();
    occupancy.set_block(UVec3::ZERO, [u64::MAX, 3, 0, 0, 7, 0, 0, 1], 0.05);
    let mut sky = SkyGrid::new(8, 4);
    sky.logits_mut().fill_with(|| [unit() as f32, 0.5, -1.0]);
    Asset {
        header: header(),
        field: Field {
            bounds_m: (low, low + Vec3::new(4.0, 3.0, 2.0)),
            levels,
            activation: DensityActivation::from_alpha(1e-3, 0.1),
            mlp: ColorMlp::new(16, &mut unit),
            sky: Some(SkyMap::new(vec![sky])),
            occupancy,
            step_growth: 0.004,
        },
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
fn decodes_to_the_same_header_and_a_field_within_half_precision() {
    let asset = asset();
    let back = Asset::decode(&asset.encode()).unwrap();
    assert_eq!(back.header, asset.header);
    assert_eq!(back.field.occupancy, asset.field.occupancy);
    assert_eq!(back.field.mlp, asset.field.mlp);
    for i in 0..200 {
        let p = Vec3::new(-1.0, 2.0, -0.5) + Vec3::new(0.0123, 0.0051, 0.0039) * i as f32;
        let (a, b) = (asset.field.raw_density(p), back.field.raw_density(p));
        // f16 has 11 bits: values up to 10 on two levels are within 2 * 10 * 2^-11.
        assert!((a - b).abs() < 0.01, "{p}: {a} {b}");
    }
}

#[test]
fn decoding_twice_changes_nothing_more() {
    let once = Asset::decode(&asset().encode()).unwrap();
    assert_eq!(Asset::decode(&once.encode()).unwrap(), once);
}

#[test]
fn zero_bricks_are_not_stored() {
    let mut asset = asset();
    asset.field.levels[1].allocate([2, 1, 0]).unwrap();
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
fn not_finite_parameters_are_refused() {
    let mut asset = asset();
    asset.field.levels[0].parameters_mut().1[BRICK_NODES][3] = f32::NAN;
    let error = Asset::decode(&asset.encode()).unwrap_err().to_string();
    assert!(error.contains("level0.features"), "{error}");
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
