//! A sheet of picture pairs: the recorded frame beside the augmented one.

use image::imageops::{self, FilterType};
use image::{Rgb, RgbImage};

use super::{GLYPH_HEIGHT, draw_text};

/// Widest a picture is drawn.
const MAX_TILE_WIDTH: u32 = 640;
/// Pairs beside each other.
const PAIRS_PER_ROW: usize = 2;
const GAP_PX: u32 = 6;
const TEXT_SCALE: u32 = 2;
const CAPTION_PX: u32 = GLYPH_HEIGHT * TEXT_SCALE + 6;
const PAPER: Rgb<u8> = Rgb([24, 24, 28]);
const INK: Rgb<u8> = Rgb([225, 225, 225]);

/// One picture and the line below it.
#[derive(Clone, Debug)]
pub struct Tile {
    pub image: RgbImage,
    pub caption: String,
}

/// Lays out pairs of pictures below a title. All pictures are scaled to the width of the first, at most 640 pixels.
pub fn contact_sheet(title: &str, pairs: &[[Tile; 2]]) -> RgbImage {
    let Some([first, _]) = pairs.first() else {
        return RgbImage::from_pixel(1, 1, PAPER);
    };
    let tile_width = first.image.width().min(MAX_TILE_WIDTH);
    let tile_height = first.image.height() * tile_width / first.image.width().max(1);
    let columns = 2 * PAIRS_PER_ROW.min(pairs.len()) as u32;
    let rows = pairs.len().div_ceil(PAIRS_PER_ROW) as u32;
    let cell = (tile_width + GAP_PX, tile_height + CAPTION_PX + GAP_PX);
    let top = GAP_PX + CAPTION_PX;
    let mut sheet = RgbImage::from_pixel(GAP_PX + columns * cell.0, top + rows * cell.1, PAPER);
    draw_text(&mut sheet, GAP_PX, GAP_PX, TEXT_SCALE, INK, title);
    for (i, pair) in pairs.iter().enumerate() {
        for (j, tile) in pair.iter().enumerate() {
            let column = (i % PAIRS_PER_ROW * 2 + j) as u32;
            let x = GAP_PX + column * cell.0;
            let y = top + (i / PAIRS_PER_ROW) as u32 * cell.1;
            let picture = scaled(&tile.image, tile_width, tile_height);
            imageops::replace(&mut sheet, &picture, x.into(), y.into());
            let fits = (tile_width / (4 * TEXT_SCALE)) as usize;
            let caption: String = tile.caption.chars().take(fits).collect();
            draw_text(
                &mut sheet,
                x,
                y + tile_height + 3,
                TEXT_SCALE,
                INK,
                &caption,
            );
        }
    }
    sheet
}

fn scaled(image: &RgbImage, width: u32, height: u32) -> RgbImage {
    if image.dimensions() == (width, height) {
        image.clone()
    } else {
        imageops::resize(image, width, height, FilterType::Triangle)
    }
}
