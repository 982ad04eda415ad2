//! Tests of routers with `ble/` links on the simulated air: `cargo test -p rect-router --test behaviour ble`

use crate::support::{arrives, ask, client, simulated, Air, Router};
use serde_json::Value;

#[test]
fn exchanges_messages_over_ble_and_shows_the_link_in_the_admin_space() {
    let air = Air::new();
    let (_one, local) = simulated(&air, 1, &["-i", "a1"]);
    let (_two, remote) = simulated(
        &air,
        2,
        &["-i", "a2", "-e", "ble/wombat-1#adapter=sim-wombat-2"],
    );
    let (local, remote) = (client(&local), client(&remote));
    assert!(arrives(&local, &remote, "rect/wombat-1/arm/angle"));
    assert!(arrives(&remote, &local, "rect/wombat-2/arm/angle"));

    let about = ask(&local, "@/a1/router").expect("an answer").to_string();
    assert!(about.contains("ble/"), "no ble link in {about}");
    let status: Value = ask(&local, "@/a1/router/ble").expect("an answer");
    let link = &status[0]["links"][0];
    assert_eq!(link["peer"], "wombat-2", "{status:#}");
    assert!(link["sent"]["bytes"].as_u64() > Some(100), "{status:#}");
    let lanes = link["lanes"]["lanes"].as_array().expect("lanes in use");
    let data = lanes.iter().find(|lane| lane["priority"] == "Data");
    let received = &data.expect("messages were sent")["received"];
    assert!(received["sdus"].as_u64() > Some(0), "{status:#}");
    assert_eq!(status[0]["peers"][0]["links"], 1, "{status:#}");
}

#[test]
fn reconnects_after_peer_restart() {
    let air = Air::new();
    let (one, local) = simulated(&air, 1, &[]);
    let dial = "ble/wombat-1#adapter=sim-wombat-2";
    let (_two, remote) = simulated(&air, 2, &["-i", "a2", "-e", dial]);
    let remote = client(&remote);
    assert!(arrives(&remote, &client(&local), "rect/wombat-2/x"));
    drop(one);
    let (_one, local) = simulated(&air, 1, &[]);
    assert!(arrives(&remote, &client(&local), "rect/wombat-2/x"));
    let status: Value = ask(&remote, "@/a2/router/ble").expect("an answer");
    let peer = &status[0]["peers"][0];
    assert_eq!(
        (&peer["peer"], &peer["links"]),
        (&"wombat-1".into(), &2.into()),
        "{status:#}"
    );
    assert!(peer["last_end"]["reason"].is_string(), "{status:#}");
}

#[test]
fn a_ble_listener_without_an_adapter_ends_the_router_with_the_reason() {
    let mut router = Router::start(&["--no-multicast-scouting", "-l", "ble/hci77#name=wombat-1"]);
    assert_eq!(router.exit().code(), Some(1));
    let log = router.full_log();
    let message = log
        .lines()
        .find(|line| line.starts_with("rect-router: cannot start: "))
        .expect("a reason");
    assert!(!message.contains(".rs:"), "{message}");
    println!("{message}");
}

#[test]
fn stops_with_status_0_while_linked_over_ble() {
    let air = Air::new();
    let (one, local) = simulated(&air, 1, &[]);
    let (mut two, remote) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    assert!(arrives(
        &client(&remote),
        &client(&local),
        "rect/wombat-2/x"
    ));
    two.up().signal(nix::sys::signal::Signal::SIGTERM);
    assert_eq!(two.exit().code(), Some(0));
    drop(one);
}

/// Zenoh waits for its dials before it closes its sessions.
#[test]
fn stops_in_time_while_it_dials_absent_peers() {
    let air = Air::new();
    let file = tempfile::NamedTempFile::new().expect("a file");
    let away = r#"{ connections: [{ name: "away", method: "ble", address: "wombat-8" }] }"#;
    std::fs::write(&file, away).expect("written");
    let robot = format!(
        r#"plugins/rect:{{ robot: "wombat-1", connections: {:?} }}"#,
        file.path()
    );
    let dials = ["-e", "ble/wombat-9#adapter=sim-wombat-1", "--cfg", &robot];
    let (mut one, _) = simulated(&air, 1, &dials);
    one.up().signal(nix::sys::signal::Signal::SIGTERM);
    assert_eq!(one.exit().code(), Some(0));
    let log = one.full_log();
    assert!(log.lines().any(|line| line.ends_with(": closed")), "{log}");
}
