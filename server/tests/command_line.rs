//! The server's command line; also makes `cargo test` build the program for the end-to-end tests.

use std::process::{Command, Output};

fn backlotd(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_backlotd"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

#[test]
fn help_names_the_options_of_the_contract() {
    let help = backlotd(&["--help"]);
    let text = String::from_utf8_lossy(&help.stdout);
    assert!(
        help.status.success() && text.contains("--data-dir") && text.contains("--listen"),
        "{help:?}"
    );
}

#[test]
fn a_bad_address_or_option_fails() {
    let folder = tempfile::tempdir().unwrap();
    let data = folder.path().join("data");
    let data = data.to_str().unwrap();
    for arguments in [
        &["--data-dir", data, "--listen", "nowhere"][..],
        &["--data-dir", data, "--colour"],
        &[
            "--data-dir",
            data,
            "--listen",
            "127.0.0.1:0",
            "--device",
            "cuda",
        ],
        &[
            "--data-dir",
            data,
            "--listen",
            "127.0.0.1:0",
            "--device",
            "gpu:99",
        ],
    ] {
        let refused = backlotd(arguments);
        assert!(
            !refused.status.success() && !refused.stderr.is_empty(),
            "{refused:?}"
        );
        assert!(
            !folder.path().join("data/FORMAT").exists(),
            "a refused start made a data directory"
        );
    }
}
