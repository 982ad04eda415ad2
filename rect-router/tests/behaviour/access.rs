//! Tests of the access control in the shipped configurations and in `docs/how-to/security.md`:
//! `cargo test -p rect-router --test behaviour access`

use std::{
    fs,
    time::{Duration, Instant},
};

use crate::support::{
    answers, arrives, ask, change, init, program, repository, start, start_with, Air, DEADLINE,
};
use rect::{blocking, Error, Options, ReceiveOptions, Topic};
use rect_core::{
    message::encoding::Encoding,
    name::Name,
    transfer::{offer::FileName, Checksum, Offer},
};
use serde_json::{json, Value};
use zenoh::{Session, Wait};

#[test]
fn connecting_with_another_robots_name_or_without_a_login_fails() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let robot = init(root.path(), "wombat-1", &[]);
    let (_router, endpoint) = start(&air, &robot, "wombat-1", "fleet");
    let users = format!("{robot}/users");
    let join = |name: &str, users: &str| {
        let options = Options::new(name).expect("a name").login_file(users);
        blocking::Robot::connect(options.router(&endpoint))
    };
    join("wombat-1", &users).expect("joined");
    let wrong = join("wombat-7", &users).expect_err("another robot's router");
    assert!(matches!(wrong, Error::WrongRobot(_)), "{wrong}");
    let refused = join("wombat-1", "/none").expect_err("no login");
    assert!(matches!(refused, Error::LoginRefused(_)), "{refused}");
}

#[test]
fn a_robot_publishes_under_its_own_name_only_and_a_base_station_changes_its_connections() {
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
    let (_robot, local) = start(&air, &robot, "wombat-1", "fleet");
    let (_other, remote) = start(&air, &other, "wombat-2", "fleet");
    let (_base, laptop) = start(&air, &base, "base", "config");
    let (local, remote) = (program(&robot, &local), program(&other, &remote));
    let laptop = program(&base, &laptop);

    // Messages under the robot's own name arrive; messages under other keys do not leave the robot.
    assert!(arrives(&remote, &local, "rect/wombat-2/arm/angle"));
    let foreign_keys = ["rect/wombat-1/arm/angle", "rect/wombat-3/stop", "demo/x"];
    receives_only(&local, &remote, &foreign_keys, "rect/wombat-2/mark");

    let settings = "rect/wombat-1/@rect/@config/connections";
    let read = ask(&laptop, settings).expect("the base station may read them");
    let text = read["text"].as_str().expect("a text").to_owned();
    assert!(text.contains("\"connections\""), "{text}");
    let changed = change(&laptop, settings, &text.replace('[', "[ "));
    let changed = changed.expect("an answer").expect("is taken");
    assert!(changed["revision"].is_string(), "{changed:#}");
    assert!(
        change(&remote, settings, &text).is_none(),
        "another robot may change the connections"
    );
    let now = ask(&laptop, settings).expect("the base station may read them");
    assert_eq!(now["text"], text.replace('[', "[ "));
}

/// Returns the offer of an empty file of that robot.
fn empty_offer(from: &str) -> Offer {
    Offer {
        sender: Name::new(from).expect("a name"),
        topic: Topic::new("maps").expect("a topic"),
        name: FileName::new("map.bin").expect("a file's name"),
        encoding: Encoding::BYTES,
        size_bytes: 0,
        checksum: Checksum::of(b""),
        call: 1,
    }
}

#[test]
fn a_program_cannot_confirm_a_transfer_in_the_name_of_another_robot() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let robot = init(root.path(), "wombat-1", &[]);
    let users = format!("{robot}/users");
    let other = init(root.path(), "wombat-2", &["--users", &users]);
    let dial =
        json!({ "connections": [{ "name": "robot", "method": "ble", "address": "wombat-1" }] });
    fs::write(format!("{other}/connections.json"), dial.to_string()).expect("written");
    let (_robot, local) = start(&air, &robot, "wombat-1", "fleet");
    let (_other, remote) = start(&air, &other, "wombat-2", "fleet");
    let forger = program(&other, &remote);
    // The forger confirms its own offer, and one in the name of wombat-3.
    let offers = ["wombat-3", "wombat-2"].map(empty_offer);
    let me = Name::new("wombat-1").expect("a name");
    let confirming = offers.clone().map(|offer| {
        let key = format!("rect/{}/@rect/transfer/{}", offer.sender, offer.id(&me));
        let declared = forger.declare_queryable(key.clone()).complete(true);
        let declared = declared.callback(move |query| {
            query.reply(&key, offer.encode()).wait().expect("replied");
        });
        declared.wait().expect("declared")
    });
    let received = root.path().join("received");
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(async {
        let options = Options::new("wombat-1").expect("a name").login_file(&users);
        let robot = options.router(&local).connect().await.expect("joined");
        let taking = ReceiveOptions::in_folder(&received, 100);
        let transfers = robot.receive_transfers("*/**", taking).await;
        let transfers = transfers.expect("declared");
        let deadline = Instant::now() + DEADLINE;
        loop {
            assert!(
                Instant::now() < deadline,
                "the forger's own transfer does not arrive"
            );
            for offer in &offers {
                let asked = forger
                    .get("rect/wombat-1/@rect/inbox")
                    .payload(offer.encode());
                let replies = asked.await.expect("asked");
                while replies.recv_async().await.is_ok() {}
            }
            let soon = Duration::from_millis(200);
            if let Ok(got) = tokio::time::timeout(soon, transfers.next()).await {
                let got = got.expect("open").expect("whole");
                assert_eq!(got.sender.as_str(), "wombat-2");
                break;
            }
        }
    });
    assert!(received.join("wombat-2/map.bin").exists());
    assert!(!received.join("wombat-3").exists());
    drop(confirming);
}

/// Returns the access control of a base station that holds these robots to their names, as `docs/how-to/security.md`
/// describes it.
fn strict_access_control(base: &str, robots: &[&str]) -> Value {
    let config = zenoh::Config::from_file(format!("{base}/robot.json5")).expect("valid");
    let mut config = serde_json::to_value(&config).expect("JSON");
    let mut access = config["access_control"].take();
    let is_of_all = |one: &Value| one["id"] == "robots" || one["subjects"] == json!(["robots"]);
    for part in ["subjects", "policies"] {
        let all = access[part].as_array_mut().expect("a list");
        all.retain(|one| !is_of_all(one));
    }
    let page = repository().join("docs/how-to/security.md");
    let page = fs::read_to_string(page).expect("exists");
    let (_, shown) = page
        .split_once("## A base station that holds each robot to its name")
        .expect("the chapter");
    let (_, shown) = shown.split_once("```json5").expect("an example");
    let (shown, _) = shown.split_once("```").expect("its end");
    for robot in robots {
        let of_robot: Value = json5::from_str(&shown.replace("wombat-2", robot)).expect("valid");
        for part in ["rules", "subjects", "policies"] {
            let more = of_robot[part].as_array().expect("a list").clone();
            access[part].as_array_mut().expect("a list").extend(more);
        }
    }
    access
}

/// Checks that `to` receives what `from` publishes on `own_key`, but not what it publishes on `foreign_keys`.
fn receives_only(to: &Session, from: &Session, foreign_keys: &[&str], own_key: &str) {
    let received = to.declare_subscriber("**").wait().expect("subscribes");
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "nothing arrives");
        for key in foreign_keys {
            from.put(*key, "not mine").wait().expect("a put");
        }
        from.put(own_key, "mine").wait().expect("a put");
        // Messages arrive in order: if a foreign key had passed, its message would arrive first.
        while let Ok(Some(sample)) = received.recv_timeout(Duration::from_millis(200)) {
            let key = sample.key_expr().as_str();
            assert!(!foreign_keys.contains(&key), "{key} arrived");
            // Others may be late messages of an earlier step.
            if key == own_key {
                return;
            }
        }
    }
}

#[test]
fn a_strict_base_station_restricts_a_tampered_robot_to_its_own_name() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let base = init(root.path(), "base", &["--base-station"]);
    let users = fs::read_to_string(format!("{base}/users")).expect("exists");
    let secret = users.lines().next().expect("a line").to_owned();
    let logins = ["wombat-2:of two", "wombat-3:of three"];
    fs::write(
        format!("{base}/users"),
        format!("{secret}\n{}\n", logins.join("\n")),
    )
    .expect("written");
    // The base station does not dial, so it needs no login.
    let config = format!("{base}/robot.json5");
    let text = fs::read_to_string(&config).expect("exists");
    let without = text.replace(", login_as: \"config\"", "");
    assert_ne!(without, text);
    fs::write(&config, without).expect("written");
    let access = format!(
        "access_control:{}",
        strict_access_control(&base, &["wombat-2", "wombat-3"])
    );
    let (_base, laptop) = start_with(&air, &base, "base", &["--cfg", &access]);
    let laptop = program(&base, &laptop);

    let dial = json!({ "connections": [{ "name": "base", "method": "ble", "address": "base" }] });
    let robot = |name: &str, login: &str, more: &[&str]| {
        let own = format!("{secret}\n{login}\n");
        let users = root.path().join(format!("users of {name}"));
        fs::write(&users, own).expect("written");
        let folder = init(
            root.path(),
            name,
            &["--users", &users.display().to_string()],
        );
        fs::write(format!("{folder}/connections.json"), dial.to_string()).expect("written");
        let (router, endpoint) = start_with(&air, &folder, name, more);
        (router, program(&folder, &endpoint))
    };
    // The attacker has removed the rules of the robot, and logs in as the user whose password it has.
    let no_rules = ["--cfg", "access_control/enabled:false"];
    let tampered = [&["--login-as", "wombat-2"], &no_rules[..]].concat();
    let (_two, two) = robot("wombat-2", logins[0], &tampered);
    let (_three, three) = robot("wombat-3", logins[1], &["--login-as", "wombat-3"]);

    // Both robots are connected, and receive each other's messages through the base station.
    assert!(arrives(&two, &three, "rect/wombat-2/arm/angle"));
    assert!(arrives(&three, &two, "rect/wombat-3/arm/angle"));
    assert!(arrives(&laptop, &two, "rect/base/go"));
    let foreign_keys = ["rect/wombat-3/stop", "rect/base/go", "rect/all"];
    for to in [&three, &laptop] {
        receives_only(to, &two, &foreign_keys, "rect/wombat-2/mark");
    }
    // The tampered robot cannot answer requests to other robots either.
    let answer = |key: &'static str| {
        let queryable = two.declare_queryable(key).callback(move |query| {
            let _ = query.reply(key, "1").wait();
        });
        queryable.wait().expect("a queryable")
    };
    let _services = ["rect/wombat-9/battery", "rect/wombat-2/battery"].map(answer);
    assert_eq!(ask(&laptop, "rect/wombat-2/battery"), Ok(json!(1)));
    assert!(change(&laptop, "rect/wombat-9/battery", "").is_none());
    // Each robot answers queries of its status under its own name.
    for (robot, asks) in [("wombat-2", &laptop), ("wombat-3", &two)] {
        let status = ask(asks, &format!("rect/{robot}/@rect/status")).expect("an answer");
        assert!(status["id"].is_string(), "{status:#}");
    }
}

#[test]
fn a_strict_base_station_ignores_a_robot_with_the_common_login() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let base = init(root.path(), "base", &["--base-station"]);
    let users = format!("{base}/users");
    let access = format!(
        "access_control:{}",
        strict_access_control(&base, &["wombat-2"])
    );
    let (_base, laptop) = start_with(&air, &base, "base", &["--cfg", &access]);
    let laptop = program(&base, &laptop);
    let folder = init(root.path(), "wombat-2", &["--users", &users]);
    let dial = json!({ "connections": [{ "name": "base", "method": "ble", "address": "base" }] });
    fs::write(format!("{folder}/connections.json"), dial.to_string()).expect("written");
    let no_rules = [
        "--login-as",
        "fleet",
        "--cfg",
        "access_control/enabled:false",
    ];
    let (_two, remote) = start_with(&air, &folder, "wombat-2", &no_rules);
    let two = program(&folder, &remote);
    let linked = "rect/wombat-2/@rect/connections?name=base";
    answers(&two, linked, |all| all[0]["state"] == "connected");
    let received = laptop.declare_subscriber("**").wait().expect("subscribes");
    assert!(!arrives(&two, &laptop, "rect/wombat-2/arm/angle"));
    assert!(received.try_recv().expect("open").is_none());
}
