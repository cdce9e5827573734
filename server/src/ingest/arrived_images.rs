//! Images that are decoded as they arrive, so that an upload's check waits for the last few only.

use std::collections::{HashMap, VecDeque};
use std::panic::{self, AssertUnwindSafe};
use std::sync::{Arc, Mutex, MutexGuard};

use bytes::Bytes;

use super::content::MAX_FILE_BYTES;
use super::image::decoded_size;
use crate::domain::blob::{BlobRef, Digest};

/// Blobs remembered: ten logs of a thousand images each five times over, in a few megabytes.
const MAX_REMEMBERED: usize = 50_000;

/// What images were found to be, and which are still to be looked at. Only good news is kept: what does not decode is decoded again
/// by the check, which says what is wrong with it.
#[derive(Clone, Debug)]
pub(crate) struct ArrivedImages {
    state: Arc<Mutex<State>>,
    /// Images decoded at once, each held in memory.
    most_running: usize,
}

#[derive(Debug, Default)]
struct State {
    images: HashMap<Digest, Image>,
    /// In order of arrival, each once; those at the front are forgotten first.
    order: VecDeque<Digest>,
    waiting: VecDeque<Digest>,
    running: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Image {
    Waiting,
    Running,
    Decoded((u32, u32)),
    /// Being checked elsewhere, no image, or damaged.
    Dropped,
}

impl ArrivedImages {
    pub(crate) fn new(most_running: usize) -> Self {
        Self {
            state: Arc::default(),
            most_running: most_running.max(1),
        }
    }

    /// Notes a blob that is whole now. True if the caller must run [`Self::work`] on a thread of its own.
    #[must_use]
    pub(crate) fn arrived(&self, blob: &BlobRef) -> bool {
        let mut state = self.state();
        if blob.size_bytes > MAX_FILE_BYTES || state.images.contains_key(&blob.digest) {
            return false;
        }
        if state.order.len() >= MAX_REMEMBERED
            && let Some(oldest) = state.order.pop_front()
        {
            state.images.remove(&oldest);
        }
        state.images.insert(blob.digest, Image::Waiting);
        state.order.push_back(blob.digest);
        state.waiting.push_back(blob.digest);
        let starts = state.running < self.most_running;
        state.running += usize::from(starts);
        starts
    }

    /// Decodes what waits until nothing does. `read` gives a blob's content, or `None` if it is not to be looked at. Blocks.
    pub(crate) fn work(&self, read: impl Fn(&Digest) -> Option<Bytes>) {
        while let Some(digest) = self.next() {
            // A decoder that panics must not end the worker, which is counted as running.
            let size = panic::catch_unwind(AssertUnwindSafe(|| {
                read(&digest).and_then(|content| decoded_size(&content).ok())
            }));
            let size = size.ok().flatten();
            let found = size.map_or(Image::Dropped, Image::Decoded);
            // It may have been forgotten in the meantime.
            if let Some(image) = self.state().images.get_mut(&digest) {
                *image = found;
            }
        }
    }

    /// The next image that waits; none ends a worker, in the same breath, so that no image is left without one.
    fn next(&self) -> Option<Digest> {
        let mut state = self.state();
        while let Some(digest) = state.waiting.pop_front() {
            if let Some(image) = state.images.get_mut(&digest)
                && *image == Image::Waiting
            {
                *image = Image::Running;
                return Some(digest);
            }
        }
        state.running -= 1;
        None
    }

    /// Size in pixels of an image that was decoded. One that waits is left to the caller.
    pub(crate) fn decoded_size(&self, digest: &Digest) -> Option<(u32, u32)> {
        match self.state().images.get_mut(digest)? {
            Image::Decoded(size) => Some(*size),
            waiting @ Image::Waiting => {
                *waiting = Image::Dropped;
                None
            }
            Image::Running | Image::Dropped => None,
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().expect("no panic while held")
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, RgbImage};

    use super::*;

    fn encoded(image: impl Into<DynamicImage>, format: ImageFormat) -> Bytes {
        let mut bytes = Cursor::new(Vec::new());
        image.into().write_to(&mut bytes, format).unwrap();
        bytes.into_inner().into()
    }

    fn street(width: u32) -> RgbImage {
        RgbImage::from_fn(width, 30, |x, y| image::Rgb([x as u8, y as u8 * 8, 7]))
    }

    fn noted(images: &ArrivedImages, content: &[u8]) -> (Digest, bool) {
        let blob = BlobRef::of(content);
        (blob.digest, images.arrived(&blob))
    }

    #[test]
    fn whole_images_are_known_by_their_size_and_nothing_else_is() {
        let mut cut = encoded(street(40), ImageFormat::Jpeg).to_vec();
        cut.truncate(cut.len() / 2);
        cut.extend([0xff, 0xd9]);
        let mut damaged = encoded(street(41), ImageFormat::Png).to_vec();
        let middle = damaged.len() / 2;
        damaged[middle] ^= 0x40;
        let mask = ImageBuffer::<Luma<u16>, _>::from_pixel(9, 9, Luma([3]));
        let contents: [(Bytes, Option<(u32, u32)>); 6] = [
            (encoded(street(42), ImageFormat::Jpeg), Some((42, 30))),
            (encoded(street(43), ImageFormat::Png), Some((43, 30))),
            (encoded(mask, ImageFormat::Png), None),
            (damaged.into(), None),
            (b"points"[..].into(), None),
            (Bytes::new(), None),
        ];
        let images = ArrivedImages::new(2);
        for (content, _) in &contents {
            let _ = noted(&images, content);
        }
        images.work(|digest| {
            let found = contents.iter().find(|(c, _)| Digest::of(c) == *digest);
            found.map(|(c, _)| c.clone())
        });
        for (content, expected) in &contents {
            assert_eq!(images.decoded_size(&Digest::of(content)), *expected);
        }
    }

    #[test]
    fn workers_are_as_many_as_allowed_and_end_when_nothing_waits() {
        let images = ArrivedImages::new(2);
        let started = [b"a", b"b", b"c"].map(|content| noted(&images, content).1);
        assert_eq!(started, [true, true, false]);
        assert!(!noted(&images, b"c").1, "noted twice");
        images.work(|digest| match *digest == Digest::of(b"a") {
            true => panic!("a decoder's bug"),
            false => None,
        });
        images.work(|_| unreachable!("nothing is left"));
        assert!(noted(&images, b"d").1);
    }

    #[test]
    fn what_a_check_takes_is_not_decoded_again() {
        let images = ArrivedImages::new(1);
        let (first, _) = noted(&images, b"first");
        let (second, _) = noted(&images, b"second");
        assert_eq!(images.decoded_size(&first), None);
        images.work(|digest| {
            assert_eq!(*digest, second);
            None
        });
    }

    #[test]
    fn the_oldest_are_forgotten() {
        let images = ArrivedImages::new(1);
        for i in 0..MAX_REMEMBERED + 3 {
            let _ = noted(&images, &i.to_le_bytes());
        }
        let state = images.state();
        assert_eq!(state.images.len(), MAX_REMEMBERED);
        assert!(
            !state
                .images
                .contains_key(&Digest::of(&2usize.to_le_bytes()))
        );
        assert!(
            state
                .images
                .contains_key(&Digest::of(&3usize.to_le_bytes()))
        );
    }
}
