//! What the host must know of a kernel: its text, its entry point and its bindings.

/// How a kernel sees one buffer of its only bind group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    Uniform,
    Read,
    ReadWrite,
}

/// One buffer of a kernel; its position in [`Kernel::bindings`] is its binding number in group 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Binding {
    /// Name of the WGSL variable.
    pub name: &'static str,
    pub access: Access,
    /// Smallest legal binding in bytes: the struct, or one element of the array.
    pub min_bytes: u64,
}

/// One compute kernel: a WGSL entry point together with the libraries it uses.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Name of the entry point, of its file without the ending, and label of what is made from it.
    pub name: &'static str,
    /// Files under `wgsl/` that `source` is concatenated from.
    pub files: &'static [&'static str],
    /// WGSL text. Module scope has no order in WGSL, so concatenation is all the composition there is.
    pub source: &'static str,
    pub bindings: &'static [Binding],
    /// Threads along x of a workgroup; the override `WORKGROUP_SIZE`.
    pub workgroup_size: u32,
}

impl Kernel {
    /// Values of the kernel's pipeline overrides: constants that host and kernel share.
    pub fn constants(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("BRICK_SIDE", f64::from(crate::BRICK_SIDE)),
            ("WORKGROUP_SIZE", f64::from(self.workgroup_size)),
        ]
    }
}
