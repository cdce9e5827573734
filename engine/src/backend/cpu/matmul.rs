//! Small dense matrix products in registers.
//!
//! Matrices are row-major. Tiles of ROWS x COLUMNS accumulators stay in registers over the whole inner dimension; plain
//! const-generic loops, which the compiler turns into vector code of whatever path calls them.

/// What is done to a finished sum before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Finish {
    Keep,
    Relu,
}

#[inline(always)]
fn multiply_add<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// `c[r][j] += sum_k a[r][k] b[k][j]` for `rows` rows, `n` columns (a multiple of 4) and `k` terms.
///
/// `a` has rows of `lda` values of which `k` count; `b` rows of `n`; `c` rows of `n`.
#[inline(always)]
pub(super) fn add_product<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
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
    assert!(n.is_multiple_of(4), "columns come in vectors of four");
    let mut row = 0;
    while row < rows {
        let a = &a[row * lda..];
        let c = &mut c[row * n..];
        if row + ROWS <= rows {
            row_block::<ROWS, COLUMNS, FMA>((n, k), a, lda, b, c, finish);
            row += ROWS;
        } else {
            row_block::<1, COLUMNS, FMA>((n, k), a, lda, b, c, finish);
            row += 1;
        }
    }
}

#[inline(always)]
fn row_block<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
    (n, k): (usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
    finish: Finish,
) {
    let mut column = 0;
    while column + COLUMNS <= n {
        tile::<ROWS, COLUMNS, FMA>((n, k, column), a, lda, b, c, finish);
        column += COLUMNS;
    }
    while column + 16 <= n {
        tile::<ROWS, 16, FMA>((n, k, column), a, lda, b, c, finish);
        column += 16;
    }
    while column < n {
        tile::<ROWS, 4, FMA>((n, k, column), a, lda, b, c, finish);
        column += 4;
    }
}

#[inline(always)]
fn tile<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
    (n, k, column): (usize, usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
    finish: Finish,
) {
    let rows: [&[f32]; ROWS] = std::array::from_fn(|r| &a[r * lda..r * lda + k]);
    let mut sums = [[0.0f32; COLUMNS]; ROWS];
    for (r, sums) in sums.iter_mut().enumerate() {
        sums.copy_from_slice(&c[r * n + column..][..COLUMNS]);
    }
    for i in 0..k {
        let b: &[f32] = &b[i * n + column..][..COLUMNS];
        for r in 0..ROWS {
            let a = rows[r][i];
            for j in 0..COLUMNS {
                sums[r][j] = multiply_add::<FMA>(a, b[j], sums[r][j]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let out = &mut c[r * n + column..][..COLUMNS];
        match finish {
            Finish::Keep => out.copy_from_slice(sums),
            Finish::Relu => out.iter_mut().zip(sums).for_each(|(o, s)| *o = s.max(0.0)),
        }
    }
}

/// `c[i][j] += sum_r a[r][i] b[r][j]`: the transpose of `a` times `b`, for weight gradients.
///
/// `a` has `rows` rows of `lda` values of which `m` count; `b` rows of `n` (a multiple of 4); `c` is `m` x `n`.
#[inline(always)]
pub(super) fn add_transposed_product<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
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
    let mut i = 0;
    while i < m {
        let c = &mut c[i * n..];
        if i + ROWS <= m {
            transposed_block::<ROWS, COLUMNS, FMA>((rows, n, i), a, lda, b, c);
            i += ROWS;
        } else {
            transposed_block::<1, COLUMNS, FMA>((rows, n, i), a, lda, b, c);
            i += 1;
        }
    }
}

#[inline(always)]
fn transposed_block<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
    (rows, n, i): (usize, usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
) {
    let mut column = 0;
    while column + COLUMNS <= n {
        transposed_tile::<ROWS, COLUMNS, FMA>((rows, n, i, column), a, lda, b, c);
        column += COLUMNS;
    }
    while column + 16 <= n {
        transposed_tile::<ROWS, 16, FMA>((rows, n, i, column), a, lda, b, c);
        column += 16;
    }
    while column < n {
        transposed_tile::<ROWS, 4, FMA>((rows, n, i, column), a, lda, b, c);
        column += 4;
    }
}

#[inline(always)]
fn transposed_tile<const ROWS: usize, const COLUMNS: usize, const FMA: bool>(
    (rows, n, i, column): (usize, usize, usize, usize),
    a: &[f32],
    lda: usize,
    b: &[f32],
    c: &mut [f32],
) {
    let mut sums = [[0.0f32; COLUMNS]; ROWS];
    for row in 0..rows {
        let a = &a[row * lda + i..][..ROWS];
        let b = &b[row * n + column..][..COLUMNS];
        for r in 0..ROWS {
            for j in 0..COLUMNS {
                sums[r][j] = multiply_add::<FMA>(a[r], b[j], sums[r][j]);
            }
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        let out = &mut c[r * n + column..][..COLUMNS];
        out.iter_mut().zip(sums).for_each(|(o, s)| *o += s);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_batch_without_rows_is_nothing_to_do() {
        add_product::<6, 64, false>((0, 4, 3), &[], 3, &[0.0; 12], &mut [], Finish::Keep);
        let mut gradient = [1.0; 12];
        add_transposed_product::<6, 64, false>((0, 3, 4), &[], 3, &[], &mut gradient);
        assert_eq!(gradient, [1.0; 12]);
    }
}
