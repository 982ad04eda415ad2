//! Tests of a running router and of its end: `cargo test -p rect-router --test behaviour running`

use std::time::Duration;

use crate::support::{arrives, client, Router};
use nix::sys::signal::Signal;
use zenoh::Wait;

const ARGS: [&str; 3] = ["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"];

#[test]
fn routes_publications_and_queries() {
    let mut router = Router::start(&ARGS);
    let endpoint = router.listener();
    let (local, remote) = (client(&endpoint), client(&endpoint));
    assert!(arrives(&local, &remote, "rect/wombat-1/arm/angle"));

    let _service = remote
        .declare_queryable("rect/wombat-2/sum")
        .callback(|query| {
            let _ = query.reply("rect/wombat-2/sum", "42").wait();
        })
        .wait()
        .expect("a queryable");
    let deadline = std::time::Instant::now() + crate::support::DEADLINE;
    loop {
        assert!(std::time::Instant::now() < deadline, "no reply");
        let replies = local
            .get("rect/wombat-2/sum")
            .timeout(Duration::from_secs(2))
            .wait()
            .expect("a query");
        if let Ok(reply) = replies.recv() {
            assert_eq!(
                reply
                    .result()
                    .expect("a sample")
                    .payload()
                    .to_bytes()
                    .as_ref(),
                b"42"
            );
            break;
        }
    }
}

fn stops_with_status_0_at(signal: Signal) {
    let mut router = Router::start(&ARGS);
    let endpoint = router.listener();
    let (local, remote) = (client(&endpoint), client(&endpoint));
    assert!(arrives(&local, &remote, "rect/a/b"));
    router.up().signal(signal);
    let status = router.exit();
    assert_eq!(status.code(), Some(0), "{}", router.full_log());
    let log = router.full_log();
    assert!(
        log.contains(&format!("{signal}: closing")) && log.contains("closed"),
        "{log}"
    );
}

#[test]
fn sigterm_ends_the_router_with_status_0_while_clients_are_connected() {
    stops_with_status_0_at(Signal::SIGTERM);
}

#[test]
fn sigint_ends_the_router_with_status_0_while_clients_are_connected() {
    stops_with_status_0_at(Signal::SIGINT);
}

#[test]
fn a_signal_ends_the_router_while_it_waits_for_a_required_peer() {
    // The connection is required, and retried without a limit.
    let mut router = Router::start(&[
        "-l",
        "tcp/127.0.0.1:0",
        "--no-multicast-scouting",
        "-e",
        "tcp/127.0.0.1:1",
        "--cfg",
        "connect/exit_on_failure:true",
        "--cfg",
        "connect/timeout_ms:-1",
    ]);
    router.wait_for("Unable to connect");
    router.signal(Signal::SIGTERM);
    assert_eq!(router.exit().code(), Some(0));
}
