//! Where steps of training on dense grids are taken.

use super::cpu::Simd;
#[cfg(feature = "gpu")]
use super::gpu::GpuBackend;

/// A device for [`crate::train::train_dvgo`].
#[derive(Clone, Debug)]
pub struct GridDevice {
    pub(crate) on: GridOn,
}

#[derive(Clone, Debug)]
pub(crate) enum GridOn {
    Cpu(GridArithmetic),
    #[cfg(feature = "gpu")]
    Gpu(Box<GpuBackend>),
}

/// How the processor computes.
#[derive(Clone, Copy, Debug)]
pub(crate) enum GridArithmetic {
    /// As this machine is fastest: its colour network is rounded to bfloat16 where that is an instruction.
    Fastest,
    /// In f32 on a path of instructions.
    InF32(Simd),
}

impl GridDevice {
    /// The processor.
    pub fn cpu() -> Self {
        Self::on(GridOn::Cpu(GridArithmetic::Fastest))
    }

    /// The processor in f32 on a path of instructions.
    pub fn cpu_in_f32(simd: Simd) -> Self {
        Self::on(GridOn::Cpu(GridArithmetic::InF32(simd)))
    }

    #[cfg(feature = "gpu")]
    pub fn gpu(gpu: GpuBackend) -> Self {
        Self::on(GridOn::Gpu(Box::new(gpu)))
    }

    fn on(on: GridOn) -> Self {
        Self { on }
    }
}
