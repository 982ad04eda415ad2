//! Tests of RECT together with stock Zenoh: Zenoh's REST plugin in rect-router, and the memory of a zenohd beside it.
//! `scripts/build-for-tests` builds them: `cargo test --profile checked -p rect-router --test behaviour stock`.

use std::{path::PathBuf, process::Command};

use crate::support::{built, cache, client, free_socket, http_get, skip, Router};
use zenoh::{bytes::Encoding, Wait};

/// Returns the router and Zenoh's REST plugin that were built together, or `None` if there are none.
fn router_and_plugin() -> Option<(PathBuf, PathBuf)> {
    let dir = built();
    let built = (dir.join("rect-router"), dir.join("libzenoh_plugin_rest.so"));
    if built.0.exists() && built.1.exists() {
        return Some(built);
    }
    skip(&format!(
        "no {} with its router; run scripts/build-for-tests",
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
    let version = String::from_utf8(output.stdout).expect("text");
    // The features of zenohd 1.10.2 as installed by `cargo install` without options.
    assert!(
        version.ends_with(
            "\nzenoh features: zenoh/auth_pubkey zenoh/auth_usrpwd zenoh/transport_multilink zenoh/transport_quic \
             zenoh/transport_tcp zenoh/transport_tls zenoh/transport_udp zenoh/transport_unixsock-stream \
             zenoh/transport_ws zenoh/unstable zenoh/default\n"
        ),
        "{version}"
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

    assert!(http_get(&socket, "/rect/wombat-1/battery").contains("7.4"));
    let about = http_get(&socket, "/@/abc/router");
    assert!(
        about.contains("\"zid\"") && about.contains("abc"),
        "{about}"
    );

    router.signal(nix::sys::signal::Signal::SIGTERM);
    assert_eq!(router.exit().code(), Some(0));
}

#[test]
fn reports_an_invalid_rest_socket_without_a_panic() {
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
    assert!(log.contains("rect-router: cannot start: "), "{log}");
}

/// The tests run a router that is not optimised, whose stacks take some 400 kB more: the limit for the released one is 1 MB, which
/// includes the data of the program (bench `idle`; `packaging/budget` limits that data).
#[test]
fn idle_heap_and_stacks_are_at_most_1400_kb_above_those_of_a_stock_zenohd() {
    let ours = built().join("rect-router");
    let stock = cache().join("stock-zenohd/bin/zenohd");
    if !stock.exists() {
        return skip(&format!(
            "no {}; run scripts/build-stock-zenohd",
            stock.display()
        ));
    }
    let idle = |program: &PathBuf| {
        let mut router = Router::start_program(
            program,
            &["-l", "tcp/127.0.0.1:0", "--no-multicast-scouting"],
        );
        let session = client(&router.listener());
        // When the router answers, its start is complete.
        let _ = session.get("@/*/router").wait().expect("a query").recv();
        session.close().wait().expect("closed");
        router.memory()
    };
    let (ours, stock) = (idle(&ours), idle(&stock));
    println!("idle: rect-router {ours:?}, stock zenohd {stock:?}");
    assert!(
        ours.heap_and_stacks_kb <= stock.heap_and_stacks_kb + 1400,
        "rect-router {ours:?}, stock zenohd {stock:?}"
    );
}
