//! Parity of whole rendered frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use super::adapter::{on_adapter, open, open_narrow};
use super::compare::{Cpu, Gpu};
use super::compare_frames::{FrameDeviation, compare};
use super::street::{Street, camera};
use crate::backend::cpu::CpuBackend;
use crate::backend::gpu::GpuBackend;
use crate::backend::gpu::parts::Parts;
use crate::backend::{AdapterChoice, Backend};
use crate::camera::{Camera, Distortion};
use crate::field::{FEATURES, Field};
use crate::scene::{RenderOptions, RenderedFrame, Scene};
use crate::{Error, ErrorKind};

#[test]
fn parity_of_a_whole_frame() {
    on_adapter("whole frame", |gpu| {
        let street = Street::new();
        let scene = street.scene(camera(Distortion::None));
        let cpu = Cpu(cpu_frame(&scene));
        assert_frame_is_worth_comparing(&cpu.0);
        let worst = compare(&Gpu(gpu_frame(gpu, &scene)), &cpu).expect("parity");
        say(&worst);
    });
}

#[test]
fn parity_rejects_a_car_moved_by_a_hand() {
    rejects("car moved by 0.1 m", |scene| {
        scene.objects[0].local_from_object.translation_m.y += 0.1;
    });
}

#[test]
fn parity_rejects_another_tone() {
    rejects("tone off by 0.04", |scene| {
        scene.objects[0].tone.offset[1] += 0.04
    });
}

#[test]
fn parity_rejects_a_camera_moved_by_a_hand() {
    rejects("camera moved by 0.05 m", |scene| {
        scene.local_from_camera.translation_m.z += 0.05;
    });
}

#[test]
fn parity_rejects_a_missing_object() {
    rejects("the far car left out", |scene| {
        scene.objects.pop();
    });
}

#[test]
fn parity_rejects_another_instance() {
    rejects("instance renamed", |scene| scene.objects[1].instance_id = 9);
}

#[test]
fn parity_rejects_a_static_object_that_is_elsewhere() {
    rejects("parked car moved by 0.5 m", |scene| {
        scene.statics[0].local_from_object.translation_m.y += 0.5;
    });
}

#[test]
fn parity_of_lenses_and_supersampling() {
    on_adapter("lenses", |gpu| {
        let street = Street::new();
        let lenses = [
            // Every pixel has a ray: distortion still grows with the radius at the corners.
            Distortion::BrownConrady {
                k: [-0.2, 0.05, 0.001, -0.0007, -0.004],
            },
            Distortion::KannalaBrandt {
                k: [0.02, -0.004, 0.001, -0.0002],
            },
        ];
        for lens in lenses {
            let scene = street.scene(camera(lens).resized(310, 94));
            let options = RenderOptions {
                supersample: 2,
                object_supersample: 3,
            };
            let cpu = Cpu(CpuBackend
                .render(&scene, &options, &|| false)
                .expect("renders"));
            let frame = Gpu(gpu.render(&scene, &options, &|| false).expect("renders"));
            compare(&frame, &cpu).expect("parity");
            let plain = Cpu(cpu_frame(
                &street.scene(camera(Distortion::None).resized(310, 94)),
            ));
            assert!(
                compare(&frame, &plain).is_err(),
                "a lens that changes nothing"
            );
        }
    });
}

#[test]
fn parity_of_objects_over_nothing() {
    on_adapter("objects over nothing", |gpu| {
        let street = Street::new();
        let alone = |camera: Camera| Scene {
            background: None,
            statics: Vec::new(),
            ..street.scene(camera)
        };
        let small = camera(Distortion::None).resized(310, 94);
        let scene = alone(small);
        let frame = Gpu(gpu_frame(gpu, &scene));
        compare(&frame, &Cpu(cpu_frame(&scene))).expect("parity");
        assert_eq!(frame.0.rgb8[..3], [0, 0, 0], "black where nothing is");
        let with = Cpu(cpu_frame(&street.scene(small)));
        assert!(
            compare(&frame, &with).is_err(),
            "a background that changes nothing"
        );
    });
}

/// Bindings of 4 MiB split the density of 1.6 M nodes in two and their features in seven.
#[test]
fn parity_of_split_fields() {
    on_adapter("split fields", |shared| {
        let street = Street::fine();
        let nodes = street.background.levels().iter().map(|l| l.density().len());
        let nodes = nodes.sum::<usize>();
        let narrow = open_narrow(4 << 20).expect("opens");
        let densities = Parts::<f32>::zeroed(&narrow.device, "densities", nodes, 4);
        assert_eq!(densities.expect("fits").parts().len(), 2);
        let scene = street.scene(camera(Distortion::None).resized(310, 94));
        let frame = Gpu(gpu_frame(&narrow, &scene));
        compare(&frame, &Cpu(cpu_frame(&scene))).expect("parity");
        let whole = gpu_frame(shared, &scene);
        assert_eq!(
            frame.0.depth_z_m, whole.depth_z_m,
            "where densities lie changes nothing"
        );
        // Without the second half of the features the comparison must fail.
        let mut half = Field::clone(&street.background);
        let (_, features) = half.levels[1].parameters_mut();
        let middle = features.len() / 2;
        features[middle..].fill([0.0; FEATURES]);
        let half = Arc::new(half);
        let wrong = Scene {
            background: Some(&half),
            ..street.scene(scene.camera)
        };
        let verdict = compare(&frame, &Cpu(cpu_frame(&wrong)));
        assert!(verdict.is_err(), "{verdict:?}");
    });
}

/// Room for one background but not for two.
#[test]
fn parity_of_frames_whose_assets_take_turns_on_the_device() {
    on_adapter("evicted assets", |shared| {
        let streets = [Street::new(), Street::new()];
        let bytes = streets[0].background.memory_bytes() + 2 * streets[0].solid.memory_bytes();
        let gpu = GpuBackend::open(&AdapterChoice::Index(0), bytes + (1 << 20)).expect("opens");
        let small = camera(Distortion::None).resized(124, 37);
        let first = gpu_frame(&gpu, &streets[0].scene(small));
        for street in [&streets[1], &streets[0]] {
            assert_eq!(gpu_frame(&gpu, &street.scene(small)), first);
            assert!(gpu.resident_bytes() <= bytes + (1 << 20));
        }
        let [kept, dropped] = streets;
        drop(kept);
        gpu_frame(&gpu, &dropped.scene(small));
        let left = dropped.background.memory_bytes() + 2 * dropped.solid.memory_bytes();
        assert!(
            gpu.resident_bytes() <= left,
            "fields that are gone stay on the device"
        );
        gpu_frame(shared, &dropped.scene(small));
    });
}

#[test]
fn parity_of_frame_refusals() {
    on_adapter("frame refusals", |gpu| {
        let street = Street::new();
        let scene = street.scene(camera(Distortion::None).resized(310, 94));
        let options = RenderOptions::default();
        let stopped = gpu.render(&scene, &options, &|| true);
        assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
        // A frame of many batches ends at the first one that finds the call cancelled.
        let asked = AtomicU32::new(0);
        let third = || asked.fetch_add(1, Ordering::Relaxed) == 2;
        let stopped = gpu.render(&scene, &options, &third);
        assert!(matches!(stopped, Err(Error::Cancelled)), "{stopped:?}");
        assert_eq!(asked.into_inner(), 3);
        let mut broken = street.scene(scene.camera);
        broken.local_from_camera.translation_m.x = f64::NAN;
        let refused = gpu
            .render(&broken, &options, &|| false)
            .expect_err("no pose");
        assert_eq!(refused.kind(), ErrorKind::Invalid, "{refused}");
        // Something dispatched shows that the device still works after both.
        gpu_frame(gpu, &scene);
    });
}

#[test]
fn parity_of_an_asset_that_does_not_fit() {
    on_adapter("asset that does not fit", |shared| {
        let street = Street::new();
        let scene = street.scene(camera(Distortion::None).resized(64, 20));
        let small = GpuBackend::open(&AdapterChoice::Index(0), 1 << 20).expect("opens");
        let refused = small.render(&scene, &RenderOptions::default(), &|| false);
        let refused = refused.expect_err("1 MiB");
        assert_eq!(refused.kind(), ErrorKind::Overloaded, "{refused}");
        let Error::OutOfMemory {
            needed_bytes,
            available_bytes,
            ..
        } = refused
        else {
            panic!("{refused}");
        };
        assert_eq!(available_bytes, 1 << 20);
        assert!(needed_bytes > available_bytes);
        gpu_frame(shared, &scene);
    });
}

/// Its own device, since it is destroyed.
#[test]
fn parity_of_frames_after_a_lost_device() {
    use crate::backend::gpu::DurableGpu;
    on_adapter("frames after a lost device", |shared| {
        let street = Street::new();
        let scene = street.scene(camera(Distortion::None).resized(310, 94));
        let options = RenderOptions::default();
        let lost = open().expect("opens");
        lost.device.destroy();
        let error = lost.render(&scene, &options, &|| false).expect_err("lost");
        assert_eq!(error.kind(), ErrorKind::Unavailable, "{error}");
        let durable = DurableGpu::open(&AdapterChoice::Index(0), 1 << 30).expect("opens");
        let before = durable
            .render(&scene, &options, &|| false)
            .expect("renders");
        durable.current().expect("open").device.destroy();
        let after = durable
            .render(&scene, &options, &|| false)
            .expect("opens again");
        assert_eq!(before, after, "the same frame on a new device");
        gpu_frame(shared, &scene);
    });
}

fn gpu_frame(gpu: &GpuBackend, scene: &Scene<'_>) -> RenderedFrame {
    gpu.render(scene, &RenderOptions::default(), &|| false)
        .expect("the GPU renders")
}

fn cpu_frame(scene: &Scene<'_>) -> RenderedFrame {
    CpuBackend
        .render(scene, &RenderOptions::default(), &|| false)
        .expect("the CPU renders")
}

/// Asserts that the comparison notices a CPU side whose scene is wrong on purpose.
fn rejects(what: &str, break_it: impl FnOnce(&mut Scene<'_>)) {
    on_adapter(what, |gpu| {
        let street = Street::new();
        let small = camera(Distortion::None).resized(310, 94);
        let right = street.scene(small);
        let mut wrong = street.scene(small);
        break_it(&mut wrong);
        let frame = Gpu(gpu_frame(gpu, &right));
        compare(&frame, &Cpu(cpu_frame(&right))).expect("the right scene passes");
        let verdict = compare(&frame, &Cpu(cpu_frame(&wrong)));
        assert!(
            verdict.is_err(),
            "{what} passed the comparison: {verdict:?}"
        );
    });
}

fn assert_frame_is_worth_comparing(frame: &RenderedFrame) {
    for instance in 0..=5 {
        let pixels = frame
            .instance
            .iter()
            .filter(|own| **own == instance)
            .count();
        assert!(pixels > 30, "instance {instance} owns {pixels} pixels");
    }
    let count =
        |test: &dyn Fn(f32) -> bool| frame.accumulation.iter().filter(|a| test(**a)).count();
    let (open, hazy) = (count(&|a| a < 0.05), count(&|a| (0.1..0.9).contains(&a)));
    assert!(open > 1000 && hazy > 1000, "{open} open, {hazy} hazy");
    let colors: std::collections::BTreeSet<&[u8]> = frame.rgb8.chunks(3).collect();
    assert!(colors.len() > 1000, "{} colours", colors.len());
}

fn say(worst: &FrameDeviation) {
    eprintln!("parity: whole frame: {worst}");
}
