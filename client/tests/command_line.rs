//! The command line as the README shows it; also makes `cargo test` build the program for the end-to-end tests.

use std::process::{Command, Output};

fn backlot(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_backlot"))
        .args(arguments)
        .output()
        .expect("the program starts")
}

#[test]
fn every_command_of_the_contract_explains_itself() {
    let commands: [&[&str]; 12] = [
        &["logs", "upload"],
        &["logs", "inspect"],
        &["logs", "list"],
        &["logs", "show"],
        &["jobs", "submit"],
        &["jobs", "list"],
        &["jobs", "watch"],
        &["jobs", "cancel"],
        &["assets", "list"],
        &["assets", "show"],
        &["assets", "export"],
        &["assets", "delete"],
    ];
    for command in commands
        .into_iter()
        .chain([&["augment"][..], &["demo"], &["devices"]])
    {
        let help = backlot(&[command, &["--help"]].concat());
        assert!(help.status.success(), "{command:?}: {help:?}");
        assert!(
            String::from_utf8_lossy(&help.stdout).contains("Usage"),
            "{command:?}: {help:?}"
        );
    }
}

#[test]
fn devices_lists_the_processor_and_says_what_auto_takes() {
    let listed = backlot(&["devices", "--output", "json"]);
    assert!(listed.status.success(), "{listed:?}");
    let rows: Vec<serde_json::Value> =
        serde_json::from_slice(&listed.stdout).expect("an array of objects");
    assert_eq!(rows[0]["device"], "cpu");
    for row in &rows[1..] {
        assert_eq!(
            row["automatic"],
            row["kind"] != "software" && row["kind"] != "unknown"
        );
        assert!(row["max_binding_bytes"].as_u64() > Some(0), "{row}");
    }
}

#[test]
fn unknown_commands_and_options_fail() {
    for arguments in [
        &["paint"][..],
        &["assets", "list", "--colour"],
        &["augment", "--count", "many"],
        &["demo", "--out", "x", "--device", "cuda"],
    ] {
        assert_eq!(backlot(arguments).status.code(), Some(2), "{arguments:?}");
    }
}
