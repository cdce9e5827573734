//! How an image lies in a model's input.

use glam::DVec2;

use super::segmenter::RgbImage;
use super::settings::ChannelOrder;
use super::tensor::Tensor;

/// What the padding is: the grey that YOLO models are trained with.
const PADDING: f32 = 114.0 / 255.0;

/// How pixels become a network's numbers: `(value / 255 - mean) / deviation` for each channel in its order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Normalisation {
    pub order: ChannelOrder,
    pub mean: [f32; 3],
    pub deviation: [f32; 3],
}

/// An image scaled as one to fit a model's input, centred, the rest padded. Sizes are (width, height); positions are in pixels whose
/// centres are at +0.5, so that the maps are exact in both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Letterbox {
    image: (u32, u32),
    input: (u32, u32),
    /// The scaled image, whole pixels.
    content: (u32, u32),
    /// Its first column and row in the input.
    offset: (u32, u32),
}

impl Letterbox {
    pub(super) fn new(image: (u32, u32), input: (u32, u32)) -> Self {
        let scale =
            (f64::from(input.0) / f64::from(image.0)).min(f64::from(input.1) / f64::from(image.1));
        let scaled = |length: u32, limit: u32| {
            (f64::from(length) * scale)
                .round()
                .clamp(1.0, f64::from(limit)) as u32
        };
        let content = (scaled(image.0, input.0), scaled(image.1, input.1));
        Self {
            image,
            input,
            content,
            offset: ((input.0 - content.0) / 2, (input.1 - content.1) / 2),
        }
    }

    /// Size of the image, (width, height).
    pub(super) fn image_size(&self) -> (u32, u32) {
        self.image
    }

    /// Size of the model's input, (width, height).
    pub(super) fn input_size(&self) -> (u32, u32) {
        self.input
    }

    /// Where a position in the image lies in the input.
    pub(super) fn input_from_image(&self, image_px: DVec2) -> DVec2 {
        image_px * self.scale() + self.offset_px()
    }

    /// The inverse of [`Self::input_from_image`].
    pub(super) fn image_from_input(&self, input_px: DVec2) -> DVec2 {
        (input_px - self.offset_px()) / self.scale()
    }

    /// The model's input, [3, height, width], the image resampled bilinearly.
    pub(super) fn tensor(&self, image: RgbImage<'_>, normalisation: &Normalisation) -> Tensor {
        let (width, height) = (self.input.0 as usize, self.input.1 as usize);
        let plane = width * height;
        let mut values = vec![0.0; 3 * plane];
        let columns = taps(self.content.0, self.image.0);
        let rows = taps(self.content.1, self.image.1);
        for (channel, out) in values.chunks_exact_mut(plane).enumerate() {
            let (mean, deviation) = (
                normalisation.mean[channel],
                normalisation.deviation[channel],
            );
            let number = |value: f32| (value - mean) / deviation;
            out.fill(number(PADDING));
            let source = match normalisation.order {
                ChannelOrder::Rgb => channel,
                ChannelOrder::Bgr => 2 - channel,
            };
            let at = |x: usize, y: usize| {
                f32::from(image.pixels[(y * self.image.0 as usize + x) * 3 + source])
            };
            for (row, down) in rows.iter().enumerate() {
                let start = (self.offset.1 as usize + row) * width + self.offset.0 as usize;
                let line = &mut out[start..][..columns.len()];
                for (value, across) in line.iter_mut().zip(&columns) {
                    let upper =
                        across.mix(at(across.first, down.first), at(across.second, down.first));
                    let lower = across.mix(
                        at(across.first, down.second),
                        at(across.second, down.second),
                    );
                    *value = number(down.mix(upper, lower) / 255.0);
                }
            }
        }
        Tensor::new(vec![3, height, width], values)
    }

    fn scale(&self) -> DVec2 {
        size(self.content) / size(self.image)
    }

    fn offset_px(&self) -> DVec2 {
        size(self.offset)
    }
}

fn size((width, height): (u32, u32)) -> DVec2 {
    DVec2::new(f64::from(width), f64::from(height))
}

/// The two source pixels of a scaled one.
struct Tap {
    first: usize,
    second: usize,
    /// Of the second.
    weight: f32,
}

impl Tap {
    fn mix(&self, first: f32, second: f32) -> f32 {
        first + (second - first) * self.weight
    }
}

fn taps(scaled: u32, length: u32) -> Vec<Tap> {
    let step = f64::from(length) / f64::from(scaled);
    let last = length as usize - 1;
    let tap = |i: u32| {
        let at = ((f64::from(i) + 0.5) * step - 0.5).clamp(0.0, last as f64);
        let first = at as usize;
        Tap {
            first,
            second: (first + 1).min(last),
            weight: (at - first as f64) as f32,
        }
    };
    (0..scaled).map(tap).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: Normalisation = Normalisation {
        order: ChannelOrder::Rgb,
        mean: [0.0; 3],
        deviation: [1.0; 3],
    };

    /// A picture of bytes that tell their place.
    fn picture((width, height): (u32, u32)) -> Vec<u8> {
        let byte = |i: u32| (i * 7 % 251) as u8;
        (0..width * height * 3).map(byte).collect()
    }

    fn at(tensor: &Tensor, channel: usize, x: usize, y: usize) -> f32 {
        tensor.values[(channel * tensor.shape[1] + y) * tensor.shape[2] + x]
    }

    #[test]
    fn the_image_is_centred_and_positions_return_exactly() {
        let boxed = Letterbox::new((1242, 375), (640, 640));
        assert_eq!((boxed.content, boxed.offset), ((640, 193), (0, 223)));
        let corner = boxed.input_from_image(DVec2::new(1242.0, 375.0));
        assert!((corner - DVec2::new(640.0, 223.0 + 193.0)).length() < 1e-9);
        for sizes in [
            ((1242, 375), (640, 640)),
            ((160, 96), (640, 640)),
            ((97, 1024), (320, 256)),
        ] {
            let boxed = Letterbox::new(sizes.0, sizes.1);
            for p in [DVec2::ZERO, DVec2::new(33.25, 71.5), DVec2::new(96.5, 95.0)] {
                let back = boxed.image_from_input(boxed.input_from_image(p));
                assert!((back - p).length() < 1e-9, "{sizes:?} {p}");
            }
        }
    }

    #[test]
    fn an_image_of_the_inputs_size_is_itself_in_its_channel_order() {
        let (size, bytes) = ((8, 6), picture((8, 6)));
        let image = RgbImage {
            size,
            pixels: &bytes,
        };
        let boxed = Letterbox::new(size, size);
        let rgb = boxed.tensor(image, &PLAIN);
        let bgr = boxed.tensor(
            image,
            &Normalisation {
                order: ChannelOrder::Bgr,
                ..PLAIN
            },
        );
        for (i, &byte) in bytes.iter().enumerate() {
            let (x, y, channel) = (i / 3 % 8, i / 24, i % 3);
            assert_eq!(at(&rgb, channel, x, y), f32::from(byte) / 255.0);
            assert_eq!(at(&bgr, 2 - channel, x, y), f32::from(byte) / 255.0);
        }
    }

    #[test]
    fn scaling_agrees_with_sampling_every_pixel_by_itself() {
        for (size, input) in [
            ((40, 24), (64, 64)),
            ((200, 100), (64, 48)),
            ((33, 90), (64, 64)),
        ] {
            let bytes = picture(size);
            let boxed = Letterbox::new(size, input);
            let made = boxed.tensor(
                RgbImage {
                    size,
                    pixels: &bytes,
                },
                &PLAIN,
            );
            for y in 0..input.1 {
                for x in 0..input.0 {
                    let p =
                        boxed.image_from_input(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
                    let expected = sampled(&bytes, size, p);
                    for (channel, expected) in expected.into_iter().enumerate() {
                        let found = at(&made, channel, x as usize, y as usize);
                        assert!(
                            (found - expected).abs() < 1e-5,
                            "{size:?} at {x}, {y}: {found}, not {expected}"
                        );
                    }
                }
            }
        }
    }

    /// Bilinear between the four centres around `p`; padding outside the image.
    fn sampled(bytes: &[u8], (width, height): (u32, u32), p: DVec2) -> [f32; 3] {
        if p.x < 0.0 || p.y < 0.0 || p.x > f64::from(width) || p.y > f64::from(height) {
            return [PADDING; 3];
        }
        std::array::from_fn(|channel| {
            let mut sum = 0.0;
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let corner = (p - 0.5).floor() + DVec2::new(f64::from(dx), f64::from(dy));
                let near = DVec2::ONE - (p - 0.5 - corner).abs();
                let weight = near.x * near.y;
                let x = corner.x.clamp(0.0, f64::from(width - 1)) as usize;
                let y = corner.y.clamp(0.0, f64::from(height - 1)) as usize;
                sum += weight * f64::from(bytes[(y * width as usize + x) * 3 + channel]);
            }
            (sum / 255.0) as f32
        })
    }

    #[test]
    fn numbers_are_normalised_by_channel() {
        let bytes = [255, 0, 51];
        let normalisation = Normalisation {
            order: ChannelOrder::Rgb,
            mean: [0.5, 0.0, 0.2],
            deviation: [0.25, 1.0, 0.5],
        };
        let boxed = Letterbox::new((1, 1), (2, 1));
        let made = boxed.tensor(
            RgbImage {
                size: (1, 1),
                pixels: &bytes,
            },
            &normalisation,
        );
        let first: Vec<f32> = (0..3).map(|c| at(&made, c, 0, 0)).collect();
        for (found, expected) in first.iter().zip([2.0, 0.0, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{first:?}");
        }
        assert!((at(&made, 0, 1, 0) - (PADDING - 0.5) / 0.25).abs() < 1e-6);
    }
}
