//! COCO object detection and instance segmentation.

use backlot_proto::v1;
use serde::Serialize;

use super::mask::{compressed, runs_of};
use super::{boxes_of, kitti_type, origin_name};
use crate::geometry::{rigid_from_wire, vector_from_wire};

/// Everything that one annotation file says, gathered frame by frame.
///
/// Boxes are x, y, width, height with the top left pixel's corner at 0, 0, as pycocotools' `toBbox` gives them of the mask; masks are
/// compressed run lengths. Besides COCO's own fields annotations carry the track through a clip, visibility, truncation, occluder, the
/// amodal box, the cuboid in the camera frame and where the object came from. Pixels to ignore are crowd regions of every category.
#[derive(Debug, Default)]
pub struct CocoSet {
    images: Vec<Image>,
    annotations: Vec<Annotation>,
}

#[derive(Debug, Serialize)]
struct File<'a> {
    info: Description,
    licenses: [(); 0],
    images: &'a [Image],
    annotations: &'a [Annotation],
    categories: Vec<Category>,
}

#[derive(Debug, Serialize)]
struct Description {
    description: String,
    version: &'static str,
    library_snapshot: String,
    seed: u64,
    render_class: String,
    synthetic: bool,
}

#[derive(Debug, Serialize)]
struct Category {
    id: i32,
    name: &'static str,
    supercategory: &'static str,
}

#[derive(Debug, Serialize)]
struct Image {
    id: u64,
    width: u32,
    height: u32,
    /// Relative to the annotation file.
    file_name: String,
    sample_index: u64,
    /// Position in a clip.
    frame_id: usize,
    camera_id: String,
    timestamp_ns: i64,
    /// fx, fy, cx, cy with the first pixel's centre at 0.5, 0.5.
    intrinsics: [f64; 4],
}

#[derive(Debug, Serialize)]
struct Segmentation {
    /// Height, width.
    size: [u32; 2],
    counts: String,
}

#[derive(Debug, Serialize)]
struct Annotation {
    id: u64,
    image_id: u64,
    category_id: i32,
    bbox: [f64; 4],
    area: f64,
    iscrowd: u8,
    segmentation: Segmentation,
    #[serde(flatten)]
    object: Option<Object>,
}

/// What COCO has no words for.
#[derive(Debug, Serialize)]
struct Object {
    /// The same through the frames of a clip, another in each sample.
    instance_id: u64,
    visible_fraction: f64,
    truncation: f64,
    occluder_instance_id: Option<u64>,
    bbox_amodal: Option<[f64; 4]>,
    lidar_points: u32,
    origin: &'static str,
    track_id: Option<String>,
    asset: Option<String>,
    /// Centre, then length, width, height, metres; row-major 3 x 3 rotation.
    center_camera_m: [f64; 3],
    size_m: [f64; 3],
    rotation_camera: [f64; 9],
    velocity_world_mps: Option<[f64; 3]>,
}

/// The classes in the order of their ids.
const CLASSES: [v1::ObjectClass; 8] = [
    v1::ObjectClass::Car,
    v1::ObjectClass::Van,
    v1::ObjectClass::Truck,
    v1::ObjectClass::Bus,
    v1::ObjectClass::Tram,
    v1::ObjectClass::Pedestrian,
    v1::ObjectClass::Cyclist,
    v1::ObjectClass::Other,
];

/// Instances of one sample.
const INSTANCES: u64 = 1 << 16;

impl CocoSet {
    /// Adds frame `position` of a sample, whose image lies at `file_name` beside the annotation file.
    ///
    /// # Errors
    /// If the ignore mask does not decode.
    pub fn add(
        &mut self,
        sample: &v1::Sample,
        position: usize,
        file_name: &str,
    ) -> Result<(), image::ImageError> {
        let frame = &sample.frames[position];
        let view = frame.view.unwrap_or_default();
        let image_id = self.images.len() as u64 + 1;
        self.images.push(Image {
            id: image_id,
            width: view.width,
            height: view.height,
            file_name: file_name.to_owned(),
            sample_index: sample.index,
            frame_id: position,
            camera_id: frame.camera_id.clone(),
            timestamp_ns: frame.timestamp_ns,
            intrinsics: [
                view.focal_x_px,
                view.focal_y_px,
                view.principal_x_px,
                view.principal_y_px,
            ],
        });
        let size = [view.height, view.width];
        for (box_3d, box_2d) in boxes_of(sample, frame) {
            let Some(visible) = &box_2d.visible else {
                continue;
            };
            let segmentation = Segmentation {
                size,
                counts: compressed(&box_2d.mask_runs),
            };
            self.push(Annotation {
                id: 0,
                image_id,
                category_id: category_id(box_3d.object_class()),
                bbox: corner_and_size(visible),
                area: f64::from(box_2d.visible_pixels),
                iscrowd: 0,
                segmentation,
                object: Some(object(sample.index, box_3d, box_2d)),
            });
        }
        if frame.ignore_png.is_empty() {
            return Ok(());
        }
        let mask = image::load_from_memory(&frame.ignore_png)?.into_luma8();
        self.add_ignored(image_id, size, &mask);
        Ok(())
    }

    fn add_ignored(&mut self, image_id: u64, size: [u32; 2], mask: &image::GrayImage) {
        let marked = mask.enumerate_pixels().filter(|(_, _, p)| p.0[0] > 127);
        let (mut low, mut high, mut area) = ([u32::MAX; 2], [0; 2], 0u32);
        for (x, y, _) in marked {
            low = [low[0].min(x), low[1].min(y)];
            high = [high[0].max(x + 1), high[1].max(y + 1)];
            area += 1;
        }
        if area == 0 {
            return;
        }
        let counts = compressed(&runs_of(mask));
        let [x, y] = low.map(f64::from);
        let [right, bottom] = high.map(f64::from);
        for class in CLASSES {
            self.push(Annotation {
                id: 0,
                image_id,
                category_id: category_id(class),
                bbox: [x, y, right - x, bottom - y],
                area: f64::from(area),
                iscrowd: 1,
                segmentation: Segmentation {
                    size,
                    counts: counts.clone(),
                },
                object: None,
            });
        }
    }

    fn push(&mut self, annotation: Annotation) {
        let id = self.annotations.len() as u64 + 1;
        self.annotations.push(Annotation { id, ..annotation });
    }

    /// The annotation file.
    pub fn to_json(&self, provenance: &v1::SampleProvenance) -> String {
        let categories = CLASSES.map(|class| Category {
            id: category_id(class),
            name: kitti_type(class),
            supercategory: match class {
                v1::ObjectClass::Pedestrian => "person",
                v1::ObjectClass::Other | v1::ObjectClass::Unspecified => "other",
                _ => "vehicle",
            },
        });
        let file = File {
            info: Description {
                description: format!("augmented from {}", provenance.background),
                version: env!("CARGO_PKG_VERSION"),
                library_snapshot: provenance.library_snapshot.clone(),
                seed: provenance.seed,
                render_class: provenance.render_class.clone(),
                synthetic: provenance.synthetic,
            },
            licenses: [],
            images: &self.images,
            annotations: &self.annotations,
            categories: categories.into(),
        };
        serde_json::to_string(&file).expect("records have string keys")
    }
}

fn object(sample_index: u64, box_3d: &v1::SampleBox, box_2d: &v1::SampleBox2D) -> Object {
    let unique = |id: u32| sample_index * INSTANCES + u64::from(id);
    let camera_from_cuboid = rigid_from_wire(box_2d.camera_from_cuboid.as_ref());
    let rows = camera_from_cuboid.rotation_matrix().transpose();
    let size_m = vector_from_wire(box_3d.cuboid.as_ref().and_then(|c| c.size_m.as_ref()));
    let some = |text: &String| (!text.is_empty()).then(|| text.clone());
    let occluder = box_2d.occluder_instance_id;
    Object {
        instance_id: unique(box_3d.instance_id),
        visible_fraction: box_2d.visible_fraction,
        truncation: box_2d.truncation,
        occluder_instance_id: (occluder != 0).then(|| unique(occluder)),
        bbox_amodal: box_2d.amodal.as_ref().map(corner_and_size),
        lidar_points: box_2d.lidar_points,
        origin: origin_name(box_3d.origin()),
        track_id: some(&box_3d.track_id),
        asset: some(&box_3d.asset),
        center_camera_m: camera_from_cuboid.translation_m.to_array(),
        size_m: size_m.to_array(),
        rotation_camera: rows.to_cols_array(),
        velocity_world_mps: box_2d.velocity_mps.map(|v| [v.x, v.y, v.z]),
    }
}

fn category_id(class: v1::ObjectClass) -> i32 {
    match class {
        v1::ObjectClass::Unspecified => v1::ObjectClass::Other as i32,
        class => class as i32,
    }
}

fn corner_and_size(b: &v1::Box2D) -> [f64; 4] {
    [b.x_min, b.y_min, b.x_max - b.x_min, b.y_max - b.y_min]
}
