//! Driving logs between the wire and the domain.

mod depth;
mod fields;
mod from_wire;
mod to_wire;

pub(crate) use fields::{FieldReader, Place, object_class_from_wire};
pub use from_wire::drive_log_from_wire;
pub use to_wire::{drive_log_to_wire, object_class_to_wire};
pub(crate) use to_wire::{rigid_to_wire, vector_to_wire};
