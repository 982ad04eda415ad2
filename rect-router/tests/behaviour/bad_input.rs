//! Tests that invalid input ends the router with one clear message on stderr and a status other than 0:
//! `cargo test -p rect-router --test behaviour bad_input`

use std::{fs, net::TcpListener, process::Command};

/// Runs the router, which must fail, and returns its status and its message.
fn refused(args: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .args(args)
        .env("NO_COLOR", "1")
        .env_remove("RUST_LOG")
        .output()
        .expect("the router starts");
    let message = String::from_utf8(output.stderr).expect("text");
    assert!(!message.contains("panicked"), "{message}");
    (
        output.status.code().expect("an exit, not a signal"),
        message.trim_end().to_owned(),
    )
}

/// Checks that the router fails with this status and this message.
fn assert_refused(args: &[&str], status: i32, expected: &str) {
    let (code, message) = refused(args);
    assert_eq!((code, message.as_str()), (status, expected), "{args:?}");
}

const QUIET: [&str; 2] = ["--no-multicast-scouting", "-ltcp/127.0.0.1:0"];

#[test]
fn rejects_an_id_that_is_not_hexadecimal() {
    assert_refused(
        &["--id", "wombat"],
        1,
        "rect-router: --id wombat: give 1 to 32 lowercase hexadecimal digits, the first not 0: \
         Invalid id: wombat - invalid digit found in string",
    );
}

#[test]
fn rejects_an_endpoint_without_protocol() {
    assert_refused(
        &["-l", "7447"],
        1,
        "rect-router: --listen 7447: not an endpoint; write PROTOCOL/ADDRESS, for example tcp/127.0.0.1:7447 or \
         ble/wombat-2: Endpoints must be of the form <protocol>/<address>[?<metadata>][#<config>]: 7447",
    );
    let (code, message) = refused(&["-e", "wombat-2"]);
    assert_eq!(code, 1);
    assert!(
        message.starts_with(
            "rect-router: --connect wombat-2: not an endpoint; write PROTOCOL/ADDRESS"
        ),
        "{message}"
    );
}

#[test]
fn rejects_an_unknown_protocol_to_listen_on() {
    let (code, message) = refused(&["--no-multicast-scouting", "-l", "pigeon/home"]);
    assert_eq!(
        (code, message.as_str()),
        (
            1,
            "rect-router: cannot start: Unicast not supported for pigeon protocol"
        )
    );
}

#[test]
fn rejects_an_invalid_ble_endpoint_at_the_start() {
    for (flag, endpoint, reason) in [
        (
            "-l",
            "ble/hci0#colour=red",
            "unknown option `colour` of a ble listen locator",
        ),
        ("-e", "ble/wombat-2#psm=99999", "option psm=99999"),
        (
            "-e",
            "ble/hci0",
            "`hci0` is an adapter, which can be listened on",
        ),
    ] {
        let (code, message) = refused(&["--no-multicast-scouting", flag, endpoint]);
        assert_eq!(code, 1, "{message}");
        assert!(
            message.starts_with(&format!("rect-router: {endpoint}: {reason}")),
            "{message}"
        );
    }
}

#[test]
fn rejects_an_invalid_ble_endpoint_of_the_configuration_file() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("router.json5");
    fs::write(
        &file,
        r#"{ connect: { endpoints: ["ble/wombat-2#mtu=3"] } }"#,
    )
    .expect("written");
    let (code, message) = refused(&["-c", file.to_str().expect("text")]);
    assert_eq!(code, 1);
    assert!(
        message.starts_with("rect-router: ble/wombat-2#mtu=3: option mtu=3"),
        "{message}"
    );
}

#[test]
fn reports_a_port_that_is_in_use_with_the_cause() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let endpoint = format!("tcp/{}", taken.local_addr().expect("an address"));
    let (code, message) = refused(&["--no-multicast-scouting", "-l", &endpoint]);
    assert_eq!(code, 1);
    assert!(
        message.starts_with("rect-router: cannot start: Can not create a new TCP listener"),
        "{message}"
    );
    assert!(
        message.contains("Address already in use") && !message.contains(".rs:"),
        "{message}"
    );
}

#[test]
fn rejects_invalid_settings() {
    assert_refused(
        &["--cfg", "scouting"],
        1,
        "rect-router: --cfg scouting: not a KEY:VALUE pair; write for example --cfg 'scouting/multicast/enabled:false'",
    );
    assert_refused(
        &["--cfg", "no/such/key:1"],
        1,
        "rect-router: --cfg no/such/key:1: unknown key",
    );
    for setting in [
        "mode:{",
        "mode:\"boss\"",
        "listen/timeout_ms:\"soon\"",
        "scouting/multicast/enabled:",
    ] {
        let (code, message) = refused(&["--cfg", setting]);
        assert_eq!(code, 1, "{setting}");
        assert!(
            message.starts_with(&format!("rect-router: --cfg {setting}: ")),
            "{message}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
    let (code, message) = refused(&["--cfg", ":{mode:1}"]);
    assert_eq!(code, 1);
    assert!(message.starts_with("rect-router: --cfg with an empty key must give a whole configuration, and this value is not one: "), "{message}");
}

#[test]
fn rejects_a_missing_empty_or_invalid_configuration_file() {
    assert_refused(
        &["-c", "/nowhere/router.json5"],
        1,
        "rect-router: configuration file /nowhere/router.json5: No such file or directory (os error 2)",
    );
    let dir = tempfile::tempdir().expect("a directory");
    for (name, text, reason) in [
        ("empty.json5", "", ": Empty config file"),
        (
            "open.json5",
            "{ mode: ",
            ", line 1: the file ends where the value of `mode` is expected",
        ),
        (
            "comma.json5",
            "{\n  mode: \"router\"\n  id: \"1\"\n}\n",
            ", line 2: a comma is missing at its end, before `id`",
        ),
        ("list.json5", "[]", ", line 1: a configuration is an object"),
        (
            "unknown.json5",
            "{\n  colour: \"red\" }",
            ", line 2: unknown field `colour`",
        ),
        ("list.yaml", "- 1\n- 2\n", ": YAML error"),
        ("router.ini", "x", ": Unsupported file type"),
    ] {
        let file = dir.path().join(name);
        fs::write(&file, text).expect("written");
        let (code, message) = refused(&["-c", file.to_str().expect("text")]);
        assert_eq!(code, 1, "{message}");
        assert!(
            message.starts_with(&format!(
                "rect-router: configuration file {}{reason}",
                file.display()
            )),
            "{message}"
        );
        assert_eq!(message.lines().count(), 1, "{message}");
    }
}

#[test]
fn reports_a_missing_plugin_without_a_panic() {
    let args = [&QUIET[..], &["-P", "nosuch"]].concat();
    let (code, message) = refused(&args);
    let what = "rect-router: cannot start: Plugin load failure: Library file 'libzenoh_plugin_nosuch.so' not found";
    assert!(code == 1 && message.starts_with(what), "{code}: {message}");
    // The message contains advice.
    for advice in ["--plugin-search-dir", "scripts/build-plugins"] {
        assert!(message.contains(advice), "{message}");
    }
    let (code, message) = refused(&[&QUIET[..], &["-P", "nosuch:/nowhere/x.so"]].concat());
    assert_eq!(code, 1);
    assert!(
        message.starts_with("rect-router: cannot start: Plugin load failure: "),
        "{message}"
    );
}

#[test]
fn invalid_flags_end_with_status_2() {
    for args in [
        &["--bogus"][..],
        &["--adminspace-permissions", "all"],
        &["-c"],
    ] {
        let (code, message) = refused(args);
        assert_eq!(code, 2, "{message}");
        assert!(message.starts_with("error: "), "{message}");
    }
}

#[test]
fn rejects_an_invalid_log_filter() {
    let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .env("RUST_LOG", "zenoh=loud")
        .output()
        .expect("the router starts");
    let message = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        message.starts_with(
            "rect-router: RUST_LOG=zenoh=loud is not a log filter; use for example RUST_LOG=info"
        ),
        "{message}"
    );
}

#[test]
fn rejects_a_login_that_cannot_be_found() {
    assert_refused(
        &["--login-as", "fleet"],
        1,
        "rect-router: --login-as fleet: the configuration names no transport/auth/usrpwd/dictionary_file to take the \
         password from",
    );
    let dir = tempfile::tempdir().expect("a directory");
    let users = dir.path().join("users");
    let setting = format!(
        "transport/auth/usrpwd/dictionary_file:\"{}\"",
        users.display()
    );
    let args = ["--login-as", "fleet", "--cfg", &setting];
    let (code, message) = refused(&args);
    assert_eq!(code, 1);
    assert!(
        message.contains("create one with a line `user:password`")
            && message.contains("No such file"),
        "{message}"
    );
    fs::write(&users, "other:secret\n").expect("written");
    let (code, message) = refused(&args);
    assert_eq!(code, 1);
    assert_eq!(
        message,
        format!(
            "rect-router: --login-as fleet: no line `fleet:password` in {}",
            users.display()
        )
    );
}
