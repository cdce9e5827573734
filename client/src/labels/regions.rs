//! Bounding boxes of the connected regions of a mask.

use image::GrayImage;

/// Regions smaller than this many pixels carry no box: a detector's box is never that small.
const MIN_PIXELS: usize = 25;

/// Left, top, right, bottom (inclusive pixels) of every 4-connected region of pixels over 127.
pub(super) fn bounding_boxes(mask: &GrayImage) -> Vec<[u32; 4]> {
    let (width, height) = mask.dimensions();
    let mut open: Vec<bool> = mask.pixels().map(|p| p.0[0] > 127).collect();
    let mut boxes = Vec::new();
    let mut stack = Vec::new();
    for start in 0..open.len() {
        if !std::mem::take(&mut open[start]) {
            continue;
        }
        let mut bounds = [u32::MAX, u32::MAX, 0, 0];
        let mut pixels = 0;
        stack.push(start);
        while let Some(i) = stack.pop() {
            let (x, y) = (i as u32 % width, i as u32 / width);
            pixels += 1;
            bounds = [
                bounds[0].min(x),
                bounds[1].min(y),
                bounds[2].max(x),
                bounds[3].max(y),
            ];
            let neighbours = [
                (x > 0).then(|| i - 1),
                (x + 1 < width).then(|| i + 1),
                (y > 0).then(|| i - width as usize),
                (y + 1 < height).then(|| i + width as usize),
            ];
            for next in neighbours.into_iter().flatten() {
                if std::mem::take(&mut open[next]) {
                    stack.push(next);
                }
            }
        }
        if pixels >= MIN_PIXELS {
            boxes.push(bounds);
        }
    }
    boxes
}

#[cfg(test)]
mod tests {
    use image::Luma;

    use super::*;

    #[test]
    fn separate_regions_have_separate_boxes() {
        let mask = GrayImage::from_fn(40, 30, |x, y| {
            let first = (2..8).contains(&x) && (3..9).contains(&y);
            let second = (20..30).contains(&x) && (10..20).contains(&y);
            let speck = x == 39 && y == 29;
            Luma([if first || second || speck { 255 } else { 0 }])
        });
        assert_eq!(bounding_boxes(&mask), [[2, 3, 7, 8], [20, 10, 29, 19]]);
    }
}
