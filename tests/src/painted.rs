//! A log whose road users are painted in colours of their own, and small networks that find those colours: segmentation whose right
//! answer is known.

use std::io::Cursor;

use backlot_client::read_log::ReadLog;
use image::{ImageFormat, Rgb, RgbImage};

use crate::damaged_masks::read_mask;
use crate::onnx::{Network, Setting};

/// How fast a colour's value falls from 1 with the squared distance from it: to 0 before the next colour.
const FALL: f32 = 9.0;
/// Score of a colour that is there.
const SCORE: f32 = 0.9;
/// Coefficients of a YOLO mask.
const COEFFICIENTS: usize = 32;
/// Classes of the networks; colours take them in turn. Class 1 is no road user.
pub const CLASSES: usize = 3;

/// One colour a track, red, green and blue from 0 to 1. Each has more red than blue, so that none is found in the wrong channel order,
/// and all are far from grey.
pub fn palette() -> Vec<[f32; 3]> {
    let third = 1.0 / 3.0;
    let ends = [
        (1.0, 0.0),
        (1.0, third),
        (1.0, 2.0 * third),
        (2.0 * third, 0.0),
        (third, 0.0),
    ];
    let greens = [0.0, third, 2.0 * third, 1.0];
    let colours = greens.iter().flat_map(|&g| ends.map(|(r, b)| [r, g, b]));
    colours.collect()
}

/// Paints every road user of the log in its track's colour, the rest grey.
///
/// # Panics
/// If the log's images and masks are not those of the generator.
pub fn paint(log: &mut ReadLog) {
    let colours: Vec<Rgb<u8>> = palette()
        .iter()
        .map(|colour| Rgb(colour.map(|value| (value * 255.0).round() as u8)))
        .collect();
    for index in 0..log.drive_log.frames.len() {
        let frame = &log.drive_log.frames[index];
        let mask = read_mask(
            log,
            frame.instance_mask.as_ref().expect("frames have masks"),
        );
        let image = frame.image.as_ref().expect("frames have images");
        let bytes = log.blobs[&image.digest].read().expect("the image is there");
        let recorded = image::load_from_memory(&bytes)
            .expect("it decodes")
            .into_luma8();
        let painted = RgbImage::from_fn(mask.width(), mask.height(), |x, y| {
            let track = usize::from(mask.get_pixel(x, y).0[0]).checked_sub(1);
            let colour = track.and_then(|track| colours.get(track));
            let grey = 102 + recorded.get_pixel(x, y).0[0] / 5;
            colour.copied().unwrap_or(Rgb([grey; 3]))
        });
        let mut bytes = Cursor::new(Vec::new());
        painted
            .write_to(&mut bytes, ImageFormat::Png)
            .expect("an image encodes");
        let blob = log.add_bytes(bytes.into_inner());
        log.drive_log.frames[index].image = Some(blob);
    }
}

/// Takes the masks out of the log.
pub fn forget_masks(log: &mut ReadLog) {
    for frame in &mut log.drive_log.frames {
        frame.instance_mask = None;
    }
}

/// The palette's values of every pixel of the input: [1, colours, height, width] from 0 to 1.
fn colour_values(network: &mut Network) -> String {
    let colours = palette();
    let count = colours.len() as i64;
    let square = network.apply("Mul", &["images", "images"], "squares", &[]);
    let both = network.apply(
        "Concat",
        &["images", &square],
        "both",
        &[("axis", Setting::Int(1))],
    );
    // 1 - FALL |p - c|^2, written out as a sum over p and its squares.
    let weights = colours.iter().flat_map(|c| {
        let linear = c.map(|value| 2.0 * FALL * value);
        linear.into_iter().chain([-FALL; 3])
    });
    let rest = colours
        .iter()
        .map(|c| 1.0 - FALL * c.iter().map(|v| v * v).sum::<f32>());
    let weights = network.constant("near_weights", &[count, 6, 1, 1], weights.collect());
    let rest = network.constant("near_rest", &[count], rest.collect());
    let near = network.apply("Conv", &[&both, &weights, &rest], "near", &[]);
    network.apply("Relu", &[&near], "values", &[])
}

/// Edges of what each colour covers, all [1, colours, 1]: in cells of `values`, which is [1, colours, height, width].
struct Extent {
    left: String,
    right: String,
    top: String,
    bottom: String,
    /// 1 if it is there at all.
    present: String,
}

impl Extent {
    fn of(network: &mut Network, values: &str, (width, height): (i64, i64)) -> Self {
        let scale = network.constant("sharpness", &[1], vec![1000.0]);
        let half = network.constant("half", &[1], vec![500.0]);
        let zero = network.constant("zero", &[], vec![0.0]);
        let one = network.constant("one", &[], vec![1.0]);
        let scaled = network.apply("Mul", &[values, &scale], "scaled", &[]);
        let centred = network.apply("Sub", &[&scaled, &half], "centred", &[]);
        let covered = network.apply("Clip", &[&centred, &zero, &one], "covered", &[]);
        let largest = |network: &mut Network, of: &str, axis: i64, kept: i64, name: &str| {
            let settings = [
                ("axes", Setting::Ints(&[axis])),
                ("keepdims", Setting::Int(kept)),
            ];
            network.apply("ReduceMax", &[of], name, &settings)
        };
        let columns = largest(network, &covered, 2, 0, "columns");
        let rows = largest(network, &covered, 3, 0, "rows");
        let mut edges = |line: &str, length: i64| {
            let forth = (1..=length).map(|i| i as f32).collect();
            let back = (1..=length).rev().map(|i| i as f32).collect();
            let forth = network.constant(&format!("{line}_forth"), &[1, 1, length], forth);
            let back = network.constant(&format!("{line}_back"), &[1, 1, length], back);
            let forth = network.apply("Mul", &[line, &forth], &format!("{line}_after"), &[]);
            let back = network.apply("Mul", &[line, &back], &format!("{line}_before"), &[]);
            let end = largest(network, &forth, 2, 1, &format!("{line}_end"));
            let room = largest(network, &back, 2, 1, &format!("{line}_room"));
            let whole = network.constant(&format!("{line}_length"), &[1], vec![length as f32]);
            let start = network.apply("Sub", &[&whole, &room], &format!("{line}_start"), &[]);
            (start, end)
        };
        let (left, right) = edges(&columns, width);
        let (top, bottom) = edges(&rows, height);
        let present = largest(network, &columns, 2, 1, "present");
        Self {
            left,
            right,
            top,
            bottom,
            present,
        }
    }
}

/// A network of the layout `yolo-seg` for an input of `size`, (width, height), multiples of 4.
pub fn yolo_seg(size: (u32, u32)) -> Vec<u8> {
    const CELL: i64 = 4;
    let (width, height) = (i64::from(size.0), i64::from(size.1));
    let (across, down) = (width / CELL, height / CELL);
    let count = palette().len();
    let mut network = Network::new("images", &[1, 3, height, width]);
    let values = colour_values(&mut network);
    let cells = network.apply(
        "AveragePool",
        &[&values],
        "cells",
        &[
            ("kernel_shape", Setting::Ints(&[CELL, CELL])),
            ("strides", Setting::Ints(&[CELL, CELL])),
        ],
    );
    prototypes(&mut network, &cells, count);
    let extent = Extent::of(&mut network, &cells, (across, down));
    let two = network.constant("two", &[1], vec![2.0]);
    let four = network.constant("four", &[1], vec![4.0]);
    let mut line = |start: &str, end: &str, name: &str| {
        let sum = network.apply("Add", &[start, end], &format!("{name}_sum"), &[]);
        let centre = network.apply("Mul", &[&sum, &two], &format!("{name}_centre"), &[]);
        let cells = network.apply("Sub", &[end, start], &format!("{name}_cells"), &[]);
        let size = network.apply("Mul", &[&cells, &four], &format!("{name}_inner"), &[]);
        // Half a cell more on both sides, where masks end.
        let size = network.apply("Add", &[&size, &four], &format!("{name}_size"), &[]);
        (centre, size)
    };
    let (x, box_width) = line(&extent.left, &extent.right, "x");
    let (y, box_height) = line(&extent.top, &extent.bottom, "y");
    let parts = [&*x, &*y, &*box_width, &*box_height];
    let boxes = network.apply("Concat", &parts, "boxes", &[("axis", Setting::Int(2))]);
    let turn = [("perm", Setting::Ints(&[0, 2, 1]))];
    let boxes = network.apply("Transpose", &[&boxes], "box_rows", &turn);
    let present = network.apply("Transpose", &[&extent.present], "present_row", &turn);
    let class_scores = (0..CLASSES).flat_map(|class| {
        (0..count).map(move |colour| {
            if colour % CLASSES == class {
                SCORE
            } else {
                0.0
            }
        })
    });
    let shape = [1, CLASSES as i64, count as i64];
    let classes = network.constant("class_scores", &shape, class_scores.collect());
    let scores = network.apply("Mul", &[&present, &classes], "scores", &[]);
    let coefficients = coefficients(&mut network, count);
    let rows = [&*boxes, &*scores, &*coefficients];
    network.apply("Concat", &rows, "output0", &[("axis", Setting::Int(1))]);
    let rows = 4 + CLASSES + COEFFICIENTS;
    network.output("output0", &[1, rows as i64, count as i64]);
    network.output("output1", &[1, COEFFICIENTS as i64, down, across]);
    network.encode()
}

/// The colours' cells, then nothing, and last a one.
fn prototypes(network: &mut Network, cells: &str, count: usize) {
    let weights = (0..COEFFICIENTS * count).map(|i| f32::from(u8::from(i / count == i % count)));
    let rest = (0..COEFFICIENTS).map(|i| f32::from(u8::from(i == COEFFICIENTS - 1)));
    let shape = [COEFFICIENTS as i64, count as i64, 1, 1];
    let weights = network.constant("prototype_weights", &shape, weights.collect());
    let rest = network.constant("prototype_rest", &[COEFFICIENTS as i64], rest.collect());
    network.apply("Conv", &[cells, &weights, &rest], "output1", &[]);
}

/// [1, coefficients, colours]: a colour's mask is where its cells exceed one half.
fn coefficients(network: &mut Network, count: usize) -> String {
    let coefficient = |i: usize| match (i / count, i % count) {
        (row, colour) if row == colour => 20.0,
        (row, _) if row == COEFFICIENTS - 1 => -10.0,
        _ => 0.0,
    };
    let all = (0..COEFFICIENTS * count).map(coefficient).collect();
    network.constant("coefficients", &[1, COEFFICIENTS as i64, count as i64], all)
}

/// A network of the layout `mask-rcnn` with masks of the whole input, for an input of `size`, (width, height).
pub fn mask_rcnn(size: (u32, u32)) -> Vec<u8> {
    let (width, height) = (i64::from(size.0), i64::from(size.1));
    let count = palette().len() as i64;
    let mut network = Network::new("images", &[1, 3, height, width]);
    let values = colour_values(&mut network);
    let extent = Extent::of(&mut network, &values, (width, height));
    let corners = [&*extent.left, &*extent.top, &*extent.right, &*extent.bottom];
    let boxes = network.apply("Concat", &corners, "corners", &[("axis", Setting::Int(2))]);
    let list = network.integers("list_of_boxes", &[count, 4]);
    network.apply("Reshape", &[&boxes, &list], "boxes", &[]);
    let classes: Vec<i64> = (0..count).map(|colour| colour % CLASSES as i64).collect();
    let classes = network.integers("classes", &classes);
    network.apply("Identity", &[&classes], "labels", &[]);
    let score = network.constant("score", &[1], vec![SCORE]);
    let scored = network.apply("Mul", &[&extent.present, &score], "scored", &[]);
    let list = network.integers("list", &[count]);
    network.apply("Reshape", &[&scored, &list], "scores", &[]);
    let turn = [("perm", Setting::Ints(&[1, 0, 2, 3]))];
    network.apply("Transpose", &[&values], "masks", &turn);
    network.output("boxes", &[count, 4]);
    network.integer_output("labels", &[count]);
    network.output("scores", &[count]);
    network.output("masks", &[count, 1, height, width]);
    network.encode()
}
