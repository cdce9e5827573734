//! From an uploaded log to what a field is trained on: validation on arrival, then decomposition by workers.

mod violations;

mod hull;
mod image;
mod movers;
mod points;

mod content;
mod validate;
#[cfg(test)]
mod validate_tests;

pub use content::LogBlobs;
pub use validate::{Accepted, validate};
pub use violations::{FieldViolation, Violations};
