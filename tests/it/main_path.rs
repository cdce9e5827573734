//! The main path: a log goes in, assets are trained, labelled samples come out; twice the same.

use std::path::Path;

use backlot_client::{Connection, listing, upload, watch};
use backlot_e2e::programs::finish;
use backlot_e2e::state::files;
use backlot_e2e::{Server, backlot, logs};
use backlot_proto::v1;

const LOG: &str = "driveLogs/street";

#[tokio::test]
async fn a_log_becomes_assets_and_assets_become_labelled_samples() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let server = Server::start(&data).await;
    let connection = server.connect().await;
    let uploaded = upload::upload_log(&connection, &logs::small(7), LOG, &|_| {})
        .await
        .unwrap();
    assert_eq!(uploaded.blobs_sent, uploaded.blobs_total);
    let again = upload::upload_log(&connection, &logs::small(7), LOG, &|_| {})
        .await
        .unwrap();
    assert_eq!(again.blobs_sent, 0, "a second upload sends nothing");

    let background = train(&connection, v1::JobKind::Background).await;
    let objects = train(&connection, v1::JobKind::Objects).await;
    let background = check_background(&connection, &background).await;
    check_objects(&connection, &objects).await;

    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    augment(&server.url(), &background, &first, 7);
    // The same from a restarted server: a sample depends on nothing that a process keeps.
    assert!(server.stop().success());
    let server = Server::start(&data).await;
    augment(&server.url(), &background, &second, 7);
    let made = files(&first);
    assert!(
        made.len() >= 2 * SAMPLES,
        "{} files of {SAMPLES} samples",
        made.len()
    );
    assert_eq!(made, files(&second), "the same seed gives other files");
    let other = folder.path().join("other");
    augment(&server.url(), &background, &other, 8);
    assert_ne!(made, files(&other), "another seed gives the same files");
    check_samples(&server.connect().await, &background).await;
}

const SAMPLES: usize = 3;

async fn train(connection: &Connection, kind: v1::JobKind) -> v1::Job {
    let request = v1::CreateJobRequest {
        kind: kind.into(),
        drive_log: LOG.to_owned(),
        budget: v1::Budget::Quick.into(),
        seed: 1,
        ..Default::default()
    };
    let job = watch::create_job(connection, request).await.unwrap();
    let mut fractions = Vec::new();
    let job = watch::watch_job(connection, &job.name, |job| {
        fractions.push(
            job.progress
                .as_ref()
                .map_or(0.0, |progress| progress.fraction),
        );
    });
    let job = job.await.unwrap();
    assert_eq!(job.state(), v1::JobState::Succeeded, "{job:?}");
    assert!(fractions.len() > 2, "a watch shows progress: {fractions:?}");
    assert!(
        fractions.is_sorted(),
        "progress never goes back: {fractions:?}"
    );
    job
}

async fn check_background(connection: &Connection, job: &v1::Job) -> String {
    assert_eq!(job.assets.len(), 1, "{job:?}");
    let assets = listing::assets(connection, v1::AssetKind::Background, LOG)
        .await
        .unwrap();
    let asset = assets
        .iter()
        .find(|asset| asset.name == job.assets[0])
        .expect("the job's asset is in the library");
    assert!(asset.synthetic, "an asset of generated images says so");
    let quality = asset.quality.as_ref().expect("assets carry their quality");
    assert!(
        quality.held_out_views > 0 && quality.psnr_held_out > 12.0,
        "{quality:?}"
    );
    asset.name.clone()
}

async fn check_objects(connection: &Connection, job: &v1::Job) {
    let log = logs::small(7).drive_log;
    assert_eq!(
        job.tracks.len(),
        log.tracks.len(),
        "every track is decided on"
    );
    for track in &job.tracks {
        assert_eq!(
            track.kept,
            track.reason.is_empty(),
            "a track is kept or says why not: {track:?}"
        );
    }
    let assets = listing::assets(connection, v1::AssetKind::Object, LOG)
        .await
        .unwrap();
    assert_eq!(assets.len(), job.assets.len());
    let library = assets
        .iter()
        .filter(|asset| asset.usage() == v1::AssetUsage::Library);
    assert!(
        library.count() > 0,
        "no object may be placed: {:?}",
        job.tracks
    );
    for asset in assets {
        assert!(
            asset.size_m.is_some() && !asset.source_track_id.is_empty(),
            "{asset:?}"
        );
    }
}

/// Runs the command line as the README shows it.
fn augment(server_url: &str, background: &str, out: &Path, seed: u64) {
    let (seed, count) = (seed.to_string(), SAMPLES.to_string());
    let arguments = [
        ["augment", "--background"],
        [background, "--count"],
        [&count, "--seed"],
        [&seed, "--preset"],
        ["paper", "--out"],
        [
            out.to_str().expect("temporary paths are UTF-8"),
            "--label-format",
        ],
    ];
    let mut arguments = arguments.concat();
    arguments.push("kitti");
    finish(&mut backlot(server_url, &arguments)).succeeded();
}

/// What a training job relies on: sizes agree, every visible instance has a box, boxes lie in the image.
async fn check_samples(connection: &Connection, background: &str) {
    let recipe = v1::Recipe {
        background: background.to_owned(),
        ..Default::default()
    };
    let request = v1::StreamSamplesRequest {
        recipe: Some(recipe),
        seed: 3,
        start_index: 0,
        count: SAMPLES as u64,
    };
    let mut stream = connection
        .samples()
        .stream_samples(request)
        .await
        .unwrap()
        .into_inner();
    let mut samples = Vec::new();
    while let Some(message) = stream.message().await.unwrap() {
        samples.push(message.sample.expect("a message holds a sample"));
    }
    let indices: Vec<_> = samples.iter().map(|sample| sample.index).collect();
    assert_eq!(indices, (0..SAMPLES as u64).collect::<Vec<_>>());
    for sample in &samples {
        check_sample(sample);
    }
    let resumed = v1::StreamSamplesRequest {
        recipe: Some(v1::Recipe {
            background: background.to_owned(),
            ..Default::default()
        }),
        seed: 3,
        start_index: 2,
        count: 1,
    };
    let mut stream = connection
        .samples()
        .stream_samples(resumed)
        .await
        .unwrap()
        .into_inner();
    let third = stream
        .message()
        .await
        .unwrap()
        .and_then(|message| message.sample)
        .expect("one sample comes");
    assert_eq!(
        third, samples[2],
        "a stream taken up at an index goes on as before"
    );
}

fn check_sample(sample: &v1::Sample) {
    let provenance = sample
        .provenance
        .as_ref()
        .expect("samples carry their provenance");
    assert!(provenance.synthetic, "samples of generated images say so");
    let known: Vec<_> = sample.boxes_3d.iter().map(|b| b.instance_id).collect();
    assert!(!sample.frames.is_empty());
    for frame in &sample.frames {
        let image = image::load_from_memory(&frame.image_png)
            .unwrap()
            .into_rgb8();
        let instance = image::load_from_memory(&frame.instance_png)
            .unwrap()
            .into_luma16();
        let depth = image::load_from_memory(&frame.depth_png)
            .unwrap()
            .into_luma16();
        assert_eq!(image.dimensions(), instance.dimensions());
        assert_eq!(image.dimensions(), depth.dimensions());
        let (width, height) = (f64::from(image.width()), f64::from(image.height()));
        for pixel in instance.pixels().filter(|pixel| pixel.0[0] != 0) {
            assert!(
                known.contains(&u32::from(pixel.0[0])),
                "instance {} has no box",
                pixel.0[0]
            );
        }
        for seen in &frame.boxes_2d {
            let pixels = instance
                .pixels()
                .filter(|pixel| u32::from(pixel.0[0]) == seen.instance_id)
                .count();
            if let Some(visible) = &seen.visible {
                assert!(
                    visible.x_min >= 0.0
                        && visible.y_min >= 0.0
                        && visible.x_max <= width
                        && visible.y_max <= height
                );
            }
            let origin = sample
                .boxes_3d
                .iter()
                .find(|b| b.instance_id == seen.instance_id)
                .expect("2D boxes have 3D boxes");
            // Static originals are part of the background: they have a box and no pixels of their own.
            if origin.origin() != v1::BoxOrigin::Static {
                assert_eq!(
                    seen.visible_pixels as usize, pixels,
                    "instance {}",
                    seen.instance_id
                );
                assert_eq!(
                    seen.visible.is_some(),
                    pixels > 0,
                    "instance {}",
                    seen.instance_id
                );
            }
        }
    }
}
