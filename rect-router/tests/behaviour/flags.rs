//! Tests that each flag of zenohd has the same effect in rect-router: `cargo test -p rect-router --test behaviour flags`

use std::{fs, process::Command};

use crate::support::{cache, client, skip, Router};
use serde_json::{json, Value};
use zenoh::Wait;

const LISTEN: &str = "tcp/127.0.0.1:0";

/// Returns rows of flags, the part of the configuration that they set, and its expected value.
fn table(config: &str, yaml: &str) -> Vec<(Vec<String>, &'static str, Value)> {
    let row = |args: &[&str], pointer, value| {
        (
            args.iter().map(|a| (*a).to_owned()).collect(),
            pointer,
            value,
        )
    };
    vec![
        row(&[], "/mode", json!("router")),
        row(&[], "/adminspace/enabled", json!(true)),
        row(&[], "/plugins_loading/enabled", json!(true)),
        row(&[], "/scouting/multicast/enabled", json!(true)),
        row(&["-c", config], "/metadata/name", json!("from a file")),
        row(&["-c", config], "/mode", json!("peer")),
        row(&["--config", yaml], "/metadata/name", json!("from yaml")),
        row(&["-c", config], "/scouting/multicast/enabled", json!(false)),
        row(
            &["-l", LISTEN, "--listen", "udp/127.0.0.1:0"],
            "/listen/endpoints",
            json!([LISTEN, "udp/127.0.0.1:0"]),
        ),
        row(
            &["-e", "tcp/127.0.0.1:1", "--connect", "tcp/127.0.0.1:2"],
            "/connect/endpoints/1",
            json!("tcp/127.0.0.1:2"),
        ),
        row(&["-i", "a0b"], "/id", json!("a0b")),
        row(&["--id", "1f"], "/id", json!("1f")),
        row(&["--no-timestamp"], "/timestamping/enabled", json!(false)),
        row(
            &["--no-multicast-scouting"],
            "/scouting/multicast/enabled",
            json!(false),
        ),
        row(
            &["--rest-http-port", "8000"],
            "/plugins/rest",
            json!({"http_port": "8000", "__required__": true}),
        ),
        row(&["--rest-http-port", "None"], "/plugins/rest", Value::Null),
        row(&["-P", "x"], "/plugins/x", json!({"__required__": true})),
        row(
            &["--plugin", "x:/a/b.so"],
            "/plugins/x",
            json!({"__required__": true, "__path__": "/a/b.so"}),
        ),
        row(
            &["--plugin-search-dir", "/a", "--plugin-search-dir", "/b"],
            "/plugins_loading/search_dirs",
            json!(["/a", "/b"]),
        ),
        row(
            &["--cfg", "metadata:{name:'me'}"],
            "/metadata/name",
            json!("me"),
        ),
        row(
            &["--cfg", "/queries_default_timeout:7"],
            "/queries_default_timeout",
            json!(7),
        ),
        row(
            &["--cfg", ":{metadata:{name:'all'}}"],
            "/metadata/name",
            json!("all"),
        ),
        row(
            &[
                "--cfg",
                ":{metadata:{name:'all'}}",
                "--cfg",
                "metadata:{name:'part'}",
            ],
            "/metadata/name",
            json!("part"),
        ),
        row(
            &[
                "--no-multicast-scouting",
                "--cfg",
                "scouting/multicast/enabled:true",
            ],
            "/scouting/multicast/enabled",
            json!(true),
        ),
        row(
            &["--adminspace-permissions", "r"],
            "/adminspace/permissions",
            json!({"read": true, "write": false}),
        ),
        row(
            &["--adminspace-permissions", "w"],
            "/adminspace/permissions",
            json!({"read": false, "write": true}),
        ),
        row(
            &["--adminspace-permissions", "rw"],
            "/adminspace/permissions",
            json!({"read": true, "write": true}),
        ),
        row(
            &["--adminspace-permissions", "none"],
            "/adminspace/permissions",
            json!({"read": false, "write": false}),
        ),
    ]
}

fn files() -> (tempfile::TempDir, String, String) {
    let dir = tempfile::tempdir().expect("a directory");
    let json5 = dir.path().join("router.json5");
    let yaml = dir.path().join("router.yaml");
    fs::write(
        &json5,
        "{ mode: 'peer', metadata: { name: 'from a file' }, scouting: { multicast: { enabled: false } } } // done",
    )
    .expect("written");
    fs::write(
        &yaml,
        "metadata:\n  name: from yaml\nlisten:\n  endpoints: [\"tcp/127.0.0.1:0\"]\n",
    )
    .expect("written");
    let text = |path: std::path::PathBuf| path.to_str().expect("text").to_owned();
    (dir, text(json5), text(yaml))
}

#[test]
fn each_flag_sets_its_part_of_the_configuration() {
    let (_dir, json5, yaml) = files();
    for (args, pointer, expected) in table(&json5, &yaml) {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let config = Router::start(&args).configuration();
        assert_eq!(
            config.pointer(pointer).unwrap_or(&Value::Null),
            &expected,
            "{args:?} {pointer}"
        );
    }
}

#[test]
fn stock_zenohd_has_the_same_configuration_for_each_flag() {
    let zenohd = cache().join("stock-zenohd/bin/zenohd");
    if !zenohd.exists() {
        return skip(&format!(
            "no {}; run scripts/build-stock-zenohd",
            zenohd.display()
        ));
    }
    let (_dir, json5, yaml) = files();
    for (args, _, _) in table(&json5, &yaml) {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let ours = Router::start(&args).configuration();
        let stock = Router::start_program(&zenohd, &args).configuration();
        assert_eq!(ours, stock, "{args:?}");
    }
}

#[test]
fn the_id_flag_sets_the_id_of_the_router() {
    let mut router = Router::start(&["-l", LISTEN, "-i", "abc", "--no-multicast-scouting"]);
    let session = client(&router.listener());
    let routers: Vec<String> = session
        .info()
        .routers_zid()
        .wait()
        .map(|id| id.to_string())
        .collect();
    assert_eq!(routers, ["abc"]);
    assert!(router
        .wait_for("rect-router is up, with id")
        .contains("abc"));
}

#[test]
fn the_no_timestamp_flag_disables_timestamps() {
    for (flags, stamped) in [(&[][..], true), (&["--no-timestamp"][..], false)] {
        let mut router =
            Router::start(&[&["-l", LISTEN, "--no-multicast-scouting"], flags].concat());
        let endpoint = router.listener();
        let (from, to) = (client(&endpoint), client(&endpoint));
        let subscriber = to
            .declare_subscriber("stamp")
            .wait()
            .expect("a subscription");
        let deadline = std::time::Instant::now() + crate::support::DEADLINE;
        let sample = loop {
            assert!(std::time::Instant::now() < deadline, "nothing arrives");
            from.put("stamp", "x").wait().expect("a put");
            if let Ok(Some(sample)) = subscriber.recv_timeout(std::time::Duration::from_millis(100))
            {
                break sample;
            }
        };
        assert_eq!(sample.timestamp().is_some(), stamped, "{flags:?}");
    }
}

#[test]
fn the_permissions_flag_controls_the_admin_space() {
    for (permissions, readable) in [("r", true), ("w", false), ("rw", true), ("none", false)] {
        let mut router = Router::start(&[
            "-l",
            LISTEN,
            "-i",
            "ad",
            "--no-multicast-scouting",
            "--adminspace-permissions",
            permissions,
        ]);
        let session = client(&router.listener());
        let replies = session
            .get("@/ad/router")
            .timeout(std::time::Duration::from_secs(5))
            .wait()
            .expect("a query");
        assert_eq!(
            replies.into_iter().filter(|r| r.result().is_ok()).count() > 0,
            readable,
            "{permissions}"
        );
    }
}

#[test]
fn the_connect_flag_links_two_routers() {
    let mut one = Router::start(&["-l", LISTEN, "--no-multicast-scouting"]);
    let endpoint = one.listener();
    let mut two = Router::start(&["-l", LISTEN, "-e", &endpoint, "--no-multicast-scouting"]);
    let (local, remote) = (client(&endpoint), client(&two.listener()));
    assert!(crate::support::arrives(&local, &remote, "rect/a/hello"));
}

#[test]
fn the_log_contains_no_password() {
    let mut router = Router::start(&[
        "-l",
        LISTEN,
        "--cfg",
        "transport/auth/usrpwd:{user:'fleet',password:'hush-hush'}",
    ]);
    let config = router.configuration();
    assert_eq!(
        config.pointer("/transport/auth/usrpwd/password"),
        Some(&json!("***"))
    );
    router.up();
    assert!(!router
        .drained()
        .iter()
        .any(|line| line.contains("hush-hush")));
}

#[test]
fn the_version_contains_the_requirements_of_plugins() {
    let output_of = |flag| {
        let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
            .arg(flag)
            .output()
            .expect("the router starts");
        assert_eq!(output.status.code(), Some(0));
        String::from_utf8(output.stdout).expect("text")
    };
    let own = env!("CARGO_PKG_VERSION");
    assert_eq!(
        output_of("-V"),
        format!("rect-router {own} (zenoh 1.10.2)\n")
    );
    let long = output_of("--version");
    assert!(
        long.starts_with(&format!(
            "rect-router {own} (zenoh 1.10.2) built with rustc 1."
        )),
        "{long}"
    );
    assert!(long.contains("\nzenoh features: "), "{long}");
}

#[test]
fn the_version_names_the_zenoh_in_use() {
    let mut router = Router::start(&["-l", LISTEN, "-i", "ad", "--no-multicast-scouting"]);
    let session = client(&router.listener());
    let reply = session
        .get("@/ad/router")
        .wait()
        .expect("a query")
        .recv()
        .expect("a reply");
    let sample = reply.into_result().expect("the admin space");
    let about: Value = serde_json::from_slice(&sample.payload().to_bytes()).expect("JSON");
    assert!(
        about["version"]
            .as_str()
            .is_some_and(|v| v.starts_with("v1.10.2")),
        "{about}"
    );
}
