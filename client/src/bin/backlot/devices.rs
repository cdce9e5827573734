//! `backlot devices`: what this machine can compute on.

use backlot_engine::backend::cpu::CpuBackend;
use backlot_engine::backend::{self, AdapterRecord, Backend};
use serde::Serialize;

use crate::args::Output;
use crate::output::{self, Row, mebibytes, or_dash};

pub(crate) fn run(output: Output) -> anyhow::Result<()> {
    let mut rows = vec![DeviceRow::processor()];
    let adapters = backend::adapters();
    rows.extend(adapters.into_iter().enumerate().map(DeviceRow::adapter));
    output::print(output, &rows)
}

#[derive(Debug, Serialize)]
struct DeviceRow {
    /// What `--device` takes.
    device: String,
    name: String,
    kind: &'static str,
    interface: String,
    driver: String,
    /// Whether `auto` may take it.
    automatic: bool,
    max_buffer_bytes: Option<u64>,
    max_binding_bytes: Option<u64>,
    max_bindings: Option<u32>,
}

impl DeviceRow {
    fn processor() -> Self {
        Self {
            device: "cpu".to_owned(),
            name: CpuBackend.device(),
            kind: "processor",
            interface: String::new(),
            driver: String::new(),
            automatic: true,
            max_buffer_bytes: None,
            max_binding_bytes: None,
            max_bindings: None,
        }
    }

    fn adapter((index, adapter): (usize, AdapterRecord)) -> Self {
        Self {
            device: format!("gpu:{index}"),
            name: adapter.name,
            kind: adapter.kind.name(),
            interface: adapter.interface,
            driver: adapter.driver,
            automatic: adapter.kind.is_gpu(),
            max_buffer_bytes: Some(adapter.max_buffer_bytes),
            max_binding_bytes: Some(adapter.max_binding_bytes),
            max_bindings: Some(adapter.max_bindings),
        }
    }
}

impl Row for DeviceRow {
    const COLUMNS: &'static [&'static str] = &[
        "DEVICE",
        "NAME",
        "KIND",
        "AUTO",
        "INTERFACE",
        "DRIVER",
        "BUFFER",
        "BINDING",
        "BINDINGS",
    ];

    fn cells(&self) -> Vec<String> {
        let bytes = |value: Option<u64>| value.map_or("-".to_owned(), mebibytes);
        vec![
            self.device.clone(),
            self.name.clone(),
            self.kind.to_owned(),
            if self.automatic { "yes" } else { "no" }.to_owned(),
            or_dash(&self.interface),
            or_dash(&self.driver),
            bytes(self.max_buffer_bytes),
            bytes(self.max_binding_bytes),
            self.max_bindings.map_or("-".to_owned(), |n| n.to_string()),
        ]
    }
}
