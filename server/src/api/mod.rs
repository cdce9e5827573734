//! The wire: conversions between `backlot.v1` messages and the domain, and the gRPC services.

pub mod convert_drive_log;
