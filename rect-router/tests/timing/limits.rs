//! Tests of the limits of sessions, and that no program can use up the sessions of others:
//! `cargo test -p rect-router --test timing limits`

use std::{
    fs,
    net::TcpStream,
    time::{Duration, Instant},
};

use crate::support::{
    answers, arrives, ask, ble, client, client_with, file, init, program, simulated, start,
    start_with, Air, Wombat, DEADLINE,
};
use serde_json::json;
use zenoh::{Session, Wait};

/// Allows 12 sessions. 3 of them are reserved for Bluetooth; one login may have 5 of the other 9.
const SESSIONS: [&str; 2] = ["--cfg", "transport/unicast/max_sessions:12"];

/// Opens a session as the second user of the team's login file. It may take several attempts: the sessions of a greedy login
/// are closed only once they are open, and until then they use the sessions that all logins share.
fn other_user(folder: &str, endpoint: &str) -> Session {
    let users = fs::read_to_string(format!("{folder}/users")).expect("a login file");
    let (user, password) = users
        .lines()
        .nth(1)
        .and_then(|line| line.split_once(':'))
        .expect("a login");
    let login = json!({ "user": user, "password": password }).to_string();
    let settings = [
        ("transport/auth/usrpwd", login.as_str()),
        ("connect/timeout_ms", "10000"),
    ];
    client_with(endpoint, &settings).expect("let in")
}

#[test]
fn idle_connections_without_login_do_not_block_programs() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let folder = init(root.path(), "wombat-1", &[]);
    let (mut router, endpoint) = start(&air, &folder, "wombat-1", "fleet");
    let socket = endpoint.strip_prefix("tcp/").expect("a TCP listener");
    let idle: Vec<_> = (0..100)
        .map(|_| TcpStream::connect(socket).expect("a connection"))
        .collect();
    let begun = Instant::now();
    let session = program(&folder, &endpoint);
    let status = ask(&session, "rect/wombat-1/@rect/status").expect("an answer");
    assert!(status["id"].is_string(), "{status:#}");
    // The session was opened before the handshakes of the idle connections timed out.
    assert!(begun.elapsed() < Duration::from_secs(3));
    router.wait_for("refused a connection from a program on this computer");
    drop(idle);
}

#[test]
fn a_login_with_many_sessions_does_not_block_robots_and_other_logins() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = init(root.path(), "wombat-1", &[]);
    let users = format!("{one}/users");
    let two = init(root.path(), "wombat-2", &["--users", &users]);
    let dial = file(&[ble("first", "wombat-1")]).to_string();
    fs::write(format!("{two}/connections.json"), dial).expect("written");
    let flags = [&SESSIONS[..], &["--login-as", "fleet"]].concat();
    let (mut router, local) = start_with(&air, &one, "wombat-1", &flags);

    let login = fs::read_to_string(&users).expect("a login file");
    let (user, password) = login
        .lines()
        .next()
        .and_then(|line| line.split_once(':'))
        .expect("a login");
    let login = json!({ "user": user, "password": password }).to_string();
    let greedy: Vec<_> = (0..16)
        .filter_map(|_| client_with(&local, &[("transport/auth/usrpwd", &login)]).ok())
        .collect();
    assert!(greedy.len() >= 5, "{}", greedy.len());
    router.wait_for("already has all 5 sessions that one login may have");

    let (_two, remote) = start(&air, &two, "wombat-2", "fleet");
    let asked = "rect/wombat-2/@rect/connections?name=first";
    answers(&program(&two, &remote), asked, |answer| {
        answer[0]["state"] == "connected"
    });
    let laptop = other_user(&one, &local);
    // The greedy program keeps retrying, so the count may take a moment to settle.
    answers(&laptop, "rect/wombat-1/@rect/connections/count", |count| {
        count["methods"]["tcp"]["connected"] == 6
    });
}

#[test]
fn a_program_with_many_declarations_waits_and_is_reported() {
    let (air, root) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let folder = init(root.path(), "wombat-1", &[]);
    let (mut router, endpoint) = start(&air, &folder, "wombat-1", "fleet");
    let (greedy, other) = (program(&folder, &endpoint), program(&folder, &endpoint));
    let declare = |number| {
        let key = format!("rect/wombat-1/token/{number}");
        let token = greedy.liveliness().declare_token(key).wait();
        token.expect("a token")
    };
    // So many that they exceed the limit also if this computer takes 10 ms for each.
    let tokens: Vec<_> = (0..600).map(declare).collect();
    let declared = || {
        let tokens = other.liveliness().get("rect/wombat-1/token/*").wait();
        tokens.expect("a query").into_iter().count()
    };
    // The first 200 pass at once, and 50 per second from then on.
    let begun = Instant::now();
    while declared() < tokens.len() {
        assert!(begun.elapsed() < DEADLINE, "{} are declared", declared());
    }
    router.wait_for("declares more than 50 subscribers, services and tokens per second");
    let status = ask(&other, "rect/wombat-1/@rect/status").expect("an answer");
    // At most what is left after the first 200, and less if declaring them took a while.
    let delayed = status["delayed_declarations"].as_u64();
    assert!(
        (1..=400).contains(&delayed.expect("a number")),
        "{status:#}"
    );
    assert!(
        arrives(&greedy, &other, "demo/x"),
        "its messages still arrive"
    );
}

#[test]
fn programs_without_logins_leave_sessions_for_robots() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    // One of the four sessions is reserved for Bluetooth.
    let few = ["--cfg", "transport/unicast/max_sessions:4"];
    let (mut router, local) = simulated(&air, 1, &few);
    router.up();
    let greedy: Vec<_> = (0..8)
        .filter_map(|_| client_with(&local, &[]).ok())
        .collect();
    assert_eq!(greedy.len(), 3);
    router.wait_for("refused a connection from a program on this computer");
    let two = Wombat::start(&air, &folder, 2, &file(&[ble("first", "wombat-1")]));
    assert!(arrives(&client(&two.endpoint), &greedy[0], "demo/x"));
}
