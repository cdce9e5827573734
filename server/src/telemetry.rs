//! Logging to standard error. `BACKLOT_LOG` filters it, e.g. `backlot_server=debug`; `BACKLOT_LOG_FORMAT=json` makes it JSON.

use std::io::IsTerminal;

use tracing_subscriber::EnvFilter;

/// Levels without `BACKLOT_LOG`: what an operator wants to see. sled and the HTTP/2 stack say nothing of use at `info`.
const DEFAULT_FILTER: &str = "warn,backlot_server=info,backlot_engine=info,backlotd=info";

/// Installs the subscriber of the process; a second call changes nothing.
pub fn init() {
    let filter =
        EnvFilter::try_from_env("BACKLOT_LOG").unwrap_or_else(|_| EnvFilter::new(DEFAULT_FILTER));
    let builder = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_ansi(std::io::stderr().is_terminal())
        .with_writer(std::io::stderr);
    let json = std::env::var("BACKLOT_LOG_FORMAT").is_ok_and(|format| format == "json");
    // An embedding program may have its own subscriber; that one stays.
    let _ = if json {
        builder.json().try_init()
    } else {
        builder.try_init()
    };
}
