//! Tests a published zenohd that was built with our links, which `scripts/build-stock-zenohd-with-ble` does:
//! `scripts/test zenohds stock`, or `cargo test --profile checked -p rect-router --test behaviour zenohd_with_ble`.

use std::time::{Duration, Instant};

use crate::support::{self, arrives, cache, client, skip, Air, Router};
use zenoh::Wait;

#[test]
fn a_published_zenohd_with_the_ble_link_communicates_with_rect_router() {
    let zenohd = cache().join("zenohd-ble/bin/zenohd");
    if !zenohd.exists() {
        return skip(&format!(
            "no {}; run scripts/build-stock-zenohd-with-ble",
            zenohd.display()
        ));
    }
    let air = Air::new();
    let mut stock = Router::start_program_on(
        &air,
        &zenohd,
        &[
            "-l",
            "tcp/127.0.0.1:0",
            "-l",
            "ble/sim-1#name=wombat-1",
            "--no-multicast-scouting",
        ],
    );
    let local = client(&stock.listener());
    let mut ours = Router::start_on(
        &air,
        &[
            "-l",
            "tcp/127.0.0.1:0",
            "-l",
            "ble/sim-2#name=wombat-2",
            "-e",
            "ble/wombat-1#adapter=sim-2",
            "--no-multicast-scouting",
        ],
    );
    let remote = client(&ours.listener());
    assert!(arrives(&local, &remote, "rect/wombat-1/arm/angle"));
    assert!(arrives(&remote, &local, "rect/wombat-2/arm/angle"));

    let _service = local
        .declare_queryable("rect/wombat-1/battery")
        .callback(|query| {
            let _ = query.reply("rect/wombat-1/battery", "7.4").wait();
        })
        .wait()
        .expect("a queryable");
    let deadline = Instant::now() + support::DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "no reply over ble");
        let replies = remote
            .get("rect/wombat-1/battery")
            .timeout(Duration::from_secs(5))
            .wait()
            .expect("a query");
        if let Some(Ok(sample)) = replies.into_iter().map(|reply| reply.into_result()).next() {
            assert_eq!(sample.payload().to_bytes().as_ref(), b"7.4");
            return;
        }
    }
}
