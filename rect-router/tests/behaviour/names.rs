//! Tests of robots' names over TCP: the robot of each link, and two robots with one name:
//! `cargo test -p rect-router --test behaviour names`

use std::time::{Duration, Instant};

use crate::support::{answers, client, rect_router, text_of, Router, DEADLINE};
use serde_json::{json, Value};
use zenoh::Wait;

/// Starts the router of a robot on loopback, connected to these endpoints.
fn robot(name: &str, connect: &[&str]) -> (Router, String) {
    let settings = format!("plugins/rect:{}", json!({ "robot": name }));
    let mut args = vec!["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"];
    args.extend(["--cfg", &settings]);
    args.extend(connect.iter().flat_map(|endpoint| ["-e", endpoint]));
    let mut router = Router::start(&args);
    let endpoint = router.listener();
    router.up();
    (router, endpoint)
}

#[test]
fn a_new_link_is_always_published_with_its_robot() {
    let (_one, local) = robot("wombat-1", &[]);
    let session = client(&local);
    let own = session.zid().to_string();
    let published = session
        .declare_subscriber("rect/wombat-1/@rect/connections")
        .wait()
        .expect("subscribes");
    // The robot connects and disconnects several times.
    for _ in 0..3 {
        let (_two, _) = robot("wombat-2", &[&local]);
        let deadline = Instant::now() + DEADLINE;
        loop {
            assert!(Instant::now() < deadline, "the link is not published");
            let Ok(Some(sample)) = published.recv_timeout(Duration::from_secs(1)) else {
                continue;
            };
            let all: Value = serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON");
            let others: Vec<_> = (all.as_array().into_iter().flatten())
                .filter(|one| one["state"] == "connected" && one["peer"]["id"] != own.as_str())
                .collect();
            for one in &others {
                assert_eq!(one["peer"]["robot"], "wombat-2", "{one:#}");
            }
            if !others.is_empty() {
                break;
            }
        }
    }
}

#[test]
fn both_robots_report_a_name_conflict() {
    let (mut one, local) = robot("wombat-1", &[]);
    let (mut two, remote) = robot("wombat-1", &[&local]);
    for (router, endpoint) in [(&mut one, &local), (&mut two, &remote)] {
        router.wait_for("has this robot's name");
        let session = client(endpoint);
        answers(&session, "rect/wombat-1/@rect/status", |status| {
            status["same_name"].as_array().map(Vec::len) == Some(1)
        });
    }
    let doctor = rect_router(&["doctor", "--router", &local]);
    let output = text_of(&doctor);
    assert!(
        output.contains("more than one robot is called wombat-1"),
        "{output}"
    );
    drop(two);
    one.wait_for("with this robot's name has disappeared");
}
