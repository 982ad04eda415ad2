//! Who may say what over the air, as the shipped configurations and their README have it:
//! `cargo test -p rect-router --test access`

mod support;

use std::{
    fs,
    time::{Duration, Instant},
};

use serde_json::json;
use support::{arrives, ask, change, init, program, start, Air, DEADLINE};
use zenoh::Wait;

#[test]
fn a_robot_speaks_for_itself_only_and_a_base_station_changes_its_settings() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let robot = init(root.path(), "wombat-1", &[]);
    let users = format!("{robot}/users");
    let other = init(root.path(), "wombat-2", &["--users", &users]);
    let base = init(root.path(), "base", &["--users", &users, "--base-station"]);
    let dial =
        json!({ "connections": [{ "name": "robot", "method": "ble", "address": "wombat-1" }] });
    for folder in [&other, &base] {
        fs::write(format!("{folder}/connections.json"), dial.to_string()).expect("written");
    }
    let (_robot, here) = start(&air, &robot, "wombat-1", "fleet");
    let (_other, there) = start(&air, &other, "wombat-2", "fleet");
    let (_base, laptop) = start(&air, &base, "base", "config");
    let (here, there) = (program(&robot, &here), program(&other, &there));
    let laptop = program(&base, &laptop);

    // Under its own name what it says arrives; under another's, or nobody's, it does not leave its robot.
    assert!(arrives(&there, &here, "rect/wombat-2/arm/angle"));
    let heard = here.declare_subscriber("**").wait().expect("subscribes");
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "nothing arrives");
        for key in ["rect/wombat-1/arm/angle", "rect/wombat-3/stop", "demo/x"] {
            there.put(key, "not mine").wait().expect("a put");
        }
        there
            .put("rect/wombat-2/mark", "mine")
            .wait()
            .expect("a put");
        // In order: had one of the others passed, it would be here first.
        if let Ok(Some(sample)) = heard.recv_timeout(Duration::from_millis(200)) {
            assert_eq!(sample.key_expr().as_str(), "rect/wombat-2/mark");
            break;
        }
    }

    let settings = "rect/wombat-1/@rect/@config/connections";
    let read = ask(&laptop, settings).expect("may read them");
    let text = read["text"].as_str().expect("a text").to_owned();
    assert!(text.contains("\"connections\""), "{text}");
    let changed = change(&laptop, settings, &text.replace('[', "[ "));
    let changed = changed.expect("an answer").expect("is taken");
    assert!(changed["revision"].is_string(), "{changed:#}");
    assert!(
        change(&there, settings, &text).is_none(),
        "another robot may"
    );
    let now = ask(&laptop, settings).expect("may read them");
    assert_eq!(now["text"], text.replace('[', "[ "));
}
