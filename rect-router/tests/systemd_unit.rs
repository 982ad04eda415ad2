//! The systemd unit is one that systemd takes: `cargo test -p rect-router --test systemd_unit`

mod support;

use std::{collections::BTreeMap, fs, process::Command};

use support::{repository, skip};

const INSTALLED: &str = "/usr/bin/rect-router";

fn unit() -> String {
    fs::read_to_string(repository().join("packaging/systemd/rect-router.service"))
        .expect("the unit")
}

#[test]
fn systemd_finds_nothing_wrong_with_it() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("rect-router.service");
    // The program is not installed here; the unit must name one that is.
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
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    assert!(!said.contains("rect-router.service"), "{said}");
}

#[test]
fn it_says_what_the_router_needs_and_no_more() {
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
    assert_eq!(settings["CapabilityBoundingSet"], "");
    for family in ["AF_UNIX", "AF_INET", "AF_BLUETOOTH"] {
        assert!(
            settings["RestrictAddressFamilies"].contains(family),
            "{family}"
        );
    }
}

#[test]
fn the_router_understands_its_command_line() {
    let unit = unit();
    let line = unit
        .lines()
        .find_map(|line| line.strip_prefix("ExecStart="))
        .expect("a command");
    let mut words = line.split(' ');
    assert_eq!(words.next(), Some(INSTALLED));
    // `--version` ends it once the flags are read.
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
