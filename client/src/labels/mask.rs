//! Instance masks as COCO writes them.

/// A mask's run lengths in COCO's compressed text: each run, from the third on less the one two before it, in base 32 from the lowest digit
/// with a sign, one character a digit. The format of the COCO API's `rleToString`.
pub(super) fn compressed(runs: &[u32]) -> String {
    let mut text = String::new();
    for (i, run) in runs.iter().enumerate() {
        let mut rest = i64::from(*run);
        if i > 2 {
            rest -= i64::from(runs[i - 2]);
        }
        loop {
            let digit = (rest & 31) as u8;
            rest >>= 5;
            // The highest bit of the last digit is the sign.
            let ends = match digit & 16 {
                0 => rest == 0,
                _ => rest == -1,
            };
            text.push(char::from(48 + digit + if ends { 0 } else { 32 }));
            if ends {
                break;
            }
        }
    }
    text
}

/// The runs of a row-major mask, columns first and beginning outside.
pub(super) fn runs_of(mask: &image::GrayImage) -> Vec<u32> {
    let (width, height) = mask.dimensions();
    let mut runs = vec![0];
    let mut inside = false;
    for x in 0..width {
        for y in 0..height {
            if (mask.get_pixel(x, y).0[0] > 127) != inside {
                inside = !inside;
                runs.push(0);
            }
            if let Some(last) = runs.last_mut() {
                *last += 1;
            }
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use image::{GrayImage, Luma};
    use proptest::prelude::*;

    use super::*;

    /// Written from the format's description, not from the code above.
    fn decompressed(text: &str) -> Vec<i64> {
        let mut runs: Vec<i64> = Vec::new();
        let mut characters = text.bytes().map(|c| i64::from(c) - 48);
        while let Some(first) = characters.next() {
            let (mut value, mut shift, mut digit) = (0i64, 0, first);
            loop {
                value |= (digit & 31) << shift;
                shift += 5;
                if digit & 32 == 0 {
                    if digit & 16 != 0 {
                        value |= -1 << shift;
                    }
                    break;
                }
                digit = characters.next().expect("a digit follows");
            }
            if runs.len() > 2 {
                value += runs[runs.len() - 2];
            }
            runs.push(value);
        }
        runs
    }

    proptest! {
        #[test]
        fn text_reads_back(runs in prop::collection::vec(0u32..2_000_000, 0..20)) {
            let back = decompressed(&compressed(&runs));
            let wanted: Vec<i64> = runs.iter().map(|r| i64::from(*r)).collect();
            prop_assert_eq!(&back, &wanted);
            if let Some((last, rest)) = runs.split_last() {
                let mut other = rest.to_vec();
                other.push(last + 1);
                prop_assert_ne!(decompressed(&compressed(&other)), wanted);
            }
        }
    }

    #[test]
    fn runs_go_down_the_columns() {
        let mask = GrayImage::from_fn(3, 2, |x, y| {
            Luma([if x == 1 || (x, y) == (2, 0) { 255 } else { 0 }])
        });
        assert_eq!(runs_of(&mask), [2, 3, 1]);
        let first = GrayImage::from_fn(1, 2, |_, y| Luma([if y == 0 { 255 } else { 0 }]));
        assert_eq!(runs_of(&first), [0, 1, 1]);
    }
}
