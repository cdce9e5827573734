//! Stored assets: a header with all that composition needs, and the field.

mod decode;
mod encode;
mod header;
mod layout;
mod quantize;
mod visible;

#[cfg(test)]
mod tests;

pub use header::{AssetHeader, AssetKind, ColorSpace, FORMAT_VERSION, Usage};

use std::sync::Arc;

use crate::Field;

/// A trained field with its header.
#[derive(Clone, Debug, PartialEq)]
pub struct Asset {
    pub header: AssetHeader,
    /// Shared, so that a device can tell whether it holds this field already.
    pub field: Arc<Field>,
}
