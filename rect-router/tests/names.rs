//! Which robot a link leads to, and two robots with one name, over TCP: `cargo test -p rect-router --test names`

mod support;

use std::time::{Duration, Instant};

use serde_json::{json, Value};
use support::{answers, client, rect_router, said, Router, DEADLINE};
use zenoh::Wait;

/// A robot's router on loopback, connected to these.
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
fn a_new_link_is_published_with_its_robot_and_never_without() {
    let (_one, here) = robot("wombat-1", &[]);
    let session = client(&here);
    let own = session.zid().to_string();
    let published = session
        .declare_subscriber("rect/wombat-1/@rect/connections")
        .wait()
        .expect("subscribes");
    // It comes, goes and comes again.
    for _ in 0..3 {
        let (_two, _) = robot("wombat-2", &[&here]);
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
fn a_second_robot_of_the_same_name_is_reported_by_both() {
    let (mut one, here) = robot("wombat-1", &[]);
    let (mut two, there) = robot("wombat-1", &[&here]);
    for (router, endpoint) in [(&mut one, &here), (&mut two, &there)] {
        router.wait_for("has this robot's name");
        let session = client(endpoint);
        answers(&session, "rect/wombat-1/@rect/status", |status| {
            status["same_name"].as_array().map(Vec::len) == Some(1)
        });
    }
    let doctor = rect_router(&["doctor", "--router", &here]);
    let told = said(&doctor);
    assert!(
        told.contains("more than one robot is called wombat-1"),
        "{told}"
    );
    drop(two);
    one.wait_for("with this robot's name is gone");
}
