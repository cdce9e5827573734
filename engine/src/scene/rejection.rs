//! Why a placement attempt was dropped; counted and returned with every sample.

use super::valid_region::Unsupported;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Rejection {
    /// No free place of the kind asked for at the drawn distance in the camera's view.
    NoFreePlace,
    /// No asset can be what the recipe's distributions drew.
    NoAsset,
    Unseen,
    Blocked,
    Uneven,
    Distance,
    /// The ground slopes less than asked for.
    TooFlat,
    OutOfView,
    Truncated,
    TooSmall,
    Coverage,
    CollidesPlaced,
    CollidesOriginal,
    CollidesEgo,
    /// The object itself stands nearby, as an original or already inserted.
    Duplicate,
    Occluded,
    /// Asked for an object that the environment hides in part, and it does not.
    NotOccluded,
    HidesPlaced,
    /// Asked to replace an original of another size.
    SizeMismatch,
    /// An original whose box holds the camera: it is not shown.
    CameraInside,
    /// All attempts of a slot failed: the sample has an object less.
    GaveUp,
    /// A given object cannot stand where the recipe says and is left out, or an original cannot be moved there and stays.
    GivenRefused,
}

impl Rejection {
    /// Stable name, as returned in samples and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoFreePlace => "no_free_place",
            Self::NoAsset => "no_asset",
            Self::Unseen => "unseen",
            Self::Blocked => "blocked",
            Self::Uneven => "uneven",
            Self::Distance => "distance",
            Self::TooFlat => "too_flat",
            Self::OutOfView => "out_of_view",
            Self::Truncated => "truncated",
            Self::TooSmall => "too_small",
            Self::Coverage => "coverage",
            Self::CollidesPlaced => "collides_placed",
            Self::CollidesOriginal => "collides_original",
            Self::CollidesEgo => "collides_ego",
            Self::Duplicate => "duplicate",
            Self::Occluded => "occluded",
            Self::NotOccluded => "not_occluded",
            Self::HidesPlaced => "hides_placed",
            Self::SizeMismatch => "size_mismatch",
            Self::CameraInside => "camera_inside",
            Self::GaveUp => "gave_up",
            Self::GivenRefused => "given_refused",
        }
    }
}

impl From<Unsupported> for Rejection {
    fn from(reason: Unsupported) -> Self {
        match reason {
            Unsupported::Unseen => Self::Unseen,
            Unsupported::Blocked => Self::Blocked,
            Unsupported::Uneven => Self::Uneven,
        }
    }
}
