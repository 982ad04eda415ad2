//! Tests of RECT as a plugin of an unmodified zenohd, on the simulated air. `scripts/build-for-tests` builds the plugin, and
//! `scripts/build-stock-zenohd` the zenohd: `scripts/test zenohds stock`.

use std::path::PathBuf;

use crate::support::{
    answers, arrives, built, cache, client, free_socket, http_get, skip, Air, Router,
};
use serde_json::{json, Value};

/// The host of RECT.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Host {
    RectRouter,
    StockZenohd,
}
use Host::{RectRouter, StockZenohd};

/// Returns the paths of a stock zenohd and of the plugin, or `None` if they have not been built.
fn zenohd_and_plugin() -> Option<(PathBuf, PathBuf)> {
    let zenohd = cache().join("stock-zenohd/bin/zenohd");
    let plugin = built().join("libzenoh_plugin_rect.so");
    if zenohd.exists() && plugin.exists() {
        return Some((zenohd, plugin));
    }
    skip(&format!(
        "no {} or {}; see the beginning of this file",
        zenohd.display(),
        plugin.display()
    ));
    None
}

/// Starts a robot with the same settings in either host, and returns it with the endpoint for programs.
fn wombat(air: &Air, host: Host, number: u32, more: &Value) -> (Router, String) {
    let mut settings = json!({
        "robot": format!("wombat-{number}"),
        "listen": [format!("ble/sim-wombat-{number}#name=wombat-{number}")],
    });
    for (key, value) in more.as_object().into_iter().flatten() {
        settings[key] = value.clone();
    }
    let settings = cfg(&settings);
    let common = ["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"];
    let common = common
        .into_iter()
        .chain(settings.iter().map(String::as_str));
    let mut router = match (host, zenohd_and_plugin()) {
        (StockZenohd, Some((zenohd, plugin))) => {
            let plugin = format!("rect:{}", plugin.display());
            let args: Vec<_> = ["-P", &plugin].into_iter().chain(common).collect();
            Router::start_program_on(air, &zenohd, &args)
        }
        _ => Router::start_on(air, &common.collect::<Vec<_>>()),
    };
    let endpoint = router.listener();
    if host == RectRouter {
        // The Bluetooth listener is logged first.
        return match endpoint.starts_with("tcp/") {
            true => (router, endpoint),
            false => {
                let endpoint = router.listener();
                (router, endpoint)
            }
        };
    }
    (router, endpoint)
}

/// Returns the settings as one flag each. A single flag for all would overwrite what `-P` sets.
fn cfg(settings: &Value) -> Vec<String> {
    let fields = settings.as_object().into_iter().flatten();
    let flag = |(key, value): (&String, &Value)| {
        ["--cfg".to_owned(), format!("plugins/rect/{key}:{value}")]
    };
    fields.flat_map(flag).collect()
}

/// Writes a connections file with one connection to `wombat-1` by Bluetooth, and returns the setting for it.
fn to_first(folder: &tempfile::TempDir) -> Value {
    let path = folder.path().join("connections.json");
    let connections = json!({ "connections": [
        { "name": "first", "method": "ble", "address": "wombat-1" },
    ] });
    std::fs::write(&path, connections.to_string()).expect("written");
    json!({ "connections": path })
}

#[test]
fn all_pairs_of_hosts_exchange_messages_and_report_their_connections() {
    if zenohd_and_plugin().is_none() {
        return;
    }
    for (first, second) in [
        (RectRouter, RectRouter),
        (RectRouter, StockZenohd),
        (StockZenohd, RectRouter),
        (StockZenohd, StockZenohd),
    ] {
        println!("{first:?} and {second:?}");
        let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
        let (_one, local) = wombat(&air, first, 1, &json!({}));
        let (_two, remote) = wombat(&air, second, 2, &to_first(&folder));
        let (local, remote) = (client(&local), client(&remote));
        assert!(arrives(&local, &remote, "rect/wombat-1/arm/angle"));
        assert!(arrives(&remote, &local, "rect/wombat-2/arm/angle"));
        // Query each side from the other one.
        let is_linked = |answer: &Value| {
            answer[0]["state"] == "connected" && answer[0]["peer"]["robot"].is_string()
        };
        let asked = |robot: &str| format!("rect/{robot}/@rect/connections?method=ble");
        let of_second = answers(&local, &asked("wombat-2"), is_linked);
        assert_eq!(of_second[0]["name"], "first", "{of_second:#}");
        assert_eq!(of_second[0]["peer"]["robot"], "wombat-1", "{of_second:#}");
        let of_first = answers(&remote, &asked("wombat-1"), is_linked);
        assert_eq!(of_first[0]["peer"]["robot"], "wombat-2", "{of_first:#}");
        // Programs at the host's own listener are connections, too; the kernel counts their traffic.
        let programs = "rect/wombat-2/@rect/connections?method=tcp";
        answers(&local, programs, |answer| {
            answer[0]["received"]["bytes"].as_u64() > Some(0)
        });
    }
}

#[test]
fn the_stock_rest_plugin_shows_the_registry() {
    let Some((zenohd, plugin)) = zenohd_and_plugin() else {
        return;
    };
    let folder = plugin.parent().expect("a folder").display().to_string();
    if !plugin.with_file_name("libzenoh_plugin_rest.so").exists() {
        return skip("no REST plugin; run scripts/build-for-tests");
    }
    let (air, socket) = (Air::new(), free_socket());
    let plugin = format!("rect:{}", plugin.display());
    let settings = cfg(&json!({ "robot": "wombat-1", "listen": ["ble/sim-1#name=wombat-1"] }));
    let rest = ["--plugin-search-dir", &folder, "--rest-http-port", &socket];
    let args = [
        "-P",
        &plugin,
        "-l",
        "tcp/127.0.0.1:0",
        "--no-multicast-scouting",
        "-i",
        "abc",
    ];
    let settings = settings.iter().map(String::as_str);
    let args: Vec<_> = args.into_iter().chain(rest).chain(settings).collect();
    let _host = Router::start_program_on(&air, &zenohd, &args);
    let count = http_get(&socket, "/rect/wombat-1/@rect/connections/count");
    assert!(count.contains("\"ble\""), "{count}");
    // The host's admin space reports the plugin's router.
    let status = http_get(&socket, "/@/abc/router/**");
    assert!(
        status.contains("/plugins/rect/router") && status.contains("trouble"),
        "{status}"
    );
}

#[test]
fn reconnects_after_either_side_restarts() {
    if zenohd_and_plugin().is_none() {
        return;
    }
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let settings = to_first(&folder);
    let (one, _) = wombat(&air, StockZenohd, 1, &json!({}));
    let (two, remote) = wombat(&air, StockZenohd, 2, &settings);
    let session = client(&remote);
    drop(one);
    let (_one, local) = wombat(&air, StockZenohd, 1, &json!({}));
    assert!(arrives(&session, &client(&local), "rect/wombat-2/x"));
    drop((session, two));
    let (_two, remote) = wombat(&air, StockZenohd, 2, &settings);
    assert!(arrives(
        &client(&local),
        &client(&remote),
        "rect/wombat-1/x"
    ));
}

#[test]
fn reports_why_the_plugin_cannot_start_and_keeps_the_host_running() {
    let Some((zenohd, plugin)) = zenohd_and_plugin() else {
        return;
    };
    let air = Air::new();
    let plugin = format!("rect:{}", plugin.display());
    let start = |settings: &Value, listen: &str| {
        let settings = cfg(settings);
        let args = ["-P", &plugin, "--no-multicast-scouting", "--cfg", listen];
        let settings = settings.iter().map(String::as_str);
        let args: Vec<_> = args.into_iter().chain(settings).collect();
        Router::start_program_on(&air, &zenohd, &args)
    };
    let tcp = "listen/endpoints:['tcp/127.0.0.1:0']";
    let mut wrong = start(&json!({ "robot": "a", "listen": ["ble/nowhere"] }), tcp);
    let endpoint = wrong.listener();
    let message = wrong.wait_for("rect: cannot start: ");
    assert!(message.contains("`nowhere` is not an adapter"), "{message}");
    client(&endpoint);
    let mut alone = start(&json!({ "robot": "a" }), "listen/endpoints:[]");
    let message = alone.wait_for("rect: this zenohd has no listener");
    assert!(message.contains("-l tcp/127.0.0.1:7447"), "{message}");
    // A required plugin with invalid settings ends zenohd, like any other required plugin that fails.
    let mut unread = start(&json!({ "robot": "a b" }), tcp);
    unread.exit();
    assert!(unread.full_log().contains("robot: the name \"a b\""));
}

/// Returns the bytes of the plugin with each `is` replaced by `becomes`.
fn patched(plugin: &[u8], is: &str, becomes: &str) -> Vec<u8> {
    let mut bytes = plugin.to_vec();
    let places: Vec<_> = (0..bytes.len() - is.len())
        .filter(|at| bytes[*at..].starts_with(is.as_bytes()))
        .collect();
    assert!(!places.is_empty(), "{is} is not in the plugin");
    for at in places {
        bytes[at..at + becomes.len()].copy_from_slice(becomes.as_bytes());
    }
    bytes
}

#[test]
fn rejects_a_plugin_of_another_build_and_names_both_versions() {
    let Some((zenohd, plugin)) = zenohd_and_plugin() else {
        return;
    };
    let plugin = std::fs::read(plugin).expect("read");
    let folder = tempfile::tempdir().expect("a folder");
    for (ours, another) in [
        ("v1.10.2-release", "v1.10.3-release"),
        ("zenoh/auth_usrpwd", "zenoh/auth_usrpwX"),
    ] {
        let path = folder.path().join("libzenoh_plugin_rect.so");
        std::fs::write(&path, patched(&plugin, ours, another)).expect("written");
        let plugin = format!("rect:{}", path.display());
        let settings = "plugins/rect/robot:\"wombat-1\"";
        let args = ["-P", &plugin, "-l", "tcp/127.0.0.1:0", "--cfg", settings];
        let mut router = Router::start_program(&zenohd, &args);
        assert!(!router.exit().success(), "{another} is accepted");
        let log = router.full_log();
        assert!(log.contains(ours) && log.contains(another), "{log}");
    }
}
