//! Positional encoding of the viewing direction.

use glam::Vec3;

/// d, sin(2^k d), cos(2^k d) for k = 0..3: DVGO's 27 inputs.
pub const VIEW_INPUTS: usize = 27;

/// Encodes a unit direction.
pub fn encode_view(direction: Vec3) -> [f32; VIEW_INPUTS] {
    let mut out = [0.0; VIEW_INPUTS];
    let d = direction.to_array();
    out[..3].copy_from_slice(&d);
    for (axis, value) in d.into_iter().enumerate() {
        for octave in 0..4 {
            let (sin, cos) = libm::sincosf(value * (1 << octave) as f32);
            out[3 + axis * 4 + octave] = sin;
            out[15 + axis * 4 + octave] = cos;
        }
    }
    out
}
