//! Pictures for people: boxes drawn over samples, captions, the contact sheet and the map of a valid region.

mod contact_sheet;
mod font;
mod line;
mod overlay;
mod region_map;

pub use contact_sheet::{Tile, contact_sheet};
pub use font::{GLYPH_HEIGHT, draw_text};
pub use line::draw_line;
pub use overlay::{draw_boxes, draw_cuboid, draw_rectangle};
pub use region_map::{MapBox, region_map};
