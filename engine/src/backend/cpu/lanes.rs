//! Vectors of f32 lanes, one type per register width.
//!
//! Loops over plain arrays leave the accumulators of a register tile in memory (seen in the disassembly: one store and one
//! load per multiplication, a fifth of the speed), so tiles are written with these types.

/// A register of f32 lanes.
///
/// Methods are compiled into their caller and must only run where the register's instructions exist; [`super::Simd`] sees to it.
pub(crate) trait Lanes: Copy {
    const WIDTH: usize;

    fn splat(x: f32) -> Self;

    /// Reads the first lanes of a slice.
    fn load(from: &[f32]) -> Self;

    /// Writes to the first values of a slice.
    fn store(self, to: &mut [f32]);

    /// `self * a + b`.
    fn multiply_add(self, a: Self, b: Self) -> Self;

    fn max(self, other: Self) -> Self;
}

/// Four lanes with separate multiplication and addition: every target's baseline.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lanes4([f32; 4]);

impl Lanes for Lanes4 {
    const WIDTH: usize = 4;

    #[inline(always)]
    fn splat(x: f32) -> Self {
        Self([x; 4])
    }

    #[inline(always)]
    fn load(from: &[f32]) -> Self {
        Self([from[0], from[1], from[2], from[3]])
    }

    #[inline(always)]
    fn store(self, to: &mut [f32]) {
        to[..4].copy_from_slice(&self.0);
    }

    #[inline(always)]
    fn multiply_add(self, a: Self, b: Self) -> Self {
        let (x, a, b) = (self.0, a.0, b.0);
        Self([
            x[0] * a[0] + b[0],
            x[1] * a[1] + b[1],
            x[2] * a[2] + b[2],
            x[3] * a[3] + b[3],
        ])
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        let (a, b) = (self.0, other.0);
        Self([
            a[0].max(b[0]),
            a[1].max(b[1]),
            a[2].max(b[2]),
            a[3].max(b[3]),
        ])
    }
}

#[cfg(target_arch = "x86_64")]
pub(crate) use x86::{Lanes8, Lanes16};

#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256, __m512, _mm256_fmadd_ps, _mm256_loadu_ps, _mm256_max_ps, _mm256_set1_ps,
        _mm256_storeu_ps, _mm512_fmadd_ps, _mm512_loadu_ps, _mm512_max_ps, _mm512_set1_ps,
        _mm512_storeu_ps,
    };

    use super::Lanes;

    /// Eight lanes: AVX2 and FMA.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Lanes8(__m256);

    /// Sixteen lanes: AVX-512 F.
    #[derive(Clone, Copy, Debug)]
    pub(crate) struct Lanes16(__m512);

    macro_rules! lanes {
        ($name:ident, $width:literal, $set:ident, $load:ident, $store:ident, $fma:ident, $max:ident) => {
            impl Lanes for $name {
                const WIDTH: usize = $width;

                #[inline(always)]
                fn splat(x: f32) -> Self {
                    // SAFETY: only called on paths whose features were detected.
                    Self(unsafe { $set(x) })
                }

                #[inline(always)]
                fn load(from: &[f32]) -> Self {
                    let from = &from[..$width];
                    // SAFETY: the slice holds all lanes; features as above.
                    Self(unsafe { $load(from.as_ptr()) })
                }

                #[inline(always)]
                fn store(self, to: &mut [f32]) {
                    let to = &mut to[..$width];
                    // SAFETY: the slice holds all lanes; features as above.
                    unsafe { $store(to.as_mut_ptr(), self.0) }
                }

                #[inline(always)]
                fn multiply_add(self, a: Self, b: Self) -> Self {
                    // SAFETY: features as above.
                    Self(unsafe { $fma(self.0, a.0, b.0) })
                }

                #[inline(always)]
                fn max(self, other: Self) -> Self {
                    // SAFETY: features as above.
                    Self(unsafe { $max(self.0, other.0) })
                }
            }
        };
    }

    lanes!(
        Lanes8,
        8,
        _mm256_set1_ps,
        _mm256_loadu_ps,
        _mm256_storeu_ps,
        _mm256_fmadd_ps,
        _mm256_max_ps
    );
    lanes!(
        Lanes16,
        16,
        _mm512_set1_ps,
        _mm512_loadu_ps,
        _mm512_storeu_ps,
        _mm512_fmadd_ps,
        _mm512_max_ps
    );
}
