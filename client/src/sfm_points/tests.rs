//! Points in every form come back as they were written, and what cannot be used is named.

use super::*;
use crate::generator::{DepthRecording, StreetConfig, StreetWorld};

fn street(depth: DepthRecording) -> ReadLog {
    let config = StreetConfig {
        frames: 3,
        width: 64,
        height: 48,
        travel_m: 4.0,
        supersample: 1,
        depth,
        ..StreetConfig::default()
    };
    StreetWorld::new(&config).unwrap().read_log().unwrap()
}

/// Points and observations of the log's own, exact.
fn known(log: &ReadLog) -> (Vec<DVec3>, Vec<(u32, u32)>) {
    let sfm = log.drive_log.sfm_points.as_ref().unwrap();
    let points = log.read_blob(sfm.points.as_ref().unwrap()).unwrap();
    let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().unwrap());
    let points = points
        .chunks_exact(24)
        .map(|p| DVec3::new(number(&p[..8]), number(&p[8..16]), number(&p[16..])));
    let observations = sfm.observations.as_ref().map(|o| log.read_blob(o).unwrap());
    let whole = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().unwrap());
    let observations = observations.unwrap_or_default();
    let pairs = observations.chunks_exact(8);
    let pairs = pairs.map(|pair| (whole(&pair[..4]), whole(&pair[4..])));
    (points.collect(), pairs.collect())
}

/// The model of the points as COLMAP writes it, in units of `unit_m`.
fn write_colmap(folder: &Path, log: &ReadLog, unit_m: f64) -> PathBuf {
    let (points, seen) = known(log);
    let mut text = "# 3D point list with one line of data per point:\n".to_owned();
    for (index, point) in points.iter().enumerate() {
        let p = *point / unit_m;
        // Ids have gaps; image ids begin at 5.
        let id = 3 * index + 7;
        text += &format!("{id} {} {} {} 120 30 9 0.71", p.x, p.y, p.z);
        for (_, frame) in seen.iter().filter(|(point, _)| *point == index as u32) {
            text += &format!(" {} 17", frame + 5);
        }
        text += "\n";
    }
    let file = folder.join("points3D.txt");
    std::fs::write(&file, text).unwrap();
    file
}

fn write_images(folder: &Path, log: &ReadLog, camera: &str) {
    let mut text = "# Image list with two lines of data per image:\n".to_owned();
    for (index, frame) in log.drive_log.frames.iter().enumerate() {
        let name = format!("{camera}{:06}.png", frame.frame_index);
        text += &format!("{} 1 0 0 0 0 0 0 1 {name}\n", index + 5);
        // Points of an image may be none.
        text += if index == 1 {
            "\n"
        } else {
            "3.5 7.25 7 9.5 1.0 -1\n"
        };
    }
    std::fs::write(folder.join("images.txt"), text).unwrap();
}

fn add(log: &mut ReadLog, file: &Path, unit_m: f64) -> Result<()> {
    let inputs = SfmPointInputs {
        file: file.to_owned(),
        unit_m,
    };
    add_sfm_points(log, &inputs)
}

fn same(a: &[DVec3], b: &[DVec3], most_m: f64) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.distance(*b) < most_m)
}

#[test]
fn a_colmap_model_comes_back_with_what_each_image_saw() {
    let original = street(DepthRecording::Points);
    let (points, mut seen) = known(&original);
    seen.sort_unstable();
    assert!(points.len() > 50 && seen.len() > points.len());
    for camera in ["", "front/", "images/front/"] {
        let folder = tempfile::tempdir().unwrap();
        let file = write_colmap(folder.path(), &original, 0.25);
        let mut log = street(DepthRecording::None);
        add(&mut log, &file, 0.25).unwrap();
        assert!(
            known(&log).1.is_empty(),
            "nothing is known without images.txt"
        );
        write_images(folder.path(), &original, camera);
        add(&mut log, &file, 0.25).unwrap();
        let (read, read_seen) = known(&log);
        assert!(same(&read, &points, 1e-9));
        assert_eq!(read_seen, seen);
        // In another unit they are other points.
        add(&mut log, &file, 0.26).unwrap();
        assert!(!same(&known(&log).0, &points, 1e-2));
    }
}

#[test]
fn an_image_that_is_no_frame_is_noted() {
    let original = street(DepthRecording::Points);
    let folder = tempfile::tempdir().unwrap();
    let file = write_colmap(folder.path(), &original, 1.0);
    write_images(folder.path(), &original, "front/");
    let images = folder.path().join("images.txt");
    let text = std::fs::read_to_string(&images).unwrap();
    std::fs::write(&images, text.replace("front/000001", "front/000077")).unwrap();
    let mut log = street(DepthRecording::None);
    add(&mut log, &file, 1.0).unwrap();
    let notes = log.drive_log.notes.join("\n");
    assert!(
        notes.contains("1 images of images.txt are no frames"),
        "{notes}"
    );
    assert!(known(&log).1.iter().all(|(_, frame)| *frame != 1));
}

fn ply_header(form: &str, count: usize, kind: &str) -> String {
    format!(
        "ply\nformat {form} 1.0\ncomment made here\nelement vertex {count}\nproperty uchar red\nproperty {kind} y\nproperty {kind} x\nproperty {kind} z\nelement face 1\nproperty list uchar int vertex_index\nend_header\n"
    )
}

/// The points as PLY of a form; properties are red, y, x, z.
fn ply(points: &[DVec3], form: &str, kind: &str) -> Vec<u8> {
    let mut content = ply_header(form, points.len(), kind).into_bytes();
    for p in points {
        match (form, kind) {
            ("ascii", _) => content.extend(format!("9 {} {} {}\n", p.y, p.x, p.z).bytes()),
            (_, "double") => {
                content.push(9);
                content.extend([p.y, p.x, p.z].iter().flat_map(|v| v.to_le_bytes()));
            }
            _ => {
                content.push(9);
                let numbers = [p.y, p.x, p.z];
                content.extend(numbers.iter().flat_map(|v| (*v as f32).to_le_bytes()));
            }
        }
    }
    // The face.
    content.extend(if form == "ascii" {
        &b"3 0 1 2\n"[..]
    } else {
        &[1, 0, 0, 0, 0]
    });
    content
}

#[test]
fn tables_and_ply_of_every_form_come_back() {
    let (points, _) = known(&street(DepthRecording::Points));
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str, content: Vec<u8>| {
        let path = folder.path().join(name);
        std::fs::write(&path, content).unwrap();
        path
    };
    let rows = points
        .iter()
        .map(|p| format!("{},{}, {},255\n", p.x, p.y, p.z));
    let table: String = std::iter::once("x,y,z,red\n".to_owned())
        .chain(rows)
        .collect();
    let cases = [
        (file("points.csv", table.clone().into_bytes()), 1e-9),
        (file("bare.csv", table.as_bytes()[10..].to_vec()), 1e-9),
        (file("text.ply", ply(&points, "ascii", "float")), 1e-9),
        (
            file("double.ply", ply(&points, "binary_little_endian", "double")),
            1e-9,
        ),
        (
            file("single.ply", ply(&points, "binary_little_endian", "float")),
            1e-3,
        ),
    ];
    for (path, most_m) in cases {
        let mut log = street(DepthRecording::None);
        add(&mut log, &path, 1.0).unwrap();
        assert!(same(&known(&log).0, &points, most_m), "{}", path.display());
        assert!(log.drive_log.sfm_points.unwrap().observations.is_none());
    }
}

#[test]
fn what_cannot_be_used_is_named() {
    let points = [DVec3::new(1.0, 2.0, 3.0), DVec3::new(4.0, 5.0, 6.0)];
    let binary = ply(&points, "binary_little_endian", "double");
    let cut = binary[..binary.len() - 20].to_vec();
    let mut nan = points.to_vec();
    nan[1].y = f64::NAN;
    let nan = ply(&nan, "binary_little_endian", "double");
    let many = ply_header("ascii", MOST_POINTS + 1, "float").into_bytes();
    let text = |text: &str| text.as_bytes().to_vec();
    let cases: [(&str, Vec<u8>, &str); 15] = [
        ("points3D.txt", text("1 2 3\n"), "points3D.txt:1: 3 fields"),
        ("points3D.txt", text("# none\n"), "it holds no point"),
        (
            "points3D.txt",
            text("1 2 x 3 0 0 0 0.5\n"),
            ":1: y is \"x\", not a number",
        ),
        (
            "points3D.txt",
            text("1 2 3 inf 0 0 0 0.5\n"),
            "z is inf, not finite",
        ),
        (
            "points3D.txt",
            text("1 2 3 4 0 0 0 0.5 a 2\n"),
            "\"a\" is not an image's id",
        ),
        (
            "points.csv",
            text("x,y,z\n1,2,3\n1,2\n"),
            "points.csv:3: z is missing",
        ),
        ("points.csv", vec![0xff, 0xfe], "it is no text"),
        (
            "points.csv",
            text("1e6,2e6,0\n"),
            "no point lies within 200 m of the drive",
        ),
        (
            "points.xyz",
            text("1 2 3\n"),
            "COLMAP's points3D.txt, from .ply or from .csv",
        ),
        ("points.ply", text("solid\n"), "it has no PLY header"),
        ("points.ply", cut, "it ends after 1 of the 2 vertices"),
        ("points.ply", nan, "vertex 1 is"),
        ("points.ply", many, "more than 2000000 points"),
        (
            "points.ply",
            ply(&points, "binary_big_endian", "double"),
            "points.ply:2: format binary_big_endian",
        ),
        (
            "points.ply",
            text("ply\nformat ascii 1.0\nelement vertex 1\nproperty int x\nend_header\n1\n"),
            "vertices have no x of type float",
        ),
    ];
    for (name, content, named) in cases {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(name);
        std::fs::write(&file, content).unwrap();
        let mut log = street(DepthRecording::None);
        let error = add(&mut log, &file, 1.0).unwrap_err().to_string();
        assert!(error.contains(named), "{error}\nis not\n{named}");
        assert!(log.drive_log.sfm_points.is_none(), "nothing is half added");
    }
    let mut log = street(DepthRecording::None);
    let missing = add(&mut log, Path::new("no/points.ply"), 1.0).unwrap_err();
    assert!(
        missing.to_string().contains("no/points.ply: not found"),
        "{missing}"
    );
    let unit = add(&mut log, Path::new("no/points.ply"), -1.0).unwrap_err();
    assert!(
        unit.to_string().contains("not finite and positive"),
        "{unit}"
    );
}

#[test]
fn an_images_file_of_another_log_is_refused() {
    let original = street(DepthRecording::Points);
    let folder = tempfile::tempdir().unwrap();
    let file = write_colmap(folder.path(), &original, 1.0);
    write_images(folder.path(), &original, "rear/");
    let mut log = street(DepthRecording::None);
    let error = add(&mut log, &file, 1.0).unwrap_err().to_string();
    assert!(
        error.contains("images.txt: none of its images is a frame"),
        "{error}"
    );
}
