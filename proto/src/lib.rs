//! The wire contract of Backlot: generated `backlot.v1` messages, clients, servers and the descriptor set.

/// Messages, clients and servers of package `backlot.v1`.
pub mod v1 {
    tonic::include_proto!("backlot.v1");
}

/// The serialised `FileDescriptorSet` of the package, for reflection.
pub const FILE_DESCRIPTOR_SET: &[u8] =
    include_bytes!(concat!(env!("OUT_DIR"), "/backlot_descriptor.bin"));
