//! Matrix products in registers on pairs of bfloat16.

use std::arch::x86_64::{
    __m512, __m512bh, __m512i, _mm512_cvtne2ps_pbh, _mm512_dpbf16_ps, _mm512_loadu_ps,
    _mm512_loadu_si512, _mm512_maskz_mov_epi16, _mm512_max_ps, _mm512_set1_epi32,
    _mm512_setzero_ps, _mm512_storeu_ps, _mm512_storeu_si512, _mm512_test_epi16_mask,
};
use std::mem::transmute;

use super::PANEL;

/// f32 or pairs in a register.
pub(super) const LANES: usize = 16;
/// Rows of a tile of products; batches are padded to a multiple. With 4 registers of columns, 24 sums stay in registers.
pub(super) const ROWS: usize = 6;

/// What a finished tile becomes.
pub(super) enum Finish<'a> {
    /// Rectified, to pairs.
    Relu(&'a mut [u32]),
    /// Zero where the activation of the same shape is, to pairs.
    Where(&'a [u32], &'a mut [u32]),
    /// f32.
    Keep(&'a mut [f32]),
}

#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn load(from: &[f32]) -> __m512 {
    let from = &from[..LANES];
    // SAFETY: the slice holds all lanes.
    unsafe { _mm512_loadu_ps(from.as_ptr()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn store(x: __m512, to: &mut [f32]) {
    let to = &mut to[..LANES];
    // SAFETY: the slice holds all lanes.
    unsafe { _mm512_storeu_ps(to.as_mut_ptr(), x) }
}

#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn load_pairs(from: &[u32]) -> __m512i {
    let from = &from[..LANES];
    // SAFETY: the slice holds all lanes.
    unsafe { _mm512_loadu_si512(from.as_ptr().cast()) }
}

#[inline]
#[target_feature(enable = "avx512f")]
pub(super) fn store_pairs(x: __m512i, to: &mut [u32]) {
    let to = &mut to[..LANES];
    // SAFETY: the slice holds all lanes.
    unsafe { _mm512_storeu_si512(to.as_mut_ptr().cast(), x) }
}

/// `sum + low(a) low(b) + high(a) high(b)` in each lane.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
pub(super) fn dot(sum: __m512, a: __m512i, b: __m512i) -> __m512 {
    // SAFETY: both types are 512 bits without invalid values.
    let (a, b) = unsafe {
        (
            transmute::<__m512i, __m512bh>(a),
            transmute::<__m512i, __m512bh>(b),
        )
    };
    _mm512_dpbf16_ps(sum, a, b)
}

/// 32 consecutive f32 to 16 pairs.
#[inline]
#[target_feature(enable = "avx512f,avx512bf16")]
pub(super) fn to_pairs(first: __m512, second: __m512) -> __m512i {
    // SAFETY: both types are 512 bits without invalid values.
    unsafe { transmute::<__m512bh, __m512i>(_mm512_cvtne2ps_pbh(second, first)) }
}

/// Zero in the halves where `activation` is.
#[inline]
#[target_feature(enable = "avx512f,avx512bw")]
pub(super) fn where_active(x: __m512i, activation: __m512i) -> __m512i {
    _mm512_maskz_mov_epi16(_mm512_test_epi16_mask(activation, activation), x)
}

/// `out = finish(start + a b)` for `rows` rows (a multiple of [`ROWS`]) and `n` columns.
///
/// `a` has rows of `pairs` pairs; `b` is packed in panels of columns, each of which stays in first-level cache for all rows. All
/// rows start at `start` (n values), or at 0.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub(super) fn product(
    (rows, n, pairs): (usize, usize, usize),
    a: &[u32],
    b: &[u32],
    start: Option<&[f32]>,
    finish: &mut Finish<'_>,
) {
    assert!(rows.is_multiple_of(ROWS) && a.len() >= rows * pairs && b.len() == n * pairs);
    let panel = n.min(PANEL);
    for (number, b) in b.chunks_exact(pairs * panel).enumerate() {
        for row in (0..rows).step_by(ROWS) {
            let a = &a[row * pairs..(row + ROWS) * pairs];
            let at = (n, row, number * panel);
            match panel / LANES {
                1 => tile::<1>(at, a, b, start, finish),
                2 => tile::<2>(at, a, b, start, finish),
                _ => tile::<4>(at, a, b, start, finish),
            }
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn tile<const V: usize>(
    (n, row, column): (usize, usize, usize),
    a: &[u32],
    b: &[u32],
    start: Option<&[f32]>,
    finish: &mut Finish<'_>,
) {
    let pairs = a.len() / ROWS;
    let mut first = [_mm512_setzero_ps(); V];
    if let Some(start) = start {
        for (v, first) in first.iter_mut().enumerate() {
            *first = load(&start[column + v * LANES..]);
        }
    }
    let mut sums = [first; ROWS];
    let mut rows = [a; ROWS];
    for (r, row) in rows.iter_mut().enumerate() {
        *row = &a[r * pairs..(r + 1) * pairs];
    }
    for (k, b) in b.chunks_exact(V * LANES).enumerate().take(pairs) {
        let mut right = [_mm512_set1_epi32(0); V];
        for (v, right) in right.iter_mut().enumerate() {
            *right = load_pairs(&b[v * LANES..]);
        }
        for r in 0..ROWS {
            let left = _mm512_set1_epi32(rows[r][k] as i32);
            for v in 0..V {
                sums[r][v] = dot(sums[r][v], left, right[v]);
            }
        }
    }
    // Finished from memory: were the sums indexed by what follows, each would be stored in every round of the loop above.
    let mut block = [[0.0; 4 * LANES]; ROWS];
    for r in 0..ROWS {
        for v in 0..V {
            store(sums[r][v], &mut block[r][v * LANES..]);
        }
    }
    for (r, block) in block.iter().enumerate() {
        let mut sums = [_mm512_setzero_ps(); V];
        for (v, sum) in sums.iter_mut().enumerate() {
            *sum = load(&block[v * LANES..]);
        }
        put::<V>((row + r) * n + column, &sums, finish);
    }
}

/// Hands V registers of a row, at position `at` of a row-major matrix, to `finish`.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub(super) fn put<const V: usize>(at: usize, sums: &[__m512; V], finish: &mut Finish<'_>) {
    match finish {
        Finish::Keep(out) => {
            for (v, sum) in sums.iter().enumerate() {
                store(*sum, &mut out[at + v * LANES..]);
            }
        }
        Finish::Relu(out) => {
            let zero = _mm512_setzero_ps();
            for v in (0..V).step_by(2) {
                let (a, b) = (
                    _mm512_max_ps(sums[v], zero),
                    _mm512_max_ps(sums[v + 1], zero),
                );
                store_pairs(to_pairs(a, b), &mut out[at / 2 + v / 2 * LANES..]);
            }
        }
        Finish::Where(activation, out) => {
            for v in (0..V).step_by(2) {
                let at = at / 2 + v / 2 * LANES;
                let pairs = to_pairs(sums[v], sums[v + 1]);
                let pairs = where_active(pairs, load_pairs(&activation[at..]));
                store_pairs(pairs, &mut out[at..]);
            }
        }
    }
}

/// `c[i][j] += sum over pairs of samples of a[pair][i] . b[pair][j]`: a weight gradient, `m` x `n`, m a multiple of 4.
#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
pub(super) fn add_gradient(
    (m, n): (usize, usize),
    (a, lda): (&[u32], usize),
    b: &[u32],
    c: &mut [f32],
) {
    for i in (0..m).step_by(4) {
        let mut column = 0;
        while column < n {
            let wide = n - column >= 4 * LANES;
            let at = (n, i, column);
            if wide {
                gradient_tile::<4>(at, (a, lda), b, c);
            } else {
                gradient_tile::<2>(at, (a, lda), b, c);
            }
            column += if wide { 4 * LANES } else { 2 * LANES };
        }
    }
}

#[inline]
#[target_feature(enable = "avx512f,avx512bw,avx512bf16")]
fn gradient_tile<const V: usize>(
    (n, i, column): (usize, usize, usize),
    (a, lda): (&[u32], usize),
    b: &[u32],
    c: &mut [f32],
) {
    let mut sums = [[_mm512_setzero_ps(); V]; 4];
    for (a, b) in a.chunks_exact(lda).zip(b.chunks_exact(n)) {
        let (a, b) = (&a[i..i + 4], &b[column..column + V * LANES]);
        let mut right = [_mm512_set1_epi32(0); V];
        for (v, right) in right.iter_mut().enumerate() {
            *right = load_pairs(&b[v * LANES..]);
        }
        for r in 0..4 {
            let left = _mm512_set1_epi32(a[r] as i32);
            for v in 0..V {
                sums[r][v] = dot(sums[r][v], left, right[v]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            let c = &mut c[(i + r) * n + column + v * LANES..][..LANES];
            store(std::arch::x86_64::_mm512_add_ps(load(c), *sum), c);
        }
    }
}
