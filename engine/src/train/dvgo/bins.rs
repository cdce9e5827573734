//! Points sorted by the brick that owns their gradients.

use rayon::prelude::*;

use super::chunk::Chunk;

/// (chunk, point) pairs by brick.
#[derive(Clone, Debug, Default)]
pub(super) struct Bins {
    parts: Vec<Part>,
    bricks_per_part: usize,
}

/// The pairs of a range of bricks.
#[derive(Clone, Debug, Default)]
struct Part {
    /// `ends[b]` is the end of the part's brick b; `ends[b - 1]` its start.
    ends: Vec<u32>,
    /// Chunk in the upper, point in the lower half.
    pairs: Vec<(u32, u32)>,
}

impl Bins {
    /// Counting sort. Every part looks at all points and keeps its own, so parts share nothing; pairs of a brick keep the chunks'
    /// order, so sums are the same whatever the number of parts.
    pub(super) fn sort<const C: usize>(&mut self, bricks: usize, chunks: &[Chunk<C>]) {
        let parts = rayon::current_num_threads();
        self.bricks_per_part = bricks.div_ceil(parts).max(1);
        self.parts.resize_with(parts, Part::default);
        let per_part = self.bricks_per_part;
        self.parts
            .par_iter_mut()
            .enumerate()
            .for_each(|(number, part)| {
                part.sort(number * per_part..(number + 1) * per_part, chunks);
            });
    }

    /// The pairs of a brick, chunk and point.
    pub(super) fn of(&self, brick: usize) -> &[(u32, u32)] {
        let part = &self.parts[brick / self.bricks_per_part];
        let local = brick % self.bricks_per_part;
        let start = if local == 0 { 0 } else { part.ends[local - 1] };
        &part.pairs[start as usize..part.ends[local] as usize]
    }
}

impl Part {
    fn sort<const C: usize>(&mut self, bricks: std::ops::Range<usize>, chunks: &[Chunk<C>]) {
        let (first, count) = (bricks.start as u32, bricks.len() as u32);
        self.ends.clear();
        self.ends.resize(bricks.len() + 1, 0);
        for (brick, _) in chunks.iter().flat_map(|chunk| &chunk.touched) {
            let local = brick.wrapping_sub(first);
            if local < count {
                self.ends[local as usize + 1] += 1;
            }
        }
        let mut total = 0;
        for end in &mut self.ends {
            total += *end;
            *end = total;
        }
        self.pairs.resize(total as usize, (0, 0));
        // ends[b] now is the start of brick b and moves to its end while its pairs are placed.
        for (number, chunk) in chunks.iter().enumerate() {
            for (brick, point) in &chunk.touched {
                let local = brick.wrapping_sub(first);
                if local < count {
                    let at = &mut self.ends[local as usize];
                    self.pairs[*at as usize] = (number as u32, *point);
                    *at += 1;
                }
            }
        }
    }
}
