//! Stock Zenoh with RECT and RECT with stock Zenoh: its REST plugin in rect-router, `ble/` in the published zenohd.
//!
//! Needs release builds, made by `scripts/build-plugins`, `scripts/build-stock-zenohd` and
//! `scripts/build-stock-zenohd-with-ble`: `cargo test -p rect-router --test stock` (RECT_PROFILE, as given to the scripts, if
//! not `release`)

mod support;

use std::{
    path::PathBuf,
    process::Command,
    time::{Duration, Instant},
};

use support::{arrives, built_with, cache, client, free_socket, got, skip, Air, Router};
use zenoh::{bytes::Encoding, Wait};

/// What the router was built with.
fn profile() -> String {
    std::env::var("RECT_PROFILE").unwrap_or_else(|_| "release".to_owned())
}

/// The router and the plugin as built together.
fn router_and_plugin() -> Option<(PathBuf, PathBuf)> {
    let dir = built_with(&profile());
    let built = (dir.join("rect-router"), dir.join("libzenoh_plugin_rest.so"));
    if built.0.exists() && built.1.exists() {
        return Some(built);
    }
    skip(&format!(
        "no {} with its router; run scripts/build-plugins",
        built.1.display()
    ));
    None
}

#[test]
fn the_released_router_has_the_features_of_a_stock_zenohd() {
    let Some((router, _)) = router_and_plugin() else {
        return;
    };
    let output = Command::new(router)
        .arg("--version")
        .output()
        .expect("it starts");
    let said = String::from_utf8(output.stdout).expect("text");
    // What zenohd 1.10.2 of a plain `cargo install` has (its own test says so).
    assert!(
        said.ends_with(
            "\nzenoh features: zenoh/auth_pubkey zenoh/auth_usrpwd zenoh/transport_multilink zenoh/transport_quic \
             zenoh/transport_tcp zenoh/transport_tls zenoh/transport_udp zenoh/transport_unixsock-stream \
             zenoh/transport_ws zenoh/unstable zenoh/default\n"
        ),
        "{said}"
    );
}

#[test]
fn the_stock_rest_plugin_serves_a_key_and_the_admin_space() {
    let Some((program, plugin)) = router_and_plugin() else {
        return;
    };
    let plugins = plugin.parent().expect("a directory").display().to_string();
    let socket = free_socket();
    let mut router = Router::start_program(
        &program,
        &[
            "-l",
            "tcp/127.0.0.1:0",
            "-i",
            "abc",
            "--no-multicast-scouting",
            "--plugin-search-dir",
            &plugins,
            "--rest-http-port",
            &socket,
        ],
    );
    let session = client(&router.listener());
    router.up();
    let _service = session
        .declare_queryable("rect/wombat-1/battery")
        .callback(|query| {
            let _ = query
                .reply("rect/wombat-1/battery", "7.4")
                .encoding(Encoding::APPLICATION_JSON)
                .wait();
        })
        .wait()
        .expect("a queryable");

    assert!(got(&socket, "/rect/wombat-1/battery").contains("7.4"));
    let about = got(&socket, "/@/abc/router");
    assert!(
        about.contains("\"zid\"") && about.contains("abc"),
        "{about}"
    );

    router.signal(nix::sys::signal::Signal::SIGTERM);
    assert_eq!(router.exit().code(), Some(0));
}

#[test]
fn a_rest_socket_that_is_none_is_an_error_and_no_panic() {
    let Some((program, plugin)) = router_and_plugin() else {
        return;
    };
    let plugins = plugin.parent().expect("a directory").display().to_string();
    let mut router = Router::start_program(
        &program,
        &[
            "-l",
            "tcp/127.0.0.1:0",
            "--no-multicast-scouting",
            "--plugin-search-dir",
            &plugins,
            "--rest-http-port",
            "soon",
        ],
    );
    let status = router.exit();
    let log = router.full_log();
    assert_eq!(status.code(), Some(1), "{log}");
    assert!(log.contains("rect-router: can't start: "), "{log}");
}

#[test]
fn a_published_zenohd_built_with_our_link_speaks_ble_to_rect_router() {
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
    let here = client(&stock.listener());
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
    let there = client(&ours.listener());
    assert!(arrives(&here, &there, "rect/wombat-1/arm/angle"));
    assert!(arrives(&there, &here, "rect/wombat-2/arm/angle"));

    let _service = here
        .declare_queryable("rect/wombat-1/battery")
        .callback(|query| {
            let _ = query.reply("rect/wombat-1/battery", "7.4").wait();
        })
        .wait()
        .expect("a queryable");
    let deadline = Instant::now() + support::DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "no reply over ble");
        let replies = there
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

/// Compared is what a robot loses while the router runs, `Memory::own_kb`. How much of a program's text is resident beside
/// that depends on how it was built and on what the system had read ahead, and goes when memory is short; it is printed.
#[test]
fn the_memory_of_its_own_when_idle_is_that_of_a_stock_zenohd_and_not_1_mb_more() {
    let ours = built_with(&profile()).join("rect-router");
    let stock = cache().join("stock-zenohd/bin/zenohd");
    for (program, how) in [
        (&ours, "cargo build --release -p rect-router"),
        (&stock, "scripts/build-stock-zenohd"),
    ] {
        if !program.exists() {
            return skip(&format!("no {}; run {how}", program.display()));
        }
    }
    let idle = |program: &PathBuf| {
        let mut router = Router::start_program(
            program,
            &["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"],
        );
        let session = client(&router.listener());
        // Once it answers it has settled.
        let _ = session.get("@/*/router").wait().expect("a query").recv();
        session.close().wait().expect("closed");
        router.memory()
    };
    let (ours, stock) = (idle(&ours), idle(&stock));
    println!("idle: rect-router {ours:?}, stock zenohd {stock:?}");
    assert!(
        ours.own_kb <= stock.own_kb + 1024,
        "rect-router {ours:?}, stock zenohd {stock:?}"
    );
}
