//! Object classes the engine tells apart.

use serde::{Deserialize, Serialize};

/// Class of an object; mirrors the wire's enum without its UNSPECIFIED.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ObjectClass {
    Car,
    Van,
    Truck,
    Bus,
    Tram,
    Pedestrian,
    Cyclist,
    /// Anything else that is labelled, e.g. KITTI Misc.
    Other,
}

impl ObjectClass {
    pub const ALL: [Self; 8] = [
        Self::Car,
        Self::Van,
        Self::Truck,
        Self::Bus,
        Self::Tram,
        Self::Pedestrian,
        Self::Cyclist,
        Self::Other,
    ];

    /// Lower-case name, as stored and as shown to people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Car => "car",
            Self::Van => "van",
            Self::Truck => "truck",
            Self::Bus => "bus",
            Self::Tram => "tram",
            Self::Pedestrian => "pedestrian",
            Self::Cyclist => "cyclist",
            Self::Other => "other",
        }
    }

    /// Whether left and right mirror each other closely enough to supervise each other. People and riders never do.
    pub fn is_symmetric(self) -> bool {
        matches!(self, Self::Car | Self::Van | Self::Bus | Self::Tram)
    }

    /// Whether the class drives on wheels and belongs on the road.
    pub fn is_vehicle(self) -> bool {
        !matches!(self, Self::Pedestrian | Self::Other)
    }
}
