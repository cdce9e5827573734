//! Run lengths of the instances of an image, as COCO stores masks.

/// The mask of each instance id below `slots` as lengths of alternating runs, column by column and each column from the top:
/// first pixels outside (0 if the first pixel is inside), then inside, and so on; they add up to the image's pixels.
///
/// An id without a pixel has no runs. `instance` is row-major with rows of `width`.
pub fn column_runs(instance: &[u16], width: usize, slots: usize) -> Vec<Vec<u32>> {
    let mut runs: Vec<Vec<u32>> = vec![Vec::new(); slots];
    let mut ends = vec![0u32; slots];
    let Some(height) = instance.len().checked_div(width) else {
        return runs;
    };
    let (mut owner, mut start) = (0u16, 0u32);
    let mut close = |owner: u16, start: u32, end: u32| {
        if owner != 0 {
            let slot = usize::from(owner);
            runs[slot].extend([start - ends[slot], end - start]);
            ends[slot] = end;
        }
    };
    for column in 0..width {
        for row in 0..height {
            let id = instance[row * width + column];
            if id != owner {
                let at = (column * height + row) as u32;
                close(owner, start, at);
                (owner, start) = (id, at);
            }
        }
    }
    let total = instance.len() as u32;
    close(owner, start, total);
    for (runs, end) in runs.iter_mut().zip(ends) {
        if !runs.is_empty() && end < total {
            runs.push(total - end);
        }
    }
    runs
}

/// The pixels inside a mask made of [`column_runs`], row-major.
///
/// # Panics
/// If the runs do not add up to `width * height`.
pub fn mask_of_runs(runs: &[u32], width: usize, height: usize) -> Vec<bool> {
    let mut mask = vec![false; width * height];
    let mut at = 0;
    for (i, run) in runs.iter().enumerate() {
        for pixel in at..at + *run as usize {
            mask[pixel % height * width + pixel / height] = i % 2 == 1;
        }
        at += *run as usize;
    }
    assert_eq!(at, width * height, "the runs cover the image");
    mask
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn runs_go_down_the_columns_and_begin_outside() {
        // Columns: 1 1 0, 0 2 2, 2 1 1.
        let instance = [1, 0, 2, 1, 2, 1, 0, 2, 1];
        let runs = column_runs(&instance, 3, 4);
        assert_eq!(runs[1], [0, 2, 5, 2]);
        assert_eq!(runs[2], [4, 3, 2]);
        assert!(runs[0].is_empty() && runs[3].is_empty());
        // Along the rows it is another mask.
        assert_ne!(column_runs(&[1, 1, 0, 0, 2, 2, 2, 1, 1], 3, 4)[1], runs[1]);
    }

    proptest! {
        #[test]
        fn masks_come_back(width in 1usize..9, height in 1usize..9, seed in prop::collection::vec(0u16..4, 64)) {
            let instance = &seed[..(width * height).min(64)];
            prop_assume!(instance.len() == width * height);
            let runs = column_runs(instance, width, 4);
            for id in 1..4u16 {
                let own = &runs[usize::from(id)];
                let inside: u32 = own.iter().skip(1).step_by(2).sum();
                prop_assert_eq!(inside as usize, instance.iter().filter(|i| **i == id).count());
                if !own.is_empty() {
                    let mask = mask_of_runs(own, width, height);
                    prop_assert!(mask.iter().zip(instance).all(|(m, i)| *m == (*i == id)));
                }
            }
        }
    }
}
