//! The exactly ray-traced counterpart of every sample, and how close the samples come.

use std::fs;
use std::path::Path;

use backlot_client::generator::{ActorPose, RenderOptions, ShadowCasters, StreetWorld, View};
use backlot_client::geometry::{camera_of_view, rigid_from_wire};
use backlot_proto::v1;
use image::RgbImage;
use serde::Serialize;

use super::figures;
use super::library::Library;

/// Figures of one sample against its counterpart.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ExactComparison {
    pub index: u64,
    pub psnr: f64,
    /// Inside the exact mask of the inserted and replacing objects; absent without a visible one.
    pub psnr_in_insert_mask: Option<f64>,
    pub insert_mask_iou: Option<f64>,
    /// One for every inserted or replacing object that is visible in either image.
    pub visible_box_iou: Vec<f64>,
}

/// Renders the counterpart of a written sample into `out/exact` and compares the files.
pub(crate) fn compare(
    street: &StreetWorld,
    library: &Library,
    sample: &v1::Sample,
    out: &Path,
) -> anyhow::Result<ExactComparison> {
    let frame = &sample.frames[0];
    let view = frame.view.unwrap_or_default();
    let scene = scene(street, library, sample, frame.timestamp_ns);
    let exact_view = View {
        camera: camera_of_view(&view),
        world_from_camera: rigid_from_wire(view.world_from_camera.as_ref()),
    };
    let options = RenderOptions {
        shadow_casters: ShadowCasters::Flags(scene.casts_shadow.clone()),
        ..RenderOptions::default()
    };
    let exact = street.render(&exact_view, &scene.actors, &options)?;
    let name = format!("{:06}.png", sample.index);
    let path = |folder: &str| out.join("exact").join(folder).join(&name);
    for folder in ["image", "insert_mask"] {
        fs::create_dir_all(out.join("exact").join(folder))?;
    }
    let is_insert = |i: &u16| *i > 0 && scene.inserts[usize::from(*i) - 1].is_some();
    let mask: Vec<bool> = exact.instance.iter().map(is_insert).collect();
    figures::mask_image(view.width, view.height, &mask).save(path("insert_mask"))?;
    let image = RgbImage::from_raw(view.width, view.height, exact.rgb8.clone());
    image
        .expect("the frame has the view's size")
        .save(path("image"))?;

    let got = out.join("images").join(&name);
    let mask = figures::read_mask(&path("insert_mask"))?;
    let psnr =
        |counted: &dyn Fn(usize) -> bool| figures::psnr_of_files(&got, &path("image"), counted);
    let instances = figures::read_luma16(&out.join("instance").join(&name))?.into_raw();
    let inserted: Vec<u16> = scene.inserts.iter().flatten().copied().collect();
    let got_mask: Vec<bool> = instances.iter().map(|i| inserted.contains(i)).collect();
    let any = mask.iter().any(|set| *set);
    let either = any || got_mask.iter().any(|set| *set);
    Ok(ExactComparison {
        index: sample.index,
        psnr: psnr(&|_| true)?,
        psnr_in_insert_mask: any.then(|| psnr(&|i| mask[i])).transpose()?,
        insert_mask_iou: either.then(|| figures::mask_iou(&mask, &got_mask)),
        visible_box_iou: box_overlaps(&scene, &exact.instance, &instances, view.width),
    })
}

/// The cars of a counterpart, parallel lists.
struct ExactScene {
    actors: Vec<ActorPose>,
    casts_shadow: Vec<bool>,
    /// Instance id in the sample of inserted and replacing objects.
    inserts: Vec<Option<u16>>,
}

/// Static originals stay, unless replaced; movers and inserts are where the sample has them.
fn scene(
    street: &StreetWorld,
    library: &Library,
    sample: &v1::Sample,
    timestamp_ns: i64,
) -> ExactScene {
    let boxes = || sample.boxes_3d.iter();
    let is_replaced = |track_id: &str| {
        boxes().any(|b| b.origin() == v1::BoxOrigin::Replaced && b.track_id == track_id)
    };
    let mut scene = ExactScene {
        actors: Vec::new(),
        casts_shadow: Vec::new(),
        inserts: Vec::new(),
    };
    for actor in street.actors_at(timestamp_ns) {
        if !library.moving.contains(&actor.track_id) && !is_replaced(&actor.track_id) {
            scene.actors.push(actor);
            scene.casts_shadow.push(true);
            scene.inserts.push(None);
        }
    }
    let with_shadows = sample.provenance.as_ref().is_some_and(|p| p.insert_shadows);
    for placed in boxes() {
        use v1::BoxOrigin::{Inserted, Moved, Recorded, Replaced, Replayed};
        let origin = placed.origin();
        if !matches!(origin, Inserted | Moved | Recorded | Replaced | Replayed) {
            continue;
        }
        let is_original = matches!(origin, Recorded | Replayed);
        let cuboid = placed.cuboid.as_ref();
        scene.actors.push(ActorPose {
            // A recorded mover has no asset to have a source.
            track_id: match origin {
                Recorded => placed.track_id.clone(),
                _ => placed.source_track_id.clone(),
            },
            world_from_cuboid: rigid_from_wire(cuboid.and_then(|c| c.world_from_cuboid.as_ref())),
        });
        // Originals have their shadows in every sample; only those of inserts are an option.
        scene.casts_shadow.push(with_shadows || is_original);
        scene
            .inserts
            .push((!is_original).then_some(placed.instance_id as u16));
    }
    scene
}

fn box_overlaps(scene: &ExactScene, exact: &[u16], got: &[u16], width: u32) -> Vec<f64> {
    let mut overlaps = Vec::new();
    for (i, id) in scene.inserts.iter().enumerate() {
        let Some(id) = id else {
            continue;
        };
        let want = bounds(exact, i as u16 + 1, width);
        let got = bounds(got, *id, width);
        match (want, got) {
            (Some(want), Some(got)) => overlaps.push(box_iou(want, got)),
            (None, None) => {}
            _ => overlaps.push(0.0),
        }
    }
    overlaps
}

/// Left, top, right, bottom of an instance's pixels, right and bottom exclusive.
fn bounds(instances: &[u16], id: u16, width: u32) -> Option<[u32; 4]> {
    let mut bounds: Option<[u32; 4]> = None;
    for (i, instance) in instances.iter().enumerate() {
        if *instance == id {
            let (x, y) = (i as u32 % width, i as u32 / width);
            let b = bounds.get_or_insert([x, y, x + 1, y + 1]);
            *b = [b[0].min(x), b[1].min(y), b[2].max(x + 1), b[3].max(y + 1)];
        }
    }
    bounds
}

fn box_iou(a: [u32; 4], b: [u32; 4]) -> f64 {
    let area =
        |b: [u32; 4]| f64::from(b[2].saturating_sub(b[0])) * f64::from(b[3].saturating_sub(b[1]));
    let both = area([
        a[0].max(b[0]),
        a[1].max(b[1]),
        a[2].min(b[2]),
        a[3].min(b[3]),
    ]);
    both / (area(a) + area(b) - both)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_bound_the_pixels_of_their_instance() {
        let instances = [0, 2, 2, 0, 0, 2, 1, 0];
        assert_eq!(bounds(&instances, 2, 4), Some([1, 0, 3, 2]));
        assert_eq!(bounds(&instances, 7, 4), None);
    }

    #[test]
    fn disjoint_boxes_do_not_overlap() {
        assert_eq!(box_iou([0, 0, 2, 2], [4, 4, 6, 6]), 0.0);
        assert!((box_iou([0, 0, 2, 2], [1, 0, 3, 2]) - 1.0 / 3.0).abs() < 1e-12);
    }
}
