//! Where an object may stand: a bird's-eye grid of ground heights and clearance (paper, section 3.3 and eq. 7).

use glam::{DVec2, DVec3};
use serde::{Deserialize, Serialize};

use super::footprint::{Footprint, GroundPlane};

/// What a cell of the grid is known to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Cell {
    /// Never seen well enough, or not connected to the driven path: not free.
    Unseen,
    /// Seen ground with nothing above it.
    Free,
    /// Something stands in the pillar above the ground.
    Blocked,
    /// Ground that steps or slopes away from the road.
    Uneven,
}

/// Bird's-eye grid of a background, in its local frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "StoredRegion", into = "StoredRegion")]
pub struct ValidRegion {
    /// Corner of the grid with the smallest x and y, metres.
    pub origin: DVec2,
    pub cell_m: f64,
    pub columns: usize,
    pub rows: usize,
    /// Row-major: x runs along columns, y along rows.
    pub cells: Vec<Cell>,
    /// Ground height per cell in metres; [`NO_GROUND`] where unknown.
    pub ground_m: Vec<f64>,
}

/// Why a footprint cannot stand somewhere.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsupported {
    Unseen,
    Blocked,
    Uneven,
}

/// Height of a cell whose ground is not known: unlike NaN it equals itself, so regions compare.
pub const NO_GROUND: f64 = f64::NEG_INFINITY;

/// Wheels may hang at most this far off the fitted plane, metres.
const WHEEL_TOLERANCE_M: f64 = 0.1;

impl ValidRegion {
    /// A grid of unseen cells.
    pub fn unseen(origin: DVec2, cell_m: f64, columns: usize, rows: usize) -> Self {
        Self {
            origin,
            cell_m,
            columns,
            rows,
            cells: vec![Cell::Unseen; columns * rows],
            ground_m: vec![NO_GROUND; columns * rows],
        }
    }

    pub fn index_at(&self, p: DVec2) -> Option<usize> {
        let c = (p - self.origin) / self.cell_m;
        let inside =
            c.x >= 0.0 && c.y >= 0.0 && c.x < self.columns as f64 && c.y < self.rows as f64;
        inside.then(|| c.y as usize * self.columns + c.x as usize)
    }

    pub fn cell_at(&self, p: DVec2) -> Cell {
        self.index_at(p).map_or(Cell::Unseen, |i| self.cells[i])
    }

    pub fn centre(&self, index: usize) -> DVec2 {
        let (column, row) = (index % self.columns, index / self.columns);
        self.origin + DVec2::new(column as f64 + 0.5, row as f64 + 0.5) * self.cell_m
    }

    /// Ground height of the cell that holds `p`; `None` where the ground is unknown.
    pub fn ground_height(&self, p: DVec2) -> Option<f64> {
        self.index_at(p)
            .map(|i| self.ground_m[i])
            .filter(|z| z.is_finite())
    }

    /// Indices of the free cells, ascending.
    pub fn free_cells(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.cells.len()).filter(|i| self.cells[*i] == Cell::Free)
    }

    /// The cells that a footprint overlaps, row by row; `None` if it reaches outside the grid.
    pub fn cells_under(&self, footprint: &Footprint) -> Option<Vec<usize>> {
        let (low, high) = footprint.bounds();
        let (low, high) = (
            (low - self.origin) / self.cell_m,
            (high - self.origin) / self.cell_m,
        );
        let size = DVec2::new(self.columns as f64, self.rows as f64);
        if low.cmplt(DVec2::ZERO).any() || high.cmpgt(size).any() {
            return None;
        }
        let last = |high: f64, count: usize| (libm::ceil(high) as usize).min(count);
        let columns = low.x as usize..last(high.x, self.columns);
        let rows = low.y as usize..last(high.y, self.rows);
        let cells = rows.flat_map(|row| columns.clone().map(move |column| (row, column)));
        let indices = cells.map(|(row, column)| row * self.columns + column);
        Some(
            indices
                .filter(|i| footprint.overlaps_square(self.centre(*i), self.cell_m))
                .collect(),
        )
    }

    /// The plane under a footprint all of whose cells are free and lie near to that plane.
    ///
    /// # Errors
    /// The first thing found under the footprint that is not free ground.
    pub fn support(&self, footprint: &Footprint) -> Result<GroundPlane, Unsupported> {
        let cells = self.cells_under(footprint).ok_or(Unsupported::Unseen)?;
        let mut ground = Vec::with_capacity(cells.len());
        for index in cells {
            match self.cells[index] {
                Cell::Free => {}
                Cell::Unseen => return Err(Unsupported::Unseen),
                Cell::Blocked => return Err(Unsupported::Blocked),
                Cell::Uneven => return Err(Unsupported::Uneven),
            }
            ground.push(self.centre(index).extend(self.ground_m[index]));
        }
        let plane = GroundPlane::fit(&ground).ok_or(Unsupported::Unseen)?;
        let worst = ground
            .iter()
            .map(|p| (p.z - plane.height_at(p.truncate())).abs())
            .fold(0.0, f64::max);
        if worst > WHEEL_TOLERANCE_M {
            return Err(Unsupported::Uneven);
        }
        Ok(plane)
    }

    /// Whether a blocked cell stands on the line between two points, its end cells excepted.
    pub fn blocks_sight(&self, from: DVec3, to: DVec3) -> bool {
        let (a, b) = (from.truncate(), to.truncate());
        let length = (b - a).length();
        let steps = libm::ceil(length / (self.cell_m * 0.5)) as usize;
        (1..steps).any(|i| {
            let p = a.lerp(b, i as f64 / steps as f64);
            (p - b).length() > self.cell_m && self.cell_at(p) == Cell::Blocked
        })
    }
}

/// The stored form: one letter per cell and heights in millimetres, which headers hold in tens of kilobytes.
#[derive(Clone, Serialize, Deserialize)]
struct StoredRegion {
    origin: [f64; 2],
    cell_m: f64,
    columns: usize,
    rows: usize,
    cells: String,
    /// Height of `ground_mm` 0.
    base_m: f64,
    /// Millimetres above `base_m`; `i16::MIN` where unknown.
    ground_mm: Vec<i16>,
}

const UNKNOWN_MM: i16 = i16::MIN;

impl From<ValidRegion> for StoredRegion {
    fn from(region: ValidRegion) -> Self {
        let base_m = region
            .ground_m
            .iter()
            .copied()
            .find(|z| z.is_finite())
            .unwrap_or(0.0);
        let to_mm = |z: &f64| {
            let mm = libm::round((z - base_m) * 1000.0);
            // A road that climbs over 32 m within one background is clipped.
            if mm.is_finite() {
                mm.clamp(-32_767.0, 32_767.0) as i16
            } else {
                UNKNOWN_MM
            }
        };
        Self {
            origin: region.origin.to_array(),
            cell_m: region.cell_m,
            columns: region.columns,
            rows: region.rows,
            cells: region.cells.iter().map(|c| letter(*c)).collect(),
            base_m,
            ground_mm: region.ground_m.iter().map(to_mm).collect(),
        }
    }
}

impl TryFrom<StoredRegion> for ValidRegion {
    type Error = String;

    fn try_from(stored: StoredRegion) -> Result<Self, String> {
        let count = stored.columns * stored.rows;
        if stored.cells.len() != count || stored.ground_mm.len() != count {
            return Err(format!(
                "valid region of {}x{} cells has {} states and {} heights",
                stored.columns,
                stored.rows,
                stored.cells.len(),
                stored.ground_mm.len()
            ));
        }
        let cells = stored
            .cells
            .chars()
            .map(cell_of)
            .collect::<Result<Vec<_>, _>>()?;
        let height = |mm: &i16| match *mm {
            UNKNOWN_MM => NO_GROUND,
            mm => stored.base_m + f64::from(mm) / 1000.0,
        };
        Ok(Self {
            origin: DVec2::from_array(stored.origin),
            cell_m: stored.cell_m,
            columns: stored.columns,
            rows: stored.rows,
            cells,
            ground_m: stored.ground_mm.iter().map(height).collect(),
        })
    }
}

fn letter(cell: Cell) -> char {
    match cell {
        Cell::Unseen => '.',
        Cell::Free => 'f',
        Cell::Blocked => 'b',
        Cell::Uneven => 'u',
    }
}

fn cell_of(letter: char) -> Result<Cell, String> {
    match letter {
        '.' => Ok(Cell::Unseen),
        'f' => Ok(Cell::Free),
        'b' => Ok(Cell::Blocked),
        'u' => Ok(Cell::Uneven),
        other => Err(format!("valid region has an unknown cell state '{other}'")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope() -> ValidRegion {
        let mut region = ValidRegion::unseen(DVec2::new(-1.0, -5.0), 0.5, 40, 20);
        for i in 0..region.cells.len() {
            region.cells[i] = Cell::Free;
            region.ground_m[i] = 100.0 + 0.05 * region.centre(i).x;
        }
        region
    }

    #[test]
    fn whole_footprint_must_be_free() {
        let mut region = slope();
        let size = DVec3::new(4.0, 1.8, 1.5);
        let footprint = Footprint::new(DVec2::new(8.0, 0.0), 0.4, size);
        let plane = region.support(&footprint).unwrap();
        assert!((plane.slope - DVec2::new(0.05, 0.0)).length() < 1e-9);
        let corner = region.index_at(footprint.corners()[2]).unwrap();
        for (state, reason) in [
            (Cell::Unseen, Unsupported::Unseen),
            (Cell::Blocked, Unsupported::Blocked),
            (Cell::Uneven, Unsupported::Uneven),
        ] {
            region.cells[corner] = state;
            assert_eq!(region.support(&footprint), Err(reason));
        }
        region.cells[corner] = Cell::Free;
        region.ground_m[corner] += 0.3;
        assert_eq!(region.support(&footprint), Err(Unsupported::Uneven));
        let outside = Footprint::new(DVec2::new(18.5, 0.0), 0.0, size);
        assert_eq!(region.support(&outside), Err(Unsupported::Unseen));
    }

    #[test]
    fn stored_form_round_trips_and_rejects_damage() {
        let mut region = slope();
        region.cells[3] = Cell::Blocked;
        region.cells[4] = Cell::Uneven;
        region.cells[5] = Cell::Unseen;
        region.ground_m[5] = NO_GROUND;
        let json = serde_json::to_string(&region).unwrap();
        let back: ValidRegion = serde_json::from_str(&json).unwrap();
        assert_eq!(back.cells, region.cells);
        for (a, b) in back.ground_m.iter().zip(&region.ground_m) {
            assert!((a == b) || (a - b).abs() < 0.0006, "{a} {b}");
        }
        // Once stored, it does not drift any further.
        assert_eq!(serde_json::to_string(&back).unwrap(), json);
        assert!(
            serde_json::from_str::<ValidRegion>(&json.replace("\"rows\":20", "\"rows\":21"))
                .is_err()
        );
        assert!(serde_json::from_str::<ValidRegion>(&json.replacen("fbu", "fxu", 1)).is_err());
    }

    #[test]
    fn a_blocked_cell_blocks_sight_over_it_only() {
        let mut region = slope();
        let wall = region.index_at(DVec2::new(5.0, 0.1)).unwrap();
        region.cells[wall] = Cell::Blocked;
        let eye = DVec3::new(0.0, 0.2, 101.5);
        assert!(region.blocks_sight(eye, DVec3::new(10.0, 0.2, 101.0)));
        assert!(!region.blocks_sight(eye, DVec3::new(10.0, 4.0, 101.0)));
        assert!(!region.blocks_sight(eye, DVec3::new(3.0, 0.2, 101.0)));
    }
}
