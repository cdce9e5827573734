//! What computes on this machine besides the processor.

/// What an adapter is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AdapterKind {
    Discrete,
    Integrated,
    Virtual,
    /// A driver that runs kernels on the processor, like Mesa's lavapipe.
    Software,
    Unknown,
}

impl AdapterKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::Software => "software",
            Self::Unknown => "unknown",
        }
    }

    /// Whether this is a GPU, and not the processor in disguise.
    pub fn is_gpu(self) -> bool {
        matches!(self, Self::Discrete | Self::Integrated | Self::Virtual)
    }
}

/// An adapter as its driver describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterRecord {
    pub name: String,
    /// The interface it is reached through: Vulkan, Metal, Direct3D 12.
    pub interface: String,
    /// Name and version; may be empty.
    pub driver: String,
    pub kind: AdapterKind,
    /// Largest buffer in bytes.
    pub max_buffer_bytes: u64,
    /// Largest part of a buffer that a kernel can see at once, bytes.
    pub max_binding_bytes: u64,
    /// Storage buffers that a kernel can see at once.
    pub max_bindings: u32,
}

/// The adapters of this machine, best kind first: their positions are the numbers that `gpu:N` means. Empty in a build without GPUs.
pub fn adapters() -> Vec<AdapterRecord> {
    found()
}

#[cfg(feature = "gpu")]
fn found() -> Vec<AdapterRecord> {
    super::gpu::adapters()
}

#[cfg(not(feature = "gpu"))]
fn found() -> Vec<AdapterRecord> {
    Vec::new()
}
