//! Ground in perspective looks alike along the rows of an image, which lie at one distance each, not along its columns.

use super::fill::{Part, Texel};

/// Known pixels at a gap's end whose mean speaks for it.
const END_PX: usize = 8;
/// Known pixels farther off than this belong to something else.
const REACH_PX: usize = 160;

/// One end of a gap: mean column and texel of the known pixels there.
#[derive(Clone, Copy)]
struct End {
    column: f32,
    texel: Texel,
}

/// Gives smooth ground the straight line between what is known to its left and right, or the one of both that there is; pixels
/// without either keep their texel.
pub(super) fn continue_rows(width: usize, texels: &mut [Texel], parts: &[Part]) {
    for (row, parts) in parts.chunks_exact(width).enumerate() {
        let texels = &mut texels[row * width..][..width];
        let mut column = 0;
        while column < width {
            if parts[column] != Part::Smooth {
                column += 1;
                continue;
            }
            let first = column;
            while column < width && parts[column] == Part::Smooth {
                column += 1;
            }
            let left = end(texels, parts, (0..first).rev());
            let right = end(texels, parts, column..width);
            for (at, texel) in (first..column).zip(&mut texels[first..column]) {
                *texel = between(left, right, at as f32).unwrap_or(*texel);
            }
        }
    }
}

/// The known pixels that come first among `columns`, up to the next one that is not known.
fn end(texels: &[Texel], parts: &[Part], columns: impl Iterator<Item = usize>) -> Option<End> {
    let known = columns
        .take(REACH_PX)
        .skip_while(|c| parts[*c] != Part::Known)
        .take_while(|c| parts[*c] == Part::Known)
        .take(END_PX);
    let (mut count, mut column, mut texel) = (0.0, 0.0, [0.0; 4]);
    for at in known {
        count += 1.0;
        column += at as f32;
        texel.iter_mut().zip(texels[at]).for_each(|(t, v)| *t += v);
    }
    (count > 0.0).then(|| End {
        column: column / count,
        texel: texel.map(|t: f32| t / count),
    })
}

fn between(left: Option<End>, right: Option<End>, column: f32) -> Option<Texel> {
    let (Some(a), Some(b)) = (left, right) else {
        return left.or(right).map(|end| end.texel);
    };
    let share = (column - a.column) / (b.column - a.column);
    Some(std::array::from_fn(|c| {
        a.texel[c] + share * (b.texel[c] - a.texel[c])
    }))
}
