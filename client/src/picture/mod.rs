//! Pictures for people: boxes drawn over samples, captions and the contact sheet.

mod contact_sheet;
mod font;
mod line;
mod overlay;

pub use contact_sheet::{Tile, contact_sheet};
pub use font::{GLYPH_HEIGHT, draw_text};
pub use line::draw_line;
pub use overlay::{draw_boxes, draw_cuboid, draw_rectangle};
