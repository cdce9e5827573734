//! Which cells of space can hold density, and how finely to step there.

use std::fmt;

use glam::{IVec3, UVec3, Vec3};

/// Cells along each edge of a block.
pub const BLOCK_SIDE: u32 = 8;
const MAX_INDEX_BLOCKS: f32 = 16_777_216.0;

/// What a ray meets at a position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Space {
    /// Nothing up to the far side of a cube with this lower corner and edge length, in metres.
    Empty { corner_m: Vec3, side_m: f32 },
    /// Density may be here; step by this many metres at most.
    Occupied { step_m: f32 },
}

/// A two-level occupancy mask: blocks of 8^3 cells behind a dense index; block 0 stands for empty ones.
#[derive(Clone, PartialEq)]
pub struct Occupancy {
    cell_m: f32,
    origin_m: Vec3,
    blocks: UVec3,
    index: Vec<u32>,
    /// One bit per cell: word z, bit `y * 8 + x`.
    masks: Vec<[u64; BLOCK_SIDE as usize]>,
    steps_m: Vec<f32>,
}

impl Occupancy {
    /// All empty, covering `size_m` from `origin_m` on. `None` if the index would be unreasonably large.
    pub fn new(cell_m: f32, origin_m: Vec3, size_m: Vec3) -> Option<Self> {
        let span = (size_m / (cell_m * BLOCK_SIDE as f32))
            .ceil()
            .max(Vec3::ONE);
        let countable =
            size_m.is_finite() && span.is_finite() && span.max_element() <= MAX_INDEX_BLOCKS;
        countable
            .then(|| Self::with_blocks(cell_m, origin_m, span.as_uvec3()))
            .flatten()
    }

    /// All empty, of `blocks` blocks per axis. `None` if the index would be unreasonably large.
    pub fn with_blocks(cell_m: f32, origin_m: Vec3, blocks: UVec3) -> Option<Self> {
        let count = blocks.as_dvec3().element_product();
        let sound = cell_m > 0.0
            && cell_m.is_finite()
            && origin_m.is_finite()
            && blocks.min_element() > 0
            && count <= f64::from(MAX_INDEX_BLOCKS);
        sound.then(|| Self {
            cell_m,
            origin_m,
            blocks,
            index: vec![0; count as usize],
            masks: vec![[0; BLOCK_SIDE as usize]],
            steps_m: vec![0.0],
        })
    }

    pub fn cell_m(&self) -> f32 {
        self.cell_m
    }

    pub fn origin_m(&self) -> Vec3 {
        self.origin_m
    }

    pub fn blocks_per_axis(&self) -> UVec3 {
        self.blocks
    }

    /// Dense block index, x fastest; 0 is an empty block.
    pub fn index(&self) -> &[u32] {
        &self.index
    }

    /// Word z, bit `y * 8 + x` of every stored block; entry 0 is the empty block.
    pub fn masks(&self) -> &[[u64; BLOCK_SIDE as usize]] {
        &self.masks
    }

    /// Step of every stored block in metres.
    pub fn steps_m(&self) -> &[f32] {
        &self.steps_m
    }

    /// Marks cells of one block; `block` outside the mask or an empty `mask` is ignored.
    pub fn set_block(&mut self, block: UVec3, mask: [u64; BLOCK_SIDE as usize], step_m: f32) {
        if !block.cmplt(self.blocks).all() || mask == [0; BLOCK_SIDE as usize] {
            return;
        }
        let at = ((block.z * self.blocks.y + block.y) * self.blocks.x + block.x) as usize;
        if self.index[at] == 0 {
            self.index[at] = self.masks.len() as u32;
            self.masks.push(mask);
            self.steps_m.push(step_m);
        } else {
            let stored = self.index[at] as usize;
            self.masks[stored] = mask;
            self.steps_m[stored] = step_m;
        }
    }

    /// Marks every cell.
    pub(crate) fn fill(&mut self, step_m: f32) {
        let blocks = self.blocks;
        for z in 0..blocks.z {
            for y in 0..blocks.y {
                for x in 0..blocks.x {
                    let all = [u64::MAX; BLOCK_SIDE as usize];
                    self.set_block(UVec3::new(x, y, z), all, step_m);
                }
            }
        }
    }

    /// Number of occupied cells.
    pub fn occupied_cells(&self) -> u64 {
        let words = self.masks.iter().flatten();
        words.map(|word| u64::from(word.count_ones())).sum()
    }

    #[inline]
    pub fn at(&self, p: Vec3) -> Space {
        self.walker().at(p)
    }

    /// For asking about positions that mostly lie in the same cell as the one before.
    #[inline]
    pub(crate) fn walker(&self) -> Walker<'_> {
        Walker {
            mask: self,
            cells_per_m: 1.0 / self.cell_m,
            last: (self.blocks * BLOCK_SIDE).as_ivec3() - 1,
            cell: IVec3::MIN,
            space: Space::Occupied { step_m: 0.0 },
        }
    }

    #[inline]
    fn space_of(&self, cell: UVec3) -> Space {
        let block = cell >> 3u32;
        let at = ((block.z * self.blocks.y + block.y) * self.blocks.x + block.x) as usize;
        let stored = self.index[at] as usize;
        if stored == 0 {
            let side_m = self.cell_m * BLOCK_SIDE as f32;
            let corner_m = self.origin_m + block.as_vec3() * side_m;
            return Space::Empty { corner_m, side_m };
        }
        let mask = &self.masks[stored];
        let local = cell & 7u32;
        if mask[local.z as usize] >> (local.y * 8 + local.x) & 1 == 0 {
            let side = empty_cube(mask, local);
            let corner = cell & !(side - 1);
            return Space::Empty {
                corner_m: self.origin_m + corner.as_vec3() * self.cell_m,
                side_m: self.cell_m * side as f32,
            };
        }
        Space::Occupied {
            step_m: self.steps_m[stored],
        }
    }
}

/// Edge in cells of the largest aligned cube around an empty cell of a block that is empty too: 4, 2 or 1.
#[inline]
fn empty_cube(mask: &[u64; BLOCK_SIDE as usize], local: UVec3) -> u32 {
    let empty = |side: u32, square: u64| {
        let first = local & !(side - 1);
        let square = square << (first.y * 8 + first.x);
        (first.z..first.z + side).all(|z| mask[z as usize] & square == 0)
    };
    if empty(4, 0x0f0f_0f0f) {
        4
    } else if empty(2, 0x0303) {
        2
    } else {
        1
    }
}

/// Looks positions up in a mask and remembers the last cell.
#[derive(Debug)]
pub(crate) struct Walker<'a> {
    mask: &'a Occupancy,
    cells_per_m: f32,
    last: IVec3,
    cell: IVec3,
    space: Space,
}

impl Walker<'_> {
    #[inline(always)]
    pub(crate) fn at(&mut self, p: Vec3) -> Space {
        let q = (p - self.mask.origin_m) * self.cells_per_m;
        // A ray inside the box can leave it by rounding; the nearest cell then answers.
        let cell = q.as_ivec3().clamp(IVec3::ZERO, self.last);
        if cell != self.cell {
            self.cell = cell;
            self.space = self.mask.space_of(cell.as_uvec3());
        }
        self.space
    }

    /// Lower corner and edge in metres of the cell of the last position.
    #[inline(always)]
    pub(crate) fn cell(&self) -> (Vec3, f32) {
        let side_m = self.mask.cell_m;
        (self.mask.origin_m + self.cell.as_vec3() * side_m, side_m)
    }
}

/// Sizes only.
impl fmt::Debug for Occupancy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Occupancy")
            .field("cell_m", &self.cell_m)
            .field("blocks", &self.blocks)
            .field("occupied_cells", &self.occupied_cells())
            .finish_non_exhaustive()
    }
}
