//! What a segmenter finds, and the one image it is stored as.

use backlot_engine::class::ObjectClass;
use serde::{Deserialize, Serialize};

use crate::domain::drive_log::MASK_NONE;

/// The classes that segmenters tell apart; finer ones come from the log's tracks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RoadUser {
    Vehicle,
    Pedestrian,
    /// With or without its rider.
    Cyclist,
}

impl RoadUser {
    pub const ALL: [Self; 3] = [Self::Vehicle, Self::Pedestrian, Self::Cyclist];

    /// Name in configurations and manifests.
    pub fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Pedestrian => "pedestrian",
            Self::Cyclist => "cyclist",
        }
    }

    /// Whether a track of this class may look like it. Data sets put trailers and carts into `Other`, and models see vehicles there.
    pub fn may_be(self, class: ObjectClass) -> bool {
        match class {
            ObjectClass::Pedestrian => self == Self::Pedestrian,
            ObjectClass::Cyclist => self == Self::Cyclist,
            ObjectClass::Other => true,
            ObjectClass::Car
            | ObjectClass::Van
            | ObjectClass::Truck
            | ObjectClass::Bus
            | ObjectClass::Tram => self == Self::Vehicle,
        }
    }
}

/// One road user.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    pub class: RoadUser,
    /// The model's own confidence, 0 to 1.
    pub score: f32,
    pub mask: InstanceMask,
}

/// The pixels of an instance within a rectangle of the image.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InstanceMask {
    /// First column and row.
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
    /// Row-major, `height * width`.
    pub pixels: Vec<bool>,
}

impl InstanceMask {
    /// The image's columns and rows that belong to the instance.
    pub fn coordinates(&self) -> impl Iterator<Item = (u32, u32)> + '_ {
        let at = |i: usize| {
            (
                self.x + i as u32 % self.width,
                self.y + i as u32 / self.width,
            )
        };
        let set = self.pixels.iter().enumerate().filter(|(_, set)| **set);
        set.map(move |(i, _)| at(i))
    }
}

/// An instance in a label image.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LabelledInstance {
    /// Value of its pixels.
    pub value: u16,
    pub class: RoadUser,
    pub score: f32,
}

/// Lays instances over each other, the surest in front: one value a pixel, row-major of `size`, and the instances of which a pixel is
/// seen. Equal scores stay in their order.
pub fn label_image(instances: &[Instance], size: (u32, u32)) -> (Vec<u16>, Vec<LabelledInstance>) {
    let (width, height) = size;
    let mut image = vec![MASK_NONE; width as usize * height as usize];
    let mut surest_first: Vec<&Instance> = instances.iter().collect();
    surest_first.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut labelled = Vec::new();
    for instance in surest_first {
        let value = labelled.len() as u16 + 1;
        let mut is_seen = false;
        for (x, y) in instance.mask.coordinates() {
            if x >= width || y >= height {
                continue;
            }
            let pixel = &mut image[y as usize * width as usize + x as usize];
            if *pixel == MASK_NONE {
                *pixel = value;
                is_seen = true;
            }
        }
        if is_seen {
            labelled.push(LabelledInstance {
                value,
                class: instance.class,
                score: instance.score,
            });
        }
    }
    (image, labelled)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(score: f32, (x, y): (u32, u32), side: u32) -> Instance {
        Instance {
            class: RoadUser::Vehicle,
            score,
            mask: InstanceMask {
                x,
                y,
                width: side,
                height: side,
                pixels: vec![true; (side * side) as usize],
            },
        }
    }

    #[test]
    fn the_surest_instance_has_a_pixel_that_two_claim() {
        let (image, labelled) =
            label_image(&[square(0.5, (0, 0), 2), square(0.9, (1, 0), 2)], (4, 3));
        assert_eq!(image, [2, 1, 1, 0, 2, 1, 1, 0, 0, 0, 0, 0]);
        let scores: Vec<f32> = labelled.iter().map(|i| i.score).collect();
        assert_eq!(scores, [0.9, 0.5]);
        assert_eq!(labelled[1].value, 2);
    }

    #[test]
    fn a_hidden_instance_takes_no_value_and_one_at_the_border_is_cut() {
        let all = [
            square(0.9, (1, 1), 9),
            square(0.8, (2, 1), 1),
            square(0.7, (0, 0), 1),
        ];
        let (image, labelled) = label_image(&all, (3, 2));
        assert_eq!(image, [2, 0, 0, 0, 1, 1]);
        assert_eq!(labelled.len(), 2);
    }

    #[test]
    fn a_mask_is_of_the_classes_it_may_show() {
        assert!(RoadUser::Vehicle.may_be(ObjectClass::Truck));
        assert!(!RoadUser::Vehicle.may_be(ObjectClass::Cyclist));
        assert!(!RoadUser::Pedestrian.may_be(ObjectClass::Car));
        assert!(RoadUser::Pedestrian.may_be(ObjectClass::Other));
    }
}
