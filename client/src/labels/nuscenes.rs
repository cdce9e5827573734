//! Tables in the schema of nuScenes.

use std::collections::BTreeMap;

use backlot_engine::camera::Rigid;
use backlot_proto::v1;
use serde::Serialize;

use super::token::token;
use super::{boxes_of, origin_name, pretty};
use crate::geometry::{rigid_from_wire, vector_from_wire};

/// The tables of a set, gathered sample by sample: a sample of the recipe is a scene, its frames are the scene's key frames.
///
/// There are cameras and no LiDAR files; `num_lidar_pts` is simulated. Boxes are in the log's world frame, which stands for nuScenes' global
/// one, with sizes as width, length, height; intrinsics count pixels from the first one's centre. An object is annotated in the frames that
/// show it. Besides nuScenes' own fields annotations say where an object came from.
#[derive(Debug, Default)]
pub struct NuscenesTables {
    log: BTreeMap<String, Log>,
    map: BTreeMap<String, Map>,
    scene: Vec<Scene>,
    sample: Vec<KeyFrame>,
    sample_data: Vec<SampleData>,
    ego_pose: Vec<EgoPose>,
    sensor: BTreeMap<String, Sensor>,
    calibrated_sensor: Vec<CalibratedSensor>,
    instance: Vec<Instance>,
    sample_annotation: Vec<Annotation>,
}

#[derive(Debug, Serialize)]
struct Log {
    token: String,
    logfile: String,
    vehicle: &'static str,
    date_captured: String,
    location: String,
}

#[derive(Debug, Serialize)]
struct Map {
    token: String,
    log_tokens: Vec<String>,
    category: &'static str,
    filename: &'static str,
}

#[derive(Debug, Serialize)]
struct Scene {
    token: String,
    log_token: String,
    nbr_samples: usize,
    first_sample_token: String,
    last_sample_token: String,
    name: String,
    description: String,
}

#[derive(Debug, Serialize)]
struct KeyFrame {
    token: String,
    /// Microseconds.
    timestamp: i64,
    prev: String,
    next: String,
    scene_token: String,
}

#[derive(Debug, Serialize)]
struct SampleData {
    token: String,
    sample_token: String,
    ego_pose_token: String,
    calibrated_sensor_token: String,
    timestamp: i64,
    fileformat: &'static str,
    is_key_frame: bool,
    height: u32,
    width: u32,
    filename: String,
    prev: String,
    next: String,
}

#[derive(Debug, Serialize)]
struct EgoPose {
    token: String,
    timestamp: i64,
    rotation: [f64; 4],
    translation: [f64; 3],
}

#[derive(Debug, Serialize)]
struct Sensor {
    token: String,
    channel: String,
    modality: &'static str,
}

#[derive(Debug, Serialize)]
struct CalibratedSensor {
    token: String,
    sensor_token: String,
    translation: [f64; 3],
    rotation: [f64; 4],
    camera_intrinsic: [[f64; 3]; 3],
}

#[derive(Debug, Serialize)]
struct Instance {
    token: String,
    category_token: String,
    nbr_annotations: usize,
    first_annotation_token: String,
    last_annotation_token: String,
}

#[derive(Debug, Serialize)]
struct Annotation {
    token: String,
    sample_token: String,
    instance_token: String,
    visibility_token: &'static str,
    attribute_tokens: Vec<String>,
    translation: [f64; 3],
    /// Width, length, height.
    size: [f64; 3],
    rotation: [f64; 4],
    prev: String,
    next: String,
    num_lidar_pts: u32,
    num_radar_pts: u32,
    origin: &'static str,
    asset: String,
    track_id: String,
    visible_fraction: f64,
}

#[derive(Debug, Serialize)]
struct Named {
    token: String,
    name: &'static str,
    description: &'static str,
}

#[derive(Debug, Serialize)]
struct Visibility {
    token: &'static str,
    level: &'static str,
    description: &'static str,
}

/// Folder of the tables: the name by which the devkit knows the version.
pub(crate) const NUSCENES_VERSION: &str = "v1.0-backlot";
/// nuScenes wants a map of each log; nothing is known of ours, so that it is one empty pixel.
pub(crate) const NUSCENES_MAP: &str = "maps/none.png";

const CATEGORIES: [(&str, &str); 7] = [
    ("vehicle.car", "Car or van"),
    ("vehicle.truck", "Truck"),
    ("vehicle.bus.rigid", "Bus"),
    ("vehicle.tram", "Tram; not a category of nuScenes"),
    ("human.pedestrian.adult", "Pedestrian"),
    ("vehicle.bicycle", "Bicycle with its rider"),
    (
        "movable_object.other",
        "Anything else; not a category of nuScenes",
    ),
];
const ATTRIBUTES: [(&str, &str); 5] = [
    ("vehicle.moving", "Vehicle is moving"),
    ("vehicle.parked", "Vehicle does not move"),
    ("cycle.with_rider", "There is a rider"),
    ("pedestrian.moving", "The human is moving"),
    ("pedestrian.standing", "The human stands"),
];
const VISIBILITIES: [Visibility; 4] = [
    visibility(
        "1",
        "v0-40",
        "visibility of whole object is between 0 and 40%",
    ),
    visibility(
        "2",
        "v40-60",
        "visibility of whole object is between 40 and 60%",
    ),
    visibility(
        "3",
        "v60-80",
        "visibility of whole object is between 60 and 80%",
    ),
    visibility(
        "4",
        "v80-100",
        "visibility of whole object is between 80 and 100%",
    ),
];
/// Slower is measurement noise of recorded tracks.
const MOVING_MPS: f64 = 0.2;

const fn visibility(
    token: &'static str,
    level: &'static str,
    description: &'static str,
) -> Visibility {
    Visibility {
        token,
        level,
        description,
    }
}

impl NuscenesTables {
    /// Adds a sample; `files` are the images of its frames relative to the data root.
    pub fn add(&mut self, sample: &v1::Sample, files: &[String]) {
        let provenance = sample.provenance.clone().unwrap_or_default();
        let log_token = self.add_log(&provenance);
        let scene = Keys::new(&provenance, sample);
        let samples: Vec<String> = (0..sample.frames.len()).map(|k| scene.sample(k)).collect();
        self.scene.push(Scene {
            token: scene.token("scene", &[]),
            log_token,
            nbr_samples: samples.len(),
            first_sample_token: samples.first().cloned().unwrap_or_default(),
            last_sample_token: samples.last().cloned().unwrap_or_default(),
            name: format!("scene-{:06}", sample.index),
            description: format!("sample {} of seed {}", sample.index, provenance.seed),
        });
        for (k, frame) in sample.frames.iter().enumerate() {
            self.sample.push(KeyFrame {
                token: samples[k].clone(),
                timestamp: micros(frame),
                prev: neighbour(&samples, k.checked_sub(1)),
                next: neighbour(&samples, Some(k + 1)),
                scene_token: scene.token("scene", &[]),
            });
            self.add_data(&scene, sample, k, &files[k]);
        }
        self.add_instances(&scene, sample);
    }

    fn add_log(&mut self, provenance: &v1::SampleProvenance) -> String {
        let log_token = token("log", &[&provenance.background]);
        self.log.entry(log_token.clone()).or_insert_with(|| Log {
            token: log_token.clone(),
            logfile: provenance.background.clone(),
            vehicle: "unknown",
            // When a log was recorded is not kept; the devkit wants a date.
            date_captured: "1970-01-01".to_owned(),
            location: provenance.background.clone(),
        });
        let map_token = token("map", &[]);
        let map = self.map.entry(map_token.clone()).or_insert_with(|| Map {
            token: map_token,
            log_tokens: Vec::new(),
            category: "semantic_prior",
            filename: NUSCENES_MAP,
        });
        if !map.log_tokens.contains(&log_token) {
            map.log_tokens.push(log_token.clone());
        }
        log_token
    }

    fn add_data(&mut self, scene: &Keys, sample: &v1::Sample, k: usize, file: &str) {
        let frame = &sample.frames[k];
        let view = frame.view.unwrap_or_default();
        let world_from_ego = rigid_from_wire(frame.world_from_ego.as_ref());
        let world_from_camera = rigid_from_wire(view.world_from_camera.as_ref());
        let ego_from_camera = world_from_ego.inverse() * world_from_camera;
        let channel = channel(&frame.camera_id);
        let sensor_token = token("sensor", &[&channel]);
        self.sensor
            .entry(sensor_token.clone())
            .or_insert_with(|| Sensor {
                token: sensor_token.clone(),
                channel: channel.clone(),
                modality: "camera",
            });
        let data = |k: usize| scene.token("sample_data", &[&channel, &k.to_string()]);
        let all: Vec<String> = (0..sample.frames.len()).map(data).collect();
        let number = k.to_string();
        self.ego_pose.push(EgoPose {
            token: scene.token("ego_pose", &[&number]),
            timestamp: micros(frame),
            rotation: wxyz(&world_from_ego),
            translation: world_from_ego.translation_m.to_array(),
        });
        self.calibrated_sensor.push(CalibratedSensor {
            token: scene.token("calibrated_sensor", &[&number]),
            sensor_token,
            translation: ego_from_camera.translation_m.to_array(),
            rotation: wxyz(&ego_from_camera),
            camera_intrinsic: [
                [view.focal_x_px, 0.0, view.principal_x_px - 0.5],
                [0.0, view.focal_y_px, view.principal_y_px - 0.5],
                [0.0, 0.0, 1.0],
            ],
        });
        self.sample_data.push(SampleData {
            token: all[k].clone(),
            sample_token: scene.sample(k),
            ego_pose_token: scene.token("ego_pose", &[&number]),
            calibrated_sensor_token: scene.token("calibrated_sensor", &[&number]),
            timestamp: micros(frame),
            fileformat: "png",
            is_key_frame: true,
            height: view.height,
            width: view.width,
            filename: file.to_owned(),
            prev: neighbour(&all, k.checked_sub(1)),
            next: neighbour(&all, Some(k + 1)),
        });
    }

    fn add_instances(&mut self, scene: &Keys, sample: &v1::Sample) {
        for box_3d in &sample.boxes_3d {
            let id = box_3d.instance_id.to_string();
            let views: Vec<(usize, &v1::SampleBox2D)> = sample
                .frames
                .iter()
                .enumerate()
                .flat_map(|(k, frame)| {
                    let views = boxes_of(sample, frame);
                    let own = views.filter(|(b, _)| b.instance_id == box_3d.instance_id);
                    own.map(move |(_, view)| (k, view))
                })
                .collect();
            let tokens: Vec<String> = views
                .iter()
                .map(|(k, _)| scene.token("sample_annotation", &[&id, &k.to_string()]))
                .collect();
            let (Some(first), Some(last)) = (tokens.first(), tokens.last()) else {
                continue;
            };
            let instance_token = scene.token("instance", &[&id]);
            self.instance.push(Instance {
                token: instance_token.clone(),
                category_token: token("category", &[category(box_3d.object_class())]),
                nbr_annotations: tokens.len(),
                first_annotation_token: first.clone(),
                last_annotation_token: last.clone(),
            });
            for (i, (k, view)) in views.into_iter().enumerate() {
                self.sample_annotation.push(Annotation {
                    token: tokens[i].clone(),
                    sample_token: scene.sample(k),
                    instance_token: instance_token.clone(),
                    prev: neighbour(&tokens, i.checked_sub(1)),
                    next: neighbour(&tokens, Some(i + 1)),
                    ..annotation(box_3d, view)
                });
            }
        }
    }

    /// Every table as (file name, JSON), in the order of the schema.
    pub fn files(&self) -> Vec<(&'static str, String)> {
        let named = |kind: &str, rows: &[(&'static str, &'static str)]| {
            let rows = rows.iter().map(|(name, description)| Named {
                token: token(kind, &[name]),
                name,
                description,
            });
            rows.collect::<Vec<_>>()
        };
        vec![
            ("category.json", pretty(&named("category", &CATEGORIES))),
            ("attribute.json", pretty(&named("attribute", &ATTRIBUTES))),
            ("visibility.json", pretty(&VISIBILITIES)),
            ("instance.json", pretty(&self.instance)),
            ("sensor.json", pretty(&rows(&self.sensor))),
            ("calibrated_sensor.json", pretty(&self.calibrated_sensor)),
            ("ego_pose.json", pretty(&self.ego_pose)),
            ("log.json", pretty(&rows(&self.log))),
            ("scene.json", pretty(&self.scene)),
            ("sample.json", pretty(&self.sample)),
            ("sample_data.json", pretty(&self.sample_data)),
            ("sample_annotation.json", pretty(&self.sample_annotation)),
            ("map.json", pretty(&rows(&self.map))),
        ]
    }
}

/// Tokens within one scene.
struct Keys {
    scene: [String; 3],
}

impl Keys {
    fn new(provenance: &v1::SampleProvenance, sample: &v1::Sample) -> Self {
        Self {
            scene: [
                provenance.background.clone(),
                provenance.seed.to_string(),
                sample.index.to_string(),
            ],
        }
    }

    fn token(&self, kind: &str, key: &[&str]) -> String {
        let mut whole: Vec<&str> = self.scene.iter().map(String::as_str).collect();
        whole.extend(key);
        token(kind, &whole)
    }

    fn sample(&self, k: usize) -> String {
        self.token("sample", &[&k.to_string()])
    }
}

/// An annotation without its links.
fn annotation(box_3d: &v1::SampleBox, view: &v1::SampleBox2D) -> Annotation {
    let world_from_cuboid = rigid_from_wire(view.world_from_cuboid.as_ref());
    let size = vector_from_wire(box_3d.cuboid.as_ref().and_then(|c| c.size_m.as_ref()));
    let speed = view
        .velocity_mps
        .as_ref()
        .map(|v| vector_from_wire(Some(v)).length());
    let attributes = attribute(box_3d.object_class(), speed);
    Annotation {
        token: String::new(),
        sample_token: String::new(),
        instance_token: String::new(),
        visibility_token: match view.visible_fraction {
            f if f >= 0.8 => "4",
            f if f >= 0.6 => "3",
            f if f >= 0.4 => "2",
            _ => "1",
        },
        attribute_tokens: attributes
            .map(|name| token("attribute", &[name]))
            .into_iter()
            .collect(),
        translation: world_from_cuboid.translation_m.to_array(),
        size: [size.y, size.x, size.z],
        rotation: wxyz(&world_from_cuboid),
        prev: String::new(),
        next: String::new(),
        num_lidar_pts: view.lidar_points,
        num_radar_pts: 0,
        origin: origin_name(box_3d.origin()),
        asset: box_3d.asset.clone(),
        track_id: box_3d.track_id.clone(),
        visible_fraction: view.visible_fraction,
    }
}

fn attribute(class: v1::ObjectClass, speed_mps: Option<f64>) -> Option<&'static str> {
    let moving = speed_mps.map(|s| s > MOVING_MPS);
    match (class, moving) {
        (v1::ObjectClass::Cyclist, _) => Some("cycle.with_rider"),
        (v1::ObjectClass::Pedestrian, Some(true)) => Some("pedestrian.moving"),
        (v1::ObjectClass::Pedestrian, Some(false)) => Some("pedestrian.standing"),
        (v1::ObjectClass::Other | v1::ObjectClass::Unspecified, _) | (_, None) => None,
        (_, Some(true)) => Some("vehicle.moving"),
        (_, Some(false)) => Some("vehicle.parked"),
    }
}

fn category(class: v1::ObjectClass) -> &'static str {
    match class {
        v1::ObjectClass::Car | v1::ObjectClass::Van => "vehicle.car",
        v1::ObjectClass::Truck => "vehicle.truck",
        v1::ObjectClass::Bus => "vehicle.bus.rigid",
        v1::ObjectClass::Tram => "vehicle.tram",
        v1::ObjectClass::Pedestrian => "human.pedestrian.adult",
        v1::ObjectClass::Cyclist => "vehicle.bicycle",
        v1::ObjectClass::Other | v1::ObjectClass::Unspecified => "movable_object.other",
    }
}

/// nuScenes' channels are upper case and name the modality first.
fn channel(camera_id: &str) -> String {
    let name = camera_id.to_uppercase();
    match name.starts_with("CAM") {
        true => name,
        false => format!("CAM_{name}"),
    }
}

fn micros(frame: &v1::SampleFrame) -> i64 {
    frame.timestamp_ns.div_euclid(1000)
}

fn wxyz(rigid: &Rigid) -> [f64; 4] {
    let q = rigid.rotation;
    [q.w, q.x, q.y, q.z]
}

/// Empty before the first and after the last.
fn neighbour(tokens: &[String], at: Option<usize>) -> String {
    at.and_then(|i| tokens.get(i)).cloned().unwrap_or_default()
}

fn rows<T>(by_token: &BTreeMap<String, T>) -> Vec<&T> {
    by_token.values().collect()
}
