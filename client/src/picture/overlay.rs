//! Cuboids and 2D boxes over an image.

use backlot_engine::camera::{Camera, NEAR_M, Rigid};
use backlot_proto::v1;
use glam::{DVec2, DVec3};
use image::{Rgb, RgbImage};

use super::draw_line;
use crate::geometry::{BOX_EDGES, box_corners, camera_of_view, rigid_from_wire, vector_from_wire};

/// Draws every visible box of a frame: the 2D box thin, the cuboid's edges over it, coloured by origin.
pub fn draw_boxes(image: &mut RgbImage, sample: &v1::Sample, frame: &v1::SampleFrame) {
    let camera = camera_of_view(&frame.view.unwrap_or_default());
    for view in &frame.boxes_2d {
        let same = |b: &&v1::SampleBox| b.instance_id == view.instance_id;
        let Some(box_3d) = sample.boxes_3d.iter().find(same) else {
            continue;
        };
        if view.visible_pixels == 0 {
            continue;
        }
        let color = origin_color(box_3d.origin());
        if let Some(bounds) = &view.visible {
            draw_rectangle(image, bounds, dimmed(color));
        }
        let size = vector_from_wire(box_3d.cuboid.as_ref().and_then(|c| c.size_m.as_ref()));
        let camera_from_cuboid = rigid_from_wire(view.camera_from_cuboid.as_ref());
        draw_cuboid(image, &camera, &camera_from_cuboid, size, color);
    }
}

/// Draws the twelve edges of a box of `size_m` (length, width, height), and a cross on its front face.
pub fn draw_cuboid(
    image: &mut RgbImage,
    camera: &Camera,
    camera_from_cuboid: &Rigid,
    size_m: DVec3,
    color: Rgb<u8>,
) {
    let corners = box_corners(size_m).map(|corner| camera_from_cuboid.point(corner));
    // The diagonals of the front face tell which way the object looks.
    let front = [(1, 7), (3, 5)];
    for (a, b) in BOX_EDGES.into_iter().chain(front) {
        if let Some((from, to)) = projected_edge(camera, corners[a], corners[b]) {
            draw_line(image, from, to, 1, color);
        }
    }
}

pub fn draw_rectangle(image: &mut RgbImage, bounds: &v1::Box2D, color: Rgb<u8>) {
    let corners = [
        DVec2::new(bounds.x_min, bounds.y_min),
        DVec2::new(bounds.x_max, bounds.y_min),
        DVec2::new(bounds.x_max, bounds.y_max),
        DVec2::new(bounds.x_min, bounds.y_max),
    ];
    for i in 0..4 {
        draw_line(image, corners[i], corners[(i + 1) % 4], 1, color);
    }
}

/// Projects an edge after clipping it at the near plane: a corner behind the camera would land on the wrong side.
fn projected_edge(camera: &Camera, a: DVec3, b: DVec3) -> Option<(DVec2, DVec2)> {
    let (near, far) = if a.z < b.z { (a, b) } else { (b, a) };
    // Just in front of the plane, so that rounding cannot put the point behind it.
    let plane = NEAR_M * 1.001;
    if far.z < plane {
        return None;
    }
    let clipped = if near.z < plane {
        near.lerp(far, (plane - near.z) / (far.z - near.z))
    } else {
        near
    };
    Some((camera.project(clipped)?, camera.project(far)?))
}

fn origin_color(origin: v1::BoxOrigin) -> Rgb<u8> {
    match origin {
        v1::BoxOrigin::Inserted => Rgb([60, 255, 90]),
        v1::BoxOrigin::Replaced | v1::BoxOrigin::Moved => Rgb([255, 170, 30]),
        v1::BoxOrigin::Replayed | v1::BoxOrigin::Recorded => Rgb([80, 190, 255]),
        v1::BoxOrigin::Static | v1::BoxOrigin::Unspecified => Rgb([235, 235, 235]),
    }
}

fn dimmed(color: Rgb<u8>) -> Rgb<u8> {
    Rgb(color.0.map(|c| c / 5 * 3))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            width: 100,
            height: 100,
            focal_px: DVec2::splat(50.0),
            principal_px: DVec2::splat(50.0),
            distortion: Default::default(),
        }
    }

    #[test]
    fn edges_are_clipped_before_projection() {
        let ahead = DVec3::new(0.0, 1.0, 5.0);
        let behind = DVec3::new(0.0, 1.0, -5.0);
        let (from, to) = projected_edge(&camera(), ahead, behind).unwrap();
        // Everything in front of the camera lies below the horizon, so the far end must too.
        assert!(from.y > 50.0 && to.y > 50.0, "{from} {to}");
        assert!(projected_edge(&camera(), behind, behind - DVec3::Z).is_none());
    }
}
