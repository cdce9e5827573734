//! Small operations on row-major pixel masks and images.

/// Grows a mask by `radius` pixels in the eight directions.
pub(super) fn dilate(mask: &[bool], width: usize, radius: usize) -> Vec<bool> {
    if radius == 0 || width == 0 {
        return mask.to_vec();
    }
    let height = mask.len() / width;
    let mut rows = vec![false; mask.len()];
    for y in 0..height {
        let row = &mask[y * width..][..width];
        for x in (0..width).filter(|&x| row[x]) {
            let span = x.saturating_sub(radius)..(x + radius + 1).min(width);
            rows[y * width..][span].fill(true);
        }
    }
    let mut grown = vec![false; mask.len()];
    for y in 0..height {
        for near in y.saturating_sub(radius)..(y + radius + 1).min(height) {
            for x in 0..width {
                grown[near * width + x] |= rows[y * width + x];
            }
        }
    }
    grown
}

/// How much of each source pixel one target pixel covers along an axis: (first source pixel, weights that sum to 1).
fn coverage(source: usize, target: usize) -> Vec<(usize, Vec<f32>)> {
    let scale = source as f64 / target as f64;
    (0..target)
        .map(|i| {
            let (start, end) = (i as f64 * scale, (i + 1) as f64 * scale);
            let first = start.floor() as usize;
            let last = (end.ceil() as usize).min(source);
            let weights = (first..last)
                .map(|s| {
                    let overlap = end.min((s + 1) as f64) - start.max(s as f64);
                    (overlap.max(0.0) / scale) as f32
                })
                .collect();
            (first, weights)
        })
        .collect()
}

/// Shrinks an interleaved RGB image by averaging areas: a target pixel is the mean of the source area it covers, as a
/// camera with larger pixels would see it.
pub(super) fn area_average(rgb: &[u8], from: (u32, u32), to: (u32, u32)) -> Vec<u8> {
    if from == to {
        return rgb.to_vec();
    }
    let (from_w, to_w) = (from.0 as usize, to.0 as usize);
    let columns = coverage(from_w, to_w);
    let rows = coverage(from.1 as usize, to.1 as usize);
    let mut out = Vec::with_capacity(to_w * rows.len() * 3);
    let mut line = vec![0f32; to_w * 3];
    for (first_row, row_weights) in &rows {
        line.fill(0.0);
        for (dy, &row_weight) in row_weights.iter().enumerate() {
            let source = &rgb[(first_row + dy) * from_w * 3..][..from_w * 3];
            for (target, (first, weights)) in line.chunks_exact_mut(3).zip(&columns) {
                for (dx, &weight) in weights.iter().enumerate() {
                    let pixel = &source[(first + dx) * 3..][..3];
                    let weight = weight * row_weight;
                    for (sum, &value) in target.iter_mut().zip(pixel) {
                        *sum += weight * f32::from(value);
                    }
                }
            }
        }
        out.extend(line.iter().map(|&v| (v + 0.5) as u8));
    }
    out
}

/// Shrinks labels: `merge` folds the labels of the source pixels that a target pixel touches.
pub(super) fn merge_area<T: Copy>(
    labels: &[T],
    from: (u32, u32),
    to: (u32, u32),
    merge: impl Fn(T, T) -> T,
) -> Vec<T> {
    if from == to {
        return labels.to_vec();
    }
    let width = from.0 as usize;
    let columns = coverage(width, to.0 as usize);
    let rows = coverage(from.1 as usize, to.1 as usize);
    let mut out = Vec::with_capacity(columns.len() * rows.len());
    for (first_row, row_weights) in &rows {
        for (first, weights) in &columns {
            let mut merged = labels[first_row * width + first];
            for y in *first_row..first_row + row_weights.len() {
                for &label in &labels[y * width + first..][..weights.len()] {
                    merged = merge(merged, label);
                }
            }
            out.push(merged);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_average_keeps_the_mean_and_the_place_of_an_edge() {
        // A 5 x 1 image with a step: 2.5 source pixels a target pixel.
        let rgb: Vec<u8> = [0, 0, 0, 100, 100].iter().flat_map(|&v| [v; 3]).collect();
        let half = area_average(&rgb, (5, 1), (2, 1));
        assert_eq!(half, [0, 0, 0, 80, 80, 80]);
        assert_eq!(area_average(&rgb, (5, 1), (5, 1)), rgb);
    }

    #[test]
    fn merged_labels_see_every_touched_pixel() {
        let labels = [0u8, 0, 0, 9, 0, 0];
        assert_eq!(merge_area(&labels, (6, 1), (2, 1), u8::max), [0, 9]);
        assert_eq!(merge_area(&labels, (3, 2), (1, 1), u8::max), [9]);
    }

    #[test]
    fn dilation_grows_squares_and_stops_at_the_border() {
        let mut mask = vec![false; 25];
        mask[12] = true;
        let grown = dilate(&mask, 5, 1);
        assert_eq!(grown.iter().filter(|&&m| m).count(), 9);
        assert!(grown[6] && grown[18] && !grown[2]);
        assert_eq!(dilate(&mask, 5, 7), vec![true; 25]);
        assert_eq!(dilate(&mask, 5, 0), mask);
    }
}
