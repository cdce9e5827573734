//! Which instruction set the kernels run on.

use std::sync::OnceLock;

/// An instruction-set path. All compute the same sums; they differ in rounding only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Simd {
    /// The target's baseline with separate multiplication and addition: the path other backends are compared with.
    Baseline,
    /// AVX2 with fused multiply-add.
    Avx2,
    /// AVX-512 F, VL, DQ and BW.
    Avx512,
}

impl Simd {
    /// The widest path of this machine.
    pub fn detect() -> Self {
        static DETECTED: OnceLock<Simd> = OnceLock::new();
        *DETECTED.get_or_init(detect)
    }

    /// Every path this machine can run.
    pub fn available() -> Vec<Self> {
        match Self::detect() {
            Self::Baseline => vec![Self::Baseline],
            Self::Avx2 => vec![Self::Baseline, Self::Avx2],
            Self::Avx512 => vec![Self::Baseline, Self::Avx2, Self::Avx512],
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn detect() -> Simd {
    let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
    let avx512 = avx2
        && is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512vl")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512bw");
    match (avx512, avx2) {
        (true, _) => Simd::Avx512,
        (false, true) => Simd::Avx2,
        (false, false) => Simd::Baseline,
    }
}

#[cfg(not(target_arch = "x86_64"))]
fn detect() -> Simd {
    Simd::Baseline
}

/// Defines `$name(simd, args...)`, which calls the generic `$body::<L, ROWS, VECTORS>` compiled for the path `simd`.
///
/// With `fn $name<const C>`, the body and the arguments' types have C after the three.
/// L is the path's register; ROWS x VECTORS of them are the tile of the matrix kernels, leaving some for operands.
macro_rules! dispatch {
    ($vis:vis fn $name:ident<const $c:ident> => $body:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $vis fn $name<const $c: usize>(simd: $crate::backend::cpu::Simd, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
            fn avx512<const $c: usize>($($arg: $ty),*) {
                $body::<$crate::backend::cpu::lanes::Lanes16, 6, 4, $c>($($arg),*);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2<const $c: usize>($($arg: $ty),*) {
                $body::<$crate::backend::cpu::lanes::Lanes8, 6, 2, $c>($($arg),*);
            }
            match simd {
                // SAFETY: `Simd::detect` names a path only where the machine has its features.
                #[cfg(target_arch = "x86_64")]
                $crate::backend::cpu::Simd::Avx512 => unsafe { avx512($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::backend::cpu::Simd::Avx2 => unsafe { avx2($($arg),*) },
                _ => $body::<$crate::backend::cpu::lanes::Lanes4, 4, 2, $c>($($arg),*),
            }
        }
    };
    ($(#[$meta:meta])* $vis:vis fn $name:ident => $body:ident($($arg:ident: $ty:ty),* $(,)?)) => {
        $(#[$meta])*
        $vis fn $name(simd: $crate::backend::cpu::Simd, $($arg: $ty),*) {
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx512bw,avx2,fma")]
            fn avx512($($arg: $ty),*) {
                $body::<$crate::backend::cpu::lanes::Lanes16, 6, 4>($($arg),*);
            }
            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,fma")]
            fn avx2($($arg: $ty),*) {
                $body::<$crate::backend::cpu::lanes::Lanes8, 6, 2>($($arg),*);
            }
            match simd {
                // SAFETY: `Simd::detect` names a path only where the machine has its features.
                #[cfg(target_arch = "x86_64")]
                $crate::backend::cpu::Simd::Avx512 => unsafe { avx512($($arg),*) },
                // SAFETY: as above.
                #[cfg(target_arch = "x86_64")]
                $crate::backend::cpu::Simd::Avx2 => unsafe { avx2($($arg),*) },
                _ => $body::<$crate::backend::cpu::lanes::Lanes4, 4, 2>($($arg),*),
            }
        }
    };
}

pub(crate) use dispatch;
