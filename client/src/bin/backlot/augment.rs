//! `backlot augment`.

use anyhow::{Context, ensure};
use backlot_client::sample_files::{LabelFormat, SampleFiles};
use backlot_client::{Connection, names};
use backlot_proto::v1;

use crate::args::{self, ActorOptions, AugmentOptions, GivenObjectName};
use crate::progress::Progress;

pub(crate) async fn run(connection: &Connection, options: &AugmentOptions) -> anyhow::Result<()> {
    ensure!(options.count > 0, "--count must be at least 1");
    let formats: Vec<_> = options
        .labels
        .iter()
        .map(|format| match format {
            args::LabelFormat::Kitti => LabelFormat::Kitti,
            args::LabelFormat::Json => LabelFormat::Json,
            args::LabelFormat::Coco => LabelFormat::Coco,
            args::LabelFormat::Nuscenes => LabelFormat::Nuscenes,
            args::LabelFormat::Waymo => LabelFormat::Waymo,
        })
        .collect();
    let request = v1::StreamSamplesRequest {
        recipe: Some(recipe(options)?),
        seed: options.seed,
        start_index: options.start,
        count: options.count,
    };
    let mut files = SampleFiles::new(&options.out, &formats);
    let samples = stream(connection, request, |sample| {
        Ok(files.write(sample).map(|_| ())?)
    })
    .await?;
    let provenance = samples.first().and_then(|s| s.provenance.clone());
    files.write_index(&provenance.context("the samples have no provenance")?)?;
    eprintln!("{} samples in {}", samples.len(), options.out.display());
    Ok(())
}

/// Receives samples with a progress bar; `write` gets each whole, the returned ones are without images.
pub(crate) async fn stream(
    connection: &Connection,
    request: v1::StreamSamplesRequest,
    mut write: impl FnMut(&v1::Sample) -> anyhow::Result<()>,
) -> anyhow::Result<Vec<v1::Sample>> {
    let failed = |status| backlot_client::Error::from_status("rendering samples", status);
    let (count, start) = (request.count, request.start_index);
    let progress = Progress::count("samples", count);
    let reply = connection.samples().stream_samples(request).await;
    let mut stream = reply.map_err(failed)?.into_inner();
    let mut samples = Vec::new();
    while let Some(message) = stream.message().await.map_err(failed)? {
        let mut sample = message.sample.context("the server sent an empty message")?;
        let expected = start + samples.len() as u64;
        ensure!(
            sample.index == expected,
            "the server sent sample {} instead of {expected}",
            sample.index
        );
        write(&sample)?;
        for frame in &mut sample.frames {
            frame.image_png = Default::default();
            frame.depth_png = Default::default();
            frame.instance_png = Default::default();
            frame.ignore_png = Default::default();
        }
        samples.push(sample);
        progress.advance();
    }
    let received = samples.len() as u64;
    ensure!(
        received == count,
        "the server sent {received} of {count} samples"
    );
    progress.finish(&format!("{count} received"));
    Ok(samples)
}

/// Three numbers separated by commas.
pub(crate) fn sun_direction(text: &str) -> anyhow::Result<v1::Vector3> {
    let numbers: Result<Vec<f64>, _> = text.split(',').map(|part| part.trim().parse()).collect();
    match numbers.as_deref() {
        Ok([x, y, z]) => Ok(v1::Vector3 {
            x: *x,
            y: *y,
            z: *z,
        }),
        _ => anyhow::bail!("--sun {text} is not X,Y,Z"),
    }
}

fn recipe(options: &AugmentOptions) -> anyhow::Result<v1::Recipe> {
    let background = names::asset(&options.background)?;
    Ok(v1::Recipe {
        insert_shadows: Some(!options.no_shadows),
        keep_light: options.keep_light,
        sun_direction_world: options.sun.as_deref().map(sun_direction).transpose()?,
        keep_tones: options.keep_tones,
        longer_side_px: options.longer_side,
        omit_depth: options.no_depth,
        omit_instance: options.no_instance,
        frame_indices: options.frame_indices.clone(),
        edits: edits(&options.actors),
        given_objects: given_objects(&options.actors)?,
        clip: Some(v1::Clip {
            frame_count: options.clip.clip_frames,
            stride: options.clip.clip_stride,
            min_speed_mps: options.clip.speed[0],
            max_speed_mps: options.clip.speed[1],
        }),
        ..options.recipe.recipe(background)?
    })
}

fn edits(options: &ActorOptions) -> Vec<v1::ActorEdit> {
    use v1::actor_edit::Edit;
    let edit = |track_id: &String, edit| v1::ActorEdit {
        track_id: track_id.clone(),
        edit: Some(edit),
    };
    let removed = options.remove.iter();
    let removed = removed.map(|track| edit(track, Edit::Remove(v1::RemoveActor {})));
    let shifted = options.shift.iter().map(|shift| {
        let wire = v1::ShiftActor {
            x_m: shift.forward_m,
            y_m: shift.left_m,
            heading_rad: shift.turn_deg.to_radians(),
        };
        edit(&shift.track, Edit::Shift(wire))
    });
    let following = options.path.iter().filter_map(|path| match &path.object {
        GivenObjectName::Track(track) => {
            Some(edit(track, Edit::Follow(trajectory(&path.waypoints))))
        }
        GivenObjectName::Asset(_) => None,
    });
    removed.chain(shifted).chain(following).collect()
}

fn given_objects(options: &ActorOptions) -> anyhow::Result<Vec<v1::GivenObject>> {
    let given = options.path.iter().filter_map(|path| match &path.object {
        GivenObjectName::Asset(name) => Some((name, &path.waypoints)),
        GivenObjectName::Track(_) => None,
    });
    given
        .map(|(name, waypoints)| {
            Ok(v1::GivenObject {
                asset: names::asset(name)?,
                trajectory: Some(trajectory(waypoints)),
            })
        })
        .collect()
}

fn trajectory(waypoints: &[[f64; 4]]) -> v1::Trajectory {
    let waypoints = waypoints
        .iter()
        .map(|[time_s, x, y, degrees]| v1::Waypoint {
            time_s: *time_s,
            position_m: Some(v1::Vector3 {
                x: *x,
                y: *y,
                z: 0.0,
            }),
            heading_rad: degrees.to_radians(),
        });
    v1::Trajectory {
        waypoints: waypoints.collect(),
    }
}
