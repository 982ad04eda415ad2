//! Tests of the systemd unit: `cargo test -p rect-router --test behaviour systemd_unit`

use std::{collections::BTreeMap, fs, process::Command};

use crate::support::{repository, skip};

const INSTALLED: &str = "/usr/bin/rect-router";

fn unit() -> String {
    fs::read_to_string(repository().join("packaging/systemd/rect-router.service"))
        .expect("the unit")
}

#[test]
fn systemd_accepts_the_unit() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("rect-router.service");
    // The unit must name an existing program, so the path of the installed one is replaced.
    fs::write(
        &file,
        unit().replace(INSTALLED, env!("CARGO_BIN_EXE_rect-router")),
    )
    .expect("written");
    let output = match Command::new("systemd-analyze")
        .args(["verify", "--man=no"])
        .arg(&file)
        .output()
    {
        Ok(output) => output,
        Err(error) => return skip(&format!("systemd-analyze: {error}")),
    };
    let messages = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{messages}");
    assert!(!messages.contains("rect-router.service"), "{messages}");
}

#[test]
fn the_unit_grants_only_the_required_privileges() {
    let unit = unit();
    let settings: BTreeMap<&str, &str> = unit
        .lines()
        .filter(|line| !line.starts_with('#'))
        .filter_map(|line| line.split_once('='))
        .collect();
    assert_eq!(settings["Restart"], "on-failure");
    assert_eq!(settings["Type"], "notify");
    assert_eq!(settings["User"], "rect");
    assert_eq!(settings["SupplementaryGroups"], "bluetooth");
    // The router gives it up at its start (`privileges.rs`).
    assert_eq!(settings["CapabilityBoundingSet"], "CAP_NET_ADMIN");
    assert_eq!(settings["AmbientCapabilities"], "CAP_NET_ADMIN");
    for family in ["AF_UNIX", "AF_INET", "AF_BLUETOOTH"] {
        assert!(
            settings["RestrictAddressFamilies"].contains(family),
            "{family}"
        );
    }
}

#[test]
fn the_router_accepts_the_command_line_of_the_unit() {
    let unit = unit();
    let line = unit
        .lines()
        .find_map(|line| line.strip_prefix("ExecStart="))
        .expect("a command");
    let mut words = line.split(' ');
    assert_eq!(words.next(), Some(INSTALLED));
    // `--version` ends the router once the flags are parsed.
    let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .args(words)
        .arg("--version")
        .output()
        .expect("it starts");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}
