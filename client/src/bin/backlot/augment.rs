//! `backlot augment`.

use anyhow::{Context, ensure};
use backlot_client::sample_files::{LabelFormat, SampleFiles};
use backlot_client::{Connection, names};
use backlot_proto::v1;

use crate::args::{self, AugmentOptions, Preset};
use crate::progress::Progress;

pub(crate) async fn run(connection: &Connection, options: &AugmentOptions) -> anyhow::Result<()> {
    ensure!(options.count > 0, "--count must be at least 1");
    let formats: Vec<_> = options
        .label_format
        .iter()
        .map(|format| match format {
            args::LabelFormat::Kitti => LabelFormat::Kitti,
            args::LabelFormat::Json => LabelFormat::Json,
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

fn recipe(options: &AugmentOptions) -> anyhow::Result<v1::Recipe> {
    ensure!(
        (0.0..=1.0).contains(&options.replace),
        "--replace must lie between 0 and 1"
    );
    let preset = match options.preset {
        Preset::Default => v1::PlacementPreset::Default,
        Preset::Paper => v1::PlacementPreset::Paper,
        Preset::PaperNoRt => v1::PlacementPreset::PaperNoRt,
    };
    let objects = options.objects.iter().map(|name| names::asset(name));
    Ok(v1::Recipe {
        library_snapshot: options.snapshot.clone().unwrap_or_default(),
        background: names::asset(&options.background)?,
        preset: preset.into(),
        min_objects: options.min_objects,
        max_objects: options.max_objects,
        objects: objects.collect::<Result<_, _>>()?,
        replace_probability: options.replace,
        drop_originals: options.drop_originals,
        insert_shadows: !options.no_shadows,
        keep_tones: options.keep_tones,
        longer_side_px: options.longer_side,
        camera_id: options.camera.clone(),
        omit_depth: options.no_depth,
        omit_instance: options.no_instance,
        ..Default::default()
    })
}
