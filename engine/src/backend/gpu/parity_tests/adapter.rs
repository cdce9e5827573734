//! The adapter under test, or the admission that there is none.

use std::io::Write;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::backend::gpu::{Device, Error, GpuBackend};
use crate::backend::{AdapterChoice, Backend};

/// Runs `check` on the machine's adapter and asserts that it dispatched kernels; says so on stderr if there is no adapter.
///
/// # Panics
/// Without an adapter if `BACKLOT_REQUIRE_ADAPTER` is 1.
pub(super) fn on_adapter(test: &str, check: impl FnOnce(&GpuBackend)) {
    static LEFT_OUT: AtomicU32 = AtomicU32::new(0);
    match shared() {
        Ok(gpu) => {
            let before = gpu.dispatch_count();
            check(gpu);
            let dispatched = gpu.dispatch_count() - before;
            assert!(
                dispatched > 0,
                "{test} compared nothing: no kernel was dispatched"
            );
            say(&format!(
                "{test}: {dispatched} kernels dispatched on {}",
                gpu.device()
            ));
        }
        Err(reason) => {
            let required = std::env::var("BACKLOT_REQUIRE_ADAPTER").is_ok_and(|value| value == "1");
            assert!(!required, "BACKLOT_REQUIRE_ADAPTER=1 and {reason}");
            let left_out = LEFT_OUT.fetch_add(1, Ordering::Relaxed) + 1;
            say(&format!(
                "{test}: LEFT OUT, {left_out} parity tests so far: {reason}"
            ));
        }
    }
}

/// Room for the tests' small fields.
const MEMORY_BYTES: u64 = 1 << 30;

/// The adapter under test on a device of its own.
pub(super) fn open() -> Result<GpuBackend, Error> {
    // Whatever kind it is: kernels are tested on software adapters too.
    GpuBackend::open(&AdapterChoice::Index(0), MEMORY_BYTES)
}

/// The adapter under test as if it bound no more than `binding_bytes`.
pub(super) fn open_narrow(binding_bytes: u64) -> Result<GpuBackend, Error> {
    let device = Device::open_narrow(&AdapterChoice::Index(0), binding_bytes)?;
    GpuBackend::on(device, MEMORY_BYTES)
}

/// Opened once: tests run in parallel and a device is not free.
fn shared() -> Result<&'static GpuBackend, String> {
    static SHARED: OnceLock<Result<GpuBackend, String>> = OnceLock::new();
    SHARED
        .get_or_init(|| open().map_err(|error| error.to_string()))
        .as_ref()
        .map_err(Clone::clone)
}

/// Writes past the test harness, which captures `eprintln!` of passing tests.
fn say(line: &str) {
    // A closed stderr must not fail a test.
    let _ = std::io::stderr().write_all(format!("parity: {line}\n").as_bytes());
}
