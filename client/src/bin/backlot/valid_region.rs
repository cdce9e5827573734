//! `backlot assets valid-region`.

use std::collections::BTreeMap;

use anyhow::{Context, ensure};
use backlot_client::download::download_blob;
use backlot_client::geometry::{rigid_from_wire, vector_from_wire};
use backlot_client::picture::{MapBox, region_map};
use backlot_client::{Connection, names};
use backlot_engine::Asset;
use backlot_engine::asset::AssetKind;
use backlot_proto::v1;

use crate::args::ValidRegionOptions;
use crate::assets;

/// Plans of one call; the server's limit is the same.
const PLANS_A_CALL: u64 = 1_000;

pub(crate) async fn run(
    connection: &Connection,
    options: &ValidRegionOptions,
) -> anyhow::Result<()> {
    let name = names::asset(&options.asset)?;
    let record = assets::get(connection, &name).await?;
    ensure!(
        record.kind() == v1::AssetKind::Background,
        "{name} is an object: only backgrounds have a valid region"
    );
    let payload = record.payload.clone().context("the asset has no payload")?;
    let folder = tempfile::tempdir().context("making a temporary folder")?;
    let file = folder.path().join("background.asset");
    download_blob(connection, &payload, &file).await?;
    let bytes = std::fs::read(&file).with_context(|| format!("reading {}", file.display()))?;
    let asset = Asset::decode(&bytes)?;
    ensure!(
        asset.header.kind == AssetKind::Background,
        "{name} does not hold a background"
    );
    let plans = plans(connection, options, &name).await?;
    let boxes = boxes(&plans);
    let map = region_map(&name, &asset.header, asset.field.as_ref(), &boxes)?;
    map.save(&options.out)
        .with_context(|| format!("writing {}", options.out.display()))?;
    let placed = boxes.iter().filter(|b| b.inserted).count();
    eprintln!(
        "{placed} placements of {} samples in {}",
        plans.len(),
        options.out.display()
    );
    for (reason, count) in rejections(&plans) {
        eprintln!("  rejected {count:>6}  {reason}");
    }
    Ok(())
}

async fn plans(
    connection: &Connection,
    options: &ValidRegionOptions,
    background: &str,
) -> anyhow::Result<Vec<v1::SamplePlan>> {
    let mut plans = Vec::new();
    while (plans.len() as u64) < options.samples {
        let start = plans.len() as u64;
        let request = v1::PlanSamplesRequest {
            recipe: Some(options.recipe.recipe(background.to_owned())?),
            seed: options.seed,
            start_index: start,
            count: (options.samples - start).min(PLANS_A_CALL),
        };
        let reply = connection.samples().plan_samples(request).await;
        let failed = |status| backlot_client::Error::from_status("planning samples", status);
        let reply = reply.map_err(failed)?.into_inner();
        ensure!(!reply.plans.is_empty(), "the server sent no plan");
        plans.extend(reply.plans);
    }
    Ok(plans)
}

/// Every placement, and each object of the log once.
fn boxes(plans: &[v1::SamplePlan]) -> Vec<MapBox> {
    let mut drawn = Vec::new();
    let mut known: Vec<&str> = Vec::new();
    for item in plans.iter().flat_map(|plan| &plan.boxes_3d) {
        let inserted = item.origin() == v1::BoxOrigin::Inserted;
        if !inserted {
            if known.contains(&item.track_id.as_str()) {
                continue;
            }
            known.push(&item.track_id);
        }
        let cuboid = item.cuboid.unwrap_or_default();
        drawn.push(MapBox {
            world_from_cuboid: rigid_from_wire(cuboid.world_from_cuboid.as_ref()),
            size_m: vector_from_wire(cuboid.size_m.as_ref()),
            inserted,
        });
    }
    drawn
}

fn rejections(plans: &[v1::SamplePlan]) -> BTreeMap<String, u64> {
    let mut sums = BTreeMap::new();
    for (reason, count) in plans.iter().flat_map(|plan| &plan.rejections) {
        *sums.entry(reason.clone()).or_default() += u64::from(*count);
    }
    sums
}
