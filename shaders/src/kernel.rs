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
    /// Smallest legal binding in bytes: the struct, or one element of a storage array, or a whole uniform array.
    pub min_bytes: u64,
}

/// One compute kernel: a WGSL entry point together with the libraries it uses.
#[derive(Clone, Copy, Debug)]
pub struct Kernel {
    /// Label of what is made from it; the entry point's name unless the kernel is a variant of another.
    pub name: &'static str,
    /// Name of the entry point and of its file without the ending.
    pub entry: &'static str,
    /// Files under `wgsl/` that `source` is concatenated from.
    pub files: &'static [&'static str],
    /// WGSL text. Module scope has no order in WGSL, so concatenation is all the composition there is.
    pub source: &'static str,
    pub bindings: &'static [Binding],
    /// Threads along x of a workgroup; the override `WORKGROUP_SIZE`.
    pub workgroup_size: u32,
    /// Overrides whose values differ from pipeline to pipeline.
    pub parameters: &'static [&'static str],
    /// Whether threads take what others of their subgroup have read: it then must have [`crate::SUBGROUP`] threads at least.
    pub uses_subgroup: bool,
}

impl Kernel {
    /// Values of the overrides that are the same in every pipeline: constants that host and kernel share.
    pub fn constants(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("BRICK_SIDE", f64::from(crate::BRICK_SIDE)),
            ("NODES_PER_BRICK", f64::from(crate::NODES_PER_BRICK)),
            ("WORKGROUP_SIZE", f64::from(self.workgroup_size)),
        ]
    }
}

/// A kernel of this name concatenated from these files, whose endings are left out. Its bindings and size are still to be set.
macro_rules! kernel_of {
    ($name:literal, $($file:literal),+ $(,)?) => {
        $crate::kernel::Kernel {
            name: $name,
            entry: $name,
            files: &[$(concat!($file, ".wgsl")),+],
            source: concat!($(include_str!(concat!("../wgsl/", $file, ".wgsl"))),+),
            bindings: &[],
            workgroup_size: 1,
            parameters: &[],
            uses_subgroup: false,
        }
    };
}

pub(crate) use kernel_of;
