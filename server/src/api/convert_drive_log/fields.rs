//! Reading wire fields, naming whatever is missing or not finite.

use backlot_engine::camera::Rigid;
use backlot_engine::class::ObjectClass;
use backlot_proto::v1;
use glam::{DQuat, DVec3};

use crate::domain::blob::{BlobRef, Digest, DigestError};
use crate::ingest::Violations;

/// Quaternions further than this from unit length are rejected: they are not rotations with rounding errors.
const UNIT_TOLERANCE: f64 = 1e-3;

/// A place in the message, with the camera frame it belongs to for people.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub path: String,
    /// E.g. "camera image_02, frame 37"; empty if the path says it all.
    pub who: String,
}

impl Place {
    pub(crate) fn new(path: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            who: String::new(),
        }
    }

    pub(crate) fn of(path: impl Into<String>, who: impl Into<String>) -> Self {
        Self {
            path: path.into(),
            who: who.into(),
        }
    }

    pub(crate) fn field(&self, name: &str) -> Self {
        Self {
            path: format!("{}.{name}", self.path),
            who: self.who.clone(),
        }
    }
}

/// Collects what is wrong while fields are read; the values it returns for broken fields are never used.
#[derive(Debug, Default)]
pub(crate) struct FieldReader {
    pub violations: Violations,
}

impl FieldReader {
    pub(crate) fn reject(&mut self, place: &Place, what: &str) {
        let description = if place.who.is_empty() {
            what.to_owned()
        } else {
            format!("({}) {what}", place.who)
        };
        self.violations.push(place.path.clone(), description);
    }

    pub(crate) fn required<T>(&mut self, place: &Place, value: Option<T>) -> Option<T> {
        if value.is_none() {
            self.reject(place, "is missing");
        }
        value
    }

    pub(crate) fn finite(&mut self, place: &Place, value: f64) -> f64 {
        if !value.is_finite() {
            self.reject(place, &format!("is {value}"));
        }
        value
    }

    pub(crate) fn vector(&mut self, place: &Place, value: Option<v1::Vector3>) -> DVec3 {
        let Some(v) = self.required(place, value) else {
            return DVec3::ZERO;
        };
        DVec3::new(
            self.finite(&place.field("x"), v.x),
            self.finite(&place.field("y"), v.y),
            self.finite(&place.field("z"), v.z),
        )
    }

    pub(crate) fn rigid(&mut self, place: &Place, value: Option<v1::RigidTransform>) -> Rigid {
        let Some(transform) = self.required(place, value) else {
            return Rigid::IDENTITY;
        };
        let rotation_at = place.field("rotation");
        let rotation = match self.required(&rotation_at, transform.rotation) {
            Some(q) => self.unit_quaternion(&rotation_at, q),
            None => DQuat::IDENTITY,
        };
        let translation_m = self.vector(&place.field("translation_m"), transform.translation_m);
        Rigid::new(rotation, translation_m)
    }

    fn unit_quaternion(&mut self, place: &Place, q: v1::Quaternion) -> DQuat {
        for (name, value) in [("w", q.w), ("x", q.x), ("y", q.y), ("z", q.z)] {
            self.finite(&place.field(name), value);
        }
        let rotation = DQuat::from_xyzw(q.x, q.y, q.z, q.w);
        let norm = rotation.length();
        if norm.is_finite() && (norm - 1.0).abs() > UNIT_TOLERANCE {
            self.reject(place, &format!("has norm {norm:.4}, not 1"));
        }
        rotation.normalize()
    }

    pub(crate) fn blob(&mut self, place: &Place, value: Option<v1::BlobRef>) -> BlobRef {
        match self.required(place, value) {
            Some(blob) => self.blob_ref(place, blob),
            None => BlobRef::of(&[]),
        }
    }

    pub(crate) fn blob_ref(&mut self, place: &Place, blob: v1::BlobRef) -> BlobRef {
        let digest = blob.digest.parse().unwrap_or_else(|error: DigestError| {
            self.reject(&place.field("digest"), &error.to_string());
            Digest::of(&[])
        });
        BlobRef {
            digest,
            size_bytes: blob.size_bytes,
        }
    }

    pub(crate) fn object_class(&mut self, place: &Place, value: i32) -> ObjectClass {
        match object_class_from_wire(value) {
            Some(class) => class,
            None => {
                self.reject(place, &format!("is {value}, not an ObjectClass"));
                ObjectClass::Other
            }
        }
    }
}

pub(crate) fn object_class_from_wire(value: i32) -> Option<ObjectClass> {
    match v1::ObjectClass::try_from(value).ok()? {
        v1::ObjectClass::Unspecified => None,
        v1::ObjectClass::Car => Some(ObjectClass::Car),
        v1::ObjectClass::Van => Some(ObjectClass::Van),
        v1::ObjectClass::Truck => Some(ObjectClass::Truck),
        v1::ObjectClass::Bus => Some(ObjectClass::Bus),
        v1::ObjectClass::Tram => Some(ObjectClass::Tram),
        v1::ObjectClass::Pedestrian => Some(ObjectClass::Pedestrian),
        v1::ObjectClass::Cyclist => Some(ObjectClass::Cyclist),
        v1::ObjectClass::Other => Some(ObjectClass::Other),
    }
}
