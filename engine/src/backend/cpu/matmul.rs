//! Small dense matrix products in registers.
//!
//! Matrices are row-major. Tiles of ROWS x VECTORS registers stay in registers over the whole inner dimension.

use super::lanes::{Lanes, Lanes4};

/// What is done to a finished sum before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finish {
    Keep,
    Relu,
}

/// Widest inner dimension: a tile's rows of `a` are packed on the stack.
const MAX_INNER: usize = 128;

/// `c[r][j] += sum_k a[r][k] b[k][j]` for `rows` rows, `n` columns (a multiple of 4) and `k` terms.
///
/// `a` has rows of `lda` values of which `k` count; `b` rows of `n`; `c` rows of `n`.
#[inline(always)]
pub(super) fn add_product<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    (rows, n, k): (usize, usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
    finish: Finish,
) {
    // A chunk none of whose samples matters has no rows.
    if rows == 0 {
        return;
    }
    assert!(b.len() >= k * n && c.len() >= rows * n && a.len() >= (rows - 1) * lda + k);
    assert!(
        n.is_multiple_of(4) && k <= MAX_INNER,
        "columns come in vectors of four"
    );
    let mut row = 0;
    while row < rows {
        let (a, c) = (&a[row * lda..], &mut c[row * n..]);
        if row + ROWS <= rows {
            let packed: [[f32; ROWS]; MAX_INNER] = pack(a, lda, k);
            row_block::<L, ROWS, VECTORS>(n, &packed[..k], b, c, finish);
            row += ROWS;
        } else {
            let packed: [[f32; 1]; MAX_INNER] = pack(a, lda, k);
            row_block::<L, 1, VECTORS>(n, &packed[..k], b, c, finish);
            row += 1;
        }
    }
}

/// The first `k` values of ROWS rows, value by value.
#[inline(always)]
fn pack<const ROWS: usize>(a: &[f32], lda: usize, k: usize) -> [[f32; ROWS]; MAX_INNER] {
    let mut packed = [[0.0; ROWS]; MAX_INNER];
    for r in 0..ROWS {
        let row = &a[r * lda..][..k];
        for (packed, value) in packed.iter_mut().zip(row) {
            packed[r] = *value;
        }
    }
    packed
}

#[inline(always)]
fn row_block<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    n: usize,
    a: &[[f32; ROWS]],
    b: &[f32],
    c: &mut [f32],
    finish: Finish,
) {
    let mut column = 0;
    while column + L::WIDTH * VECTORS <= n {
        tile::<L, ROWS, VECTORS>((n, column), a, b, c, finish);
        column += L::WIDTH * VECTORS;
    }
    while column + L::WIDTH <= n {
        tile::<L, ROWS, 1>((n, column), a, b, c, finish);
        column += L::WIDTH;
    }
    while column < n {
        tile::<Lanes4, ROWS, 1>((n, column), a, b, c, finish);
        column += 4;
    }
}

#[inline(always)]
fn tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    (n, column): (usize, usize),
    a: &[[f32; ROWS]],
    b: &[f32],
    c: &mut [f32],
    finish: Finish,
) {
    let at = |r: usize, v: usize| r * n + column + v * L::WIDTH;
    let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
    for (r, sums) in sums.iter_mut().enumerate() {
        load::<L, VECTORS>(&c[at(r, 0)..], sums);
    }
    for (a, b) in a.iter().zip(b.chunks_exact(n)) {
        let b = &b[column..column + L::WIDTH * VECTORS];
        let mut lanes = [L::splat(0.0); VECTORS];
        load::<L, VECTORS>(b, &mut lanes);
        for r in 0..ROWS {
            let a = L::splat(a[r]);
            for v in 0..VECTORS {
                sums[r][v] = a.multiply_add(lanes[v], sums[r][v]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            let out = match finish {
                Finish::Keep => *sum,
                Finish::Relu => sum.max(L::splat(0.0)),
            };
            out.store(&mut c[at(r, v)..]);
        }
    }
}

/// A loop and not `array::from_fn`, whose insides are compiled without the path's instructions.
#[inline(always)]
fn load<L: Lanes, const VECTORS: usize>(from: &[f32], to: &mut [L; VECTORS]) {
    let from = &from[..L::WIDTH * VECTORS];
    for (v, to) in to.iter_mut().enumerate() {
        *to = L::load(&from[v * L::WIDTH..]);
    }
}

/// `c[i][j] += sum_r a[r][i] b[r][j]`: the transpose of `a` times `b`, for weight gradients.
///
/// `a` has `rows` rows of `lda` values of which `m` count; `b` rows of `n` (a multiple of 4); `c` is `m` x `n`.
#[inline(always)]
pub(super) fn add_transposed_product<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    (rows, m, n): (usize, usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
) {
    if rows == 0 {
        return;
    }
    assert!(b.len() >= rows * n && c.len() >= m * n && a.len() >= (rows - 1) * lda + m);
    assert!(n.is_multiple_of(4), "columns come in vectors of four");
    let b = &b[..rows * n];
    let mut i = 0;
    while i < m {
        let (a, c) = (&a[i..], &mut c[i * n..]);
        if i + ROWS <= m {
            transposed_block::<L, ROWS, VECTORS>(n, a, lda, b, c);
            i += ROWS;
        } else {
            transposed_block::<L, 1, VECTORS>(n, a, lda, b, c);
            i += 1;
        }
    }
}

#[inline(always)]
fn transposed_block<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    n: usize,
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
) {
    let mut column = 0;
    while column + L::WIDTH * VECTORS <= n {
        transposed_tile::<L, ROWS, VECTORS>((n, column), a, lda, b, c);
        column += L::WIDTH * VECTORS;
    }
    while column + L::WIDTH <= n {
        transposed_tile::<L, ROWS, 1>((n, column), a, lda, b, c);
        column += L::WIDTH;
    }
    while column < n {
        transposed_tile::<Lanes4, ROWS, 1>((n, column), a, lda, b, c);
        column += 4;
    }
}

#[inline(always)]
fn transposed_tile<L: Lanes, const ROWS: usize, const VECTORS: usize>(
    (n, column): (usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
) {
    let at = |r: usize, v: usize| r * n + column + v * L::WIDTH;
    let mut sums = [[L::splat(0.0); VECTORS]; ROWS];
    for (r, sums) in sums.iter_mut().enumerate() {
        load::<L, VECTORS>(&c[at(r, 0)..], sums);
    }
    for (a, b) in a.chunks(lda).zip(b.chunks_exact(n)) {
        let (a, b) = (&a[..ROWS], &b[column..column + L::WIDTH * VECTORS]);
        let mut lanes = [L::splat(0.0); VECTORS];
        load::<L, VECTORS>(b, &mut lanes);
        for r in 0..ROWS {
            let a = L::splat(a[r]);
            for v in 0..VECTORS {
                sums[r][v] = a.multiply_add(lanes[v], sums[r][v]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        for (v, sum) in sums.iter().enumerate() {
            sum.store(&mut c[at(r, v)..]);
        }
    }
}
