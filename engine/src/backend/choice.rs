//! Which device computes: parsing and choosing.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use super::Backend;
use super::adapter::AdapterRecord;
use super::cpu::CpuBackend;
use crate::{Error, Result};

/// A device as written: `auto`, `cpu`, `gpu`, `gpu:N` or `gpu:NAME`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// The best GPU, else the processor. Never a software adapter, which is many times slower than our own code on the same processor.
    #[default]
    Auto,
    Cpu,
    Gpu(AdapterChoice),
}

/// Which of the machine's adapters.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum AdapterChoice {
    /// The best that is a GPU.
    Best,
    /// The position in [`super::adapters`], whatever it is.
    Index(usize),
    /// The first whose name contains this, in any case, whatever it is.
    Name(String),
}

impl AdapterChoice {
    /// Position of the chosen adapter.
    ///
    /// # Errors
    /// Says what there is instead.
    pub fn find(&self, adapters: &[AdapterRecord]) -> Result<usize, String> {
        let (found, wanted) = match self {
            Self::Best => (
                adapters.iter().position(|a| a.kind.is_gpu()),
                "a GPU".to_owned(),
            ),
            Self::Index(index) => {
                let found = (*index < adapters.len()).then_some(*index);
                (found, format!("adapter {index}"))
            }
            Self::Name(name) => {
                let part = name.to_lowercase();
                let named = |a: &AdapterRecord| a.name.to_lowercase().contains(&part);
                (
                    adapters.iter().position(named),
                    format!("an adapter named \"{name}\""),
                )
            }
        };
        found.ok_or_else(|| format!("{wanted} was not found: {}", listed(adapters)))
    }
}

fn listed(adapters: &[AdapterRecord]) -> String {
    if adapters.is_empty() {
        return "there is no adapter (a driver for Vulkan, Metal or Direct3D 12 is needed)"
            .to_owned();
    }
    let each = adapters.iter().enumerate();
    let each: Vec<String> = each
        .map(|(i, a)| format!("gpu:{i} is {} ({})", a.name, a.kind.name()))
        .collect();
    each.join(", ")
}

impl FromStr for DeviceChoice {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self> {
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "cpu" => Ok(Self::Cpu),
            None if text == "gpu" => Ok(Self::Gpu(AdapterChoice::Best)),
            Some(("gpu", which)) if !which.trim().is_empty() => {
                let which = which.trim();
                Ok(Self::Gpu(match which.parse() {
                    Ok(index) => AdapterChoice::Index(index),
                    Err(_) => AdapterChoice::Name(which.to_owned()),
                }))
            }
            _ => Err(Error::invalid(format!(
                "\"{text}\" is not a device: auto, cpu, gpu, gpu:NUMBER or gpu:NAME, as `backlot devices` lists them"
            ))),
        }
    }
}

impl fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu(AdapterChoice::Best) => f.write_str("gpu"),
            Self::Gpu(AdapterChoice::Index(index)) => write!(f, "gpu:{index}"),
            Self::Gpu(AdapterChoice::Name(name)) => write!(f, "gpu:{name}"),
        }
    }
}

/// Opens the chosen device. `memory_bytes` bounds what is kept on a GPU between calls.
///
/// # Errors
/// [`Error::Device`] if a GPU was asked for and there is none or it does not open; `auto` then takes the processor and logs why.
pub fn open(choice: &DeviceChoice, memory_bytes: u64) -> Result<Arc<dyn Backend>> {
    match choice {
        DeviceChoice::Cpu => Ok(Arc::new(CpuBackend)),
        DeviceChoice::Gpu(adapter) => open_gpu(adapter, memory_bytes),
        DeviceChoice::Auto => {
            if !super::adapters().iter().any(|a| a.kind.is_gpu()) {
                return Ok(Arc::new(CpuBackend));
            }
            open_gpu(&AdapterChoice::Best, memory_bytes).or_else(|error| {
                tracing::warn!(%error, "the GPU cannot be used: computing on the processor");
                Ok(Arc::new(CpuBackend) as Arc<dyn Backend>)
            })
        }
    }
}

#[cfg(feature = "gpu")]
fn open_gpu(adapter: &AdapterChoice, memory_bytes: u64) -> Result<Arc<dyn Backend>> {
    let gpu = super::gpu::DurableGpu::open(adapter, memory_bytes)?;
    Ok(Arc::new(gpu))
}

#[cfg(not(feature = "gpu"))]
fn open_gpu(_: &AdapterChoice, _: u64) -> Result<Arc<dyn Backend>> {
    Err(Error::Device {
        what: "this build has no GPU support (cargo feature `gpu`)".to_owned(),
    })
}

#[cfg(test)]
mod tests {
    use super::super::adapter::AdapterKind;
    use super::*;

    fn adapter(name: &str, kind: AdapterKind) -> AdapterRecord {
        AdapterRecord {
            name: name.to_owned(),
            interface: "Vulkan".to_owned(),
            driver: String::new(),
            kind,
            max_buffer_bytes: 1 << 31,
            max_binding_bytes: 1 << 27,
            max_bindings: 32,
        }
    }

    #[test]
    fn every_form_reads_back_and_others_are_refused() {
        for text in ["auto", "cpu", "gpu", "gpu:3", "gpu:NVIDIA RTX"] {
            let choice: DeviceChoice = text.parse().unwrap();
            assert_eq!(choice.to_string(), text);
        }
        for text in ["", "GPU", "gpu:", "gpu: ", "cuda", "cpu:0", "auto:1"] {
            let error = text.parse::<DeviceChoice>().unwrap_err().to_string();
            assert!(error.contains("backlot devices"), "{text}: {error}");
        }
    }

    #[test]
    fn the_best_is_never_a_software_adapter_and_a_named_one_may_be() {
        let software = adapter("llvmpipe (LLVM 15)", AdapterKind::Software);
        let alone = [software.clone()];
        let error = AdapterChoice::Best.find(&alone).unwrap_err();
        assert!(error.contains("gpu:0 is llvmpipe"), "{error}");
        assert_eq!(
            AdapterChoice::Name("LLVMpipe".into()).find(&alone).unwrap(),
            0
        );
        assert_eq!(AdapterChoice::Index(0).find(&alone).unwrap(), 0);
        let both = [adapter("Radeon 780M", AdapterKind::Integrated), software];
        assert_eq!(AdapterChoice::Best.find(&both).unwrap(), 0);
        assert_eq!(AdapterChoice::Name("pipe".into()).find(&both).unwrap(), 1);
        assert!(AdapterChoice::Index(2).find(&both).is_err());
        assert!(AdapterChoice::Name("geforce".into()).find(&both).is_err());
        assert!(
            AdapterChoice::Best
                .find(&[])
                .unwrap_err()
                .contains("no adapter")
        );
    }

    #[test]
    fn the_processor_opens_anywhere() {
        let backend = open(&DeviceChoice::Cpu, 0).unwrap();
        assert_eq!(backend.name(), "cpu");
        let missing = open(&DeviceChoice::Gpu(AdapterChoice::Index(usize::MAX)), 0).unwrap_err();
        assert_eq!(missing.kind(), crate::ErrorKind::Unavailable);
    }
}
