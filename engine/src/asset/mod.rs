//! Stored assets: a header with all that composition needs, and the field.

mod decode;
mod encode;
mod header;
mod layout;
mod quantize;

#[cfg(test)]
mod tests;

pub use header::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};

use crate::Field;

/// A trained field with its header.
#[derive(Clone, Debug, PartialEq)]
pub struct Asset {
    pub header: AssetHeader,
    pub field: Field,
}
