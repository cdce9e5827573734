//! Straight lines.

use glam::DVec2;
use image::{Rgb, RgbImage};

/// Draws a line of `width_px` between two continuous pixel positions, clipped to the image.
pub fn draw_line(image: &mut RgbImage, from: DVec2, to: DVec2, width_px: u32, color: Rgb<u8>) {
    let Some((from, to)) = clipped(
        from,
        to,
        DVec2::new(image.width().into(), image.height().into()),
    ) else {
        return;
    };
    let steps = (to - from).abs().max_element().ceil().max(1.0) as u32;
    let low = (i64::from(width_px) - 1) / 2;
    for i in 0..=steps {
        let p = from.lerp(to, f64::from(i) / f64::from(steps)).floor();
        for dy in 0..i64::from(width_px) {
            for dx in 0..i64::from(width_px) {
                let (x, y) = (p.x as i64 + dx - low, p.y as i64 + dy - low);
                let inside = (0..i64::from(image.width())).contains(&x)
                    && (0..i64::from(image.height())).contains(&y);
                if inside {
                    image.put_pixel(x as u32, y as u32, color);
                }
            }
        }
    }
}

/// The part of a segment inside `[0, size]`, by Liang and Barsky's clipping.
fn clipped(from: DVec2, to: DVec2, size: DVec2) -> Option<(DVec2, DVec2)> {
    let step = to - from;
    let (mut start, mut end) = (0.0f64, 1.0f64);
    for axis in 0..2 {
        for (direction, room) in [
            (-step[axis], from[axis]),
            (step[axis], size[axis] - from[axis]),
        ] {
            if direction == 0.0 && room < 0.0 {
                return None;
            }
            if direction < 0.0 {
                start = start.max(room / direction);
            }
            if direction > 0.0 {
                end = end.min(room / direction);
            }
        }
    }
    (start <= end).then(|| (from + step * start, from + step * end))
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHITE: Rgb<u8> = Rgb([255; 3]);

    fn lit(image: &RgbImage) -> usize {
        image.pixels().filter(|p| **p == WHITE).count()
    }

    #[test]
    fn lines_far_outside_cost_nothing_and_draw_their_inner_part() {
        let mut image = RgbImage::new(20, 10);
        let far = DVec2::new(-1e9, 5.0);
        draw_line(&mut image, far, DVec2::new(1e9, 5.0), 1, WHITE);
        assert_eq!(lit(&image), 20);
        let mut image = RgbImage::new(20, 10);
        draw_line(
            &mut image,
            DVec2::new(-5.0, -1.0),
            DVec2::new(30.0, -1.0),
            1,
            WHITE,
        );
        assert_eq!(lit(&image), 0);
    }

    #[test]
    fn a_wide_line_is_wide() {
        let mut image = RgbImage::new(20, 10);
        draw_line(
            &mut image,
            DVec2::new(2.5, 5.5),
            DVec2::new(11.5, 5.5),
            2,
            WHITE,
        );
        assert_eq!(lit(&image), 22);
    }
}
