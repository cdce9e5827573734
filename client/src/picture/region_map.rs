//! A background's valid region seen from above.

use backlot_engine::asset::AssetHeader;
use backlot_engine::camera::Rigid;
use backlot_engine::scene::{Cell, DensityField, ValidRegion};
use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use super::{GLYPH_HEIGHT, draw_line, draw_text};
use crate::error::{Error, Result};

/// A box drawn on the map: a placement, or an object of the log.
#[derive(Clone, Copy, Debug)]
pub struct MapBox {
    pub world_from_cuboid: Rigid,
    pub size_m: DVec3,
    pub inserted: bool,
}

const SCALE_PX_PER_M: f64 = 12.0;
const TEXT_SCALE: u32 = 2;
const MARGIN_PX: u32 = 8;
const LEGEND_ROWS: u32 = 4;
const ROW_PX: u32 = GLYPH_HEIGHT * TEXT_SCALE + 6;
/// Heights above the ground between which density is looked at, and the steps.
const ABOVE_M: (f64, f64) = (0.3, 1.9);
const LEVELS: u32 = 8;
const PAPER: Rgb<u8> = Rgb([16, 16, 20]);
const INK: Rgb<u8> = Rgb([225, 225, 225]);
const FREE: Rgb<u8> = Rgb([40, 150, 70]);
const BLOCKED: Rgb<u8> = Rgb([190, 50, 40]);
const UNEVEN: Rgb<u8> = Rgb([190, 150, 40]);
const UNSEEN: Rgb<u8> = Rgb([45, 48, 60]);
const PATH: Rgb<u8> = Rgb([90, 190, 255]);
const PLACED: Rgb<u8> = Rgb([255, 255, 255]);
const ORIGINAL: Rgb<u8> = Rgb([255, 170, 210]);

/// Draws the region over the density from 0.3 to 1.9 m above the ground (brighter is denser), with the ego path, the log's objects and
/// sampled placements. x of the log's local frame runs to the right, y upwards.
///
/// # Errors
/// [`Error::Invalid`] if the asset has no valid region, or an empty one.
pub fn region_map(
    name: &str,
    header: &AssetHeader,
    field: &dyn DensityField,
    boxes: &[MapBox],
) -> Result<RgbImage> {
    let invalid = |what: String| Error::Invalid { what };
    let (Some(region), Some(recording)) = (&header.valid_region, &header.recording) else {
        return Err(invalid(format!(
            "{name} has no valid region: it is not a background, or was trained by a version without"
        )));
    };
    if region.cells.is_empty() {
        return Err(invalid(format!(
            "{name} has an empty valid region: no road was found under the ego path"
        )));
    }
    let canvas = Canvas::new(region);
    let mut image = canvas.blank();
    canvas.draw_cells(&mut image, region, field);
    let local_from_world = header.local_from_world;
    for item in boxes {
        let pose = local_from_world * item.world_from_cuboid;
        let color = if item.inserted { PLACED } else { ORIGINAL };
        canvas.draw_box(&mut image, &pose, item.size_m, color);
    }
    let egos = recording
        .frames
        .iter()
        .map(|f| f.local_from_ego.translation_m);
    let egos: Vec<DVec2> = egos.map(|p| canvas.pixel(p.truncate())).collect();
    for step in egos.windows(2) {
        draw_line(&mut image, step[0], step[1], 2, PATH);
    }
    let placed = boxes.iter().filter(|b| b.inserted).count();
    canvas.draw_legend(&mut image, name, region, placed);
    Ok(image)
}

/// The map's scale and place in the image.
struct Canvas {
    origin: DVec2,
    size_m: DVec2,
}

impl Canvas {
    fn new(region: &ValidRegion) -> Self {
        let cells = DVec2::new(region.columns as f64, region.rows as f64);
        Self {
            origin: region.origin,
            size_m: cells * region.cell_m,
        }
    }

    fn map_px(&self) -> (u32, u32) {
        let size = (self.size_m * SCALE_PX_PER_M).ceil();
        (size.x as u32, size.y as u32)
    }

    fn blank(&self) -> RgbImage {
        let (width, height) = self.map_px();
        RgbImage::from_pixel(
            width.max(560) + 2 * MARGIN_PX,
            height + 2 * MARGIN_PX + LEGEND_ROWS * ROW_PX,
            PAPER,
        )
    }

    fn pixel(&self, p: DVec2) -> DVec2 {
        let at = (p - self.origin) * SCALE_PX_PER_M;
        let height = f64::from(self.map_px().1);
        DVec2::new(at.x, height - at.y) + f64::from(MARGIN_PX)
    }

    fn point(&self, x: u32, y: u32) -> DVec2 {
        let height = f64::from(self.map_px().1);
        let at = DVec2::new(f64::from(x) + 0.5, height - f64::from(y) - 0.5);
        self.origin + at / SCALE_PX_PER_M
    }

    fn draw_cells(&self, image: &mut RgbImage, region: &ValidRegion, field: &dyn DensityField) {
        let (width, height) = self.map_px();
        for y in 0..height {
            for x in 0..width {
                let p = self.point(x, y);
                let Some(cell) = region.index_at(p) else {
                    continue;
                };
                let base = state_color(region.cells[cell]);
                let ground = region.ground_m[cell];
                let shade = match ground.is_finite() {
                    true => brightness(field, p.extend(ground)),
                    false => 0.0,
                };
                let color = std::array::from_fn(|c| {
                    let dark = 0.6 * f64::from(base.0[c]);
                    (dark + (255.0 - dark) * 0.8 * shade) as u8
                });
                image.put_pixel(x + MARGIN_PX, y + MARGIN_PX, Rgb(color));
            }
        }
    }

    fn draw_box(&self, image: &mut RgbImage, pose: &Rigid, size_m: DVec3, color: Rgb<u8>) {
        let at = |x: f64, y: f64| {
            let corner = DVec3::new(x, y, 0.0) * size_m * 0.5;
            self.pixel(pose.point(corner).truncate())
        };
        let corners = [at(1.0, 1.0), at(-1.0, 1.0), at(-1.0, -1.0), at(1.0, -1.0)];
        for i in 0..4 {
            draw_line(image, corners[i], corners[(i + 1) % 4], 1, color);
        }
        // Where it looks.
        draw_line(image, at(0.0, 0.0), at(1.0, 0.0), 1, color);
    }

    fn draw_legend(&self, image: &mut RgbImage, name: &str, region: &ValidRegion, placed: usize) {
        let top = self.map_px().1 + 2 * MARGIN_PX;
        let area = |state: Cell| {
            let count = region.cells.iter().filter(|c| **c == state).count();
            count as f64 * region.cell_m * region.cell_m
        };
        let lines = [
            (
                INK,
                format!("{name}: {:.0} x {:.0} m", self.size_m.x, self.size_m.y),
            ),
            (FREE, format!("free {:.0} m2", area(Cell::Free))),
            (BLOCKED, format!("blocked {:.0} m2", area(Cell::Blocked))),
            (UNEVEN, format!("uneven {:.0} m2", area(Cell::Uneven))),
            (PATH, "ego path".to_owned()),
            (PLACED, format!("{placed} placements")),
            (ORIGINAL, "objects of the log".to_owned()),
        ];
        for (i, (color, line)) in lines.into_iter().enumerate() {
            let (column, row) = match i {
                0 => (0, 0),
                i => ((i as u32 - 1) % 3, 1 + (i as u32 - 1) / 3),
            };
            let (x, y) = (MARGIN_PX + column * 190, top + row * ROW_PX);
            draw_text(image, x, y, TEXT_SCALE, color, &line);
        }
    }
}

fn state_color(cell: Cell) -> Rgb<u8> {
    match cell {
        Cell::Free => FREE,
        Cell::Blocked => BLOCKED,
        Cell::Uneven => UNEVEN,
        Cell::Unseen => UNSEEN,
    }
}

/// Opacity over a quarter of a metre of the densest place above the ground, 0..=1.
fn brightness(field: &dyn DensityField, ground: DVec3) -> f64 {
    let step = (ABOVE_M.1 - ABOVE_M.0) / f64::from(LEVELS - 1);
    let heights = (0..LEVELS).map(|i| ABOVE_M.0 + step * f64::from(i));
    let densest = heights
        .map(|up| field.sigma(ground + DVec3::Z * up))
        .fold(0.0, f64::max);
    1.0 - libm::exp(-0.25 * densest)
}
