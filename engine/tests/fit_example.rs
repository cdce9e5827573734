//! The `fit` example as its users call it: on a small scene that the test traces itself, and on broken ones.

use std::f64::consts::TAU;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use glam::{DMat3, DVec3};
use serde_json::{Value, json};

const SIDE: u32 = 32;
const ANGLE_X: f64 = 0.7;

/// A grey-striped ball of radius 0.8 at the origin: RGBA along a ray, transparent where it is missed.
fn trace(eye: DVec3, direction: DVec3) -> [u8; 4] {
    let b = eye.dot(direction);
    let root = b * b - (eye.length_squared() - 0.64);
    if root < 0.0 {
        return [0; 4];
    }
    let p = eye + direction * (-b - root.sqrt());
    let stripe = if (p.z * 4.0).floor() as i64 % 2 == 0 {
        200
    } else {
        60
    };
    [stripe, (100.0 + 120.0 * p.x) as u8, 80, 255]
}

fn write_split(folder: &Path, name: &str, views: u32, offset: f64) {
    fs::create_dir_all(folder.join(name)).expect("a folder");
    let mut frames = Vec::new();
    for view in 0..views {
        let turn = TAU * (f64::from(view) + offset) / f64::from(views);
        let eye =
            DVec3::new(turn.cos(), turn.sin(), 0.4 + 0.3 * (2.0 * turn).sin()).normalize() * 4.0;
        let back = eye.normalize();
        let right = DVec3::Z.cross(back).normalize();
        let pose = DMat3::from_cols(right, back.cross(right), back);
        let focal = 0.5 * f64::from(SIDE) / (0.5 * ANGLE_X).tan();
        let image = image::RgbaImage::from_fn(SIDE, SIDE, |x, y| {
            let at = |p: u32| (f64::from(p) + 0.5 - 0.5 * f64::from(SIDE)) / focal;
            let direction = pose * DVec3::new(at(x), -at(y), -1.0).normalize();
            image::Rgba(trace(eye, direction))
        });
        image
            .save(folder.join(format!("{name}/r_{view}.png")))
            .expect("an image file");
        let row = |r: usize| [pose.col(0)[r], pose.col(1)[r], pose.col(2)[r], eye[r]];
        frames.push(json!({
            "file_path": format!("./{name}/r_{view}"),
            "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
        }));
    }
    let transforms = json!({ "camera_angle_x": ANGLE_X, "frames": frames });
    fs::write(
        folder.join(format!("transforms_{name}.json")),
        transforms.to_string(),
    )
    .expect("a file");
}

/// A fresh scene folder under the build's temporary folder.
fn scene(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("fit-{name}"));
    let _ = fs::remove_dir_all(&folder);
    write_split(&folder, "train", 16, 0.0);
    write_split(&folder, "test", 3, 0.4);
    folder
}

fn fit(scene: &Path, arguments: &[&str]) -> Output {
    // Cargo builds a package's examples before its tests run: .../deps/fit_example-HASH and .../examples/fit.
    let test = std::env::current_exe().expect("a path");
    let built = test
        .parent()
        .and_then(Path::parent)
        .expect("a build folder")
        .join("examples/fit");
    assert!(
        built.is_file(),
        "{} is missing: `cargo test` builds it, but `cargo test --test` does not; run `cargo build --example fit` first",
        built.display()
    );
    Command::new(built)
        .arg(scene)
        .args(arguments)
        .output()
        .expect("the example starts")
}

#[test]
fn fits_a_small_scene_and_reports_what_it_measured() {
    let scene = scene("whole");
    let (json, out) = (scene.join("out.json"), scene.join("out"));
    let paths = [json.to_str().unwrap(), out.to_str().unwrap()];
    let run = fit(
        &scene,
        &[
            "--iters",
            "300",
            "--threads",
            "2",
            "--json",
            paths[0],
            "--out",
            paths[1],
        ],
    );
    assert!(
        run.status.success(),
        "{}",
        String::from_utf8_lossy(&run.stderr)
    );
    let report: Value = serde_json::from_str(&fs::read_to_string(&json).unwrap()).unwrap();
    for field in [
        "train_s",
        "rays",
        "rays_per_s",
        "ssim_test",
        "render_ms_per_frame",
        "peak_rss_mib",
    ] {
        assert!(
            report[field].as_f64().is_some_and(|x| x > 0.0),
            "{field}: {report}"
        );
    }
    assert_eq!(report["iters"], 300);
    assert!(
        report["progress"]
            .as_array()
            .is_some_and(|list| !list.is_empty())
    );
    // The figure is that of the files: each against its view over white.
    let mut psnr = 0.0;
    for view in 0..3 {
        let ours = image::open(out.join(format!("r_{view}.png")))
            .unwrap()
            .to_rgb8();
        let truth = image::open(scene.join(format!("test/r_{view}.png")))
            .unwrap()
            .to_rgba8();
        let pairs = ours.pixels().zip(truth.pixels());
        let squares = pairs.flat_map(|(a, b)| {
            let over = |c: usize| if b[3] == 0 { 255.0 } else { f64::from(b[c]) };
            [0, 1, 2].map(|c| ((f64::from(a[c]) - over(c)) / 255.0).powi(2))
        });
        psnr += -10.0 * (squares.sum::<f64>() / f64::from(3 * SIDE * SIDE)).log10() / 3.0;
    }
    let reported = report["psnr_test"].as_f64().unwrap();
    assert!((reported - psnr).abs() < 1e-6, "{reported} {psnr}");
    // White everywhere, a field that died, has 9 dB here.
    assert!(psnr > 22.0, "{psnr}");
}

#[test]
fn a_broken_scene_is_refused_by_file_and_field() {
    let refused = |scene: &Path, words: &[&str]| {
        let run = fit(scene, &["--iters", "1"]);
        let message = String::from_utf8_lossy(&run.stderr).into_owned();
        assert_eq!(run.status.code(), Some(2), "{message}");
        for word in words {
            assert!(message.contains(word), "{word} is not in: {message}");
        }
    };
    let edit = |scene: &Path, change: &dyn Fn(&mut Value)| {
        let path = scene.join("transforms_train.json");
        let mut transforms: Value =
            serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
        change(&mut transforms);
        fs::write(&path, transforms.to_string()).unwrap();
    };
    let missing = scene("missing");
    fs::remove_file(missing.join("transforms_test.json")).unwrap();
    refused(&missing, &["transforms_test.json"]);

    let image = scene("image");
    fs::remove_file(image.join("train/r_3.png")).unwrap();
    refused(
        &image,
        &["transforms_train.json", "frames[3].file_path", "r_3"],
    );
    fs::write(image.join("train/r_3.png"), b"no picture").unwrap();
    refused(&image, &["r_3.png"]);

    let pose = scene("pose");
    edit(&pose, &|t| {
        t["frames"][2]["transform_matrix"][0][0] = json!(7.0)
    });
    refused(&pose, &["frames[2].transform_matrix", "rotation"]);

    let angle = scene("angle");
    edit(&angle, &|t| t["camera_angle_x"] = json!(-0.5));
    refused(&angle, &["transforms_train.json", "camera_angle_x"]);

    refused(Path::new("no-such-scene"), &["no-such-scene"]);
}
