//! A plane of values over part of an image, read between its pixels.

/// Values row-major of `height * width`, centres at +0.5.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Plane {
    pub width: usize,
    pub height: usize,
    pub values: Vec<f32>,
}

/// What a plane is beyond its border.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Beyond {
    /// As the nearest pixel.
    Same,
    /// Zero.
    Nothing,
}

impl Plane {
    /// Bilinear between the four pixels around (x, y), in the plane's pixels.
    pub(super) fn at(&self, x: f64, y: f64, beyond: Beyond) -> f32 {
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        let across = (x - 0.5 - left) as f32;
        let down = (y - 0.5 - top) as f32;
        let (left, top) = (left as i64, top as i64);
        let value = |dx: i64, dy: i64| self.value(left + dx, top + dy, beyond);
        let upper = value(0, 0) * (1.0 - across) + value(1, 0) * across;
        let lower = value(0, 1) * (1.0 - across) + value(1, 1) * across;
        upper * (1.0 - down) + lower * down
    }

    fn value(&self, x: i64, y: i64, beyond: Beyond) -> f32 {
        let (last_x, last_y) = (self.width as i64 - 1, self.height as i64 - 1);
        let inside = (0..=last_x).contains(&x) && (0..=last_y).contains(&y);
        if !inside && beyond == Beyond::Nothing {
            return 0.0;
        }
        let (x, y) = (x.clamp(0, last_x), y.clamp(0, last_y));
        self.values[y as usize * self.width + x as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn centres_are_exact_and_between_them_it_is_linear() {
        let plane = Plane {
            width: 3,
            height: 2,
            values: vec![1.0, 2.0, 4.0, 10.0, 20.0, 40.0],
        };
        assert_eq!(plane.at(1.5, 0.5, Beyond::Same), 2.0);
        assert_eq!(plane.at(1.0, 0.5, Beyond::Same), 1.5);
        assert_eq!(plane.at(2.5, 1.0, Beyond::Same), 22.0);
        assert_eq!(plane.at(3.0, 2.0, Beyond::Same), 40.0);
        // Half a pixel from the corner's centre on both sides.
        assert_eq!(plane.at(3.0, 2.0, Beyond::Nothing), 10.0);
        assert_eq!(plane.at(-5.0, 9.0, Beyond::Same), 10.0);
        assert_eq!(plane.at(-5.0, 9.0, Beyond::Nothing), 0.0);
    }
}
