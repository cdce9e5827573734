//! The port: an image in, the road users in it out.

use std::fmt::Debug;

use super::error::SegmentError;
use super::instance::Instance;
use crate::domain::blob::Digest;

/// An sRGB image, row-major, `height * width * 3` bytes.
#[derive(Clone, Copy, Debug)]
pub struct RgbImage<'a> {
    /// Width and height in pixels.
    pub size: (u32, u32),
    pub pixels: &'a [u8],
}

/// Finds road users in images. Calls block and may take seconds.
pub trait Segmenter: Debug + Send + Sync {
    /// The instances in the image, best first; masks are in its own pixels.
    ///
    /// # Errors
    /// [`SegmentError`] if the model cannot be run or its outputs are not of its layout.
    fn segment(&self, image: RgbImage<'_>) -> Result<Vec<Instance>, SegmentError>;

    /// Digest of all that answers depend on: the model and how it is used.
    fn digest(&self) -> Digest;

    /// For people: the model's file name.
    fn name(&self) -> &str;
}
