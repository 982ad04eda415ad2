//! What is wrong is said in one clear message on stderr, with a status that is not 0: `cargo test -p rect-router --test bad_input`

use std::{fs, net::TcpListener, process::Command};

fn refused(args: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .args(args)
        .env("NO_COLOR", "1")
        .env_remove("RUST_LOG")
        .output()
        .expect("the router starts");
    let said = String::from_utf8(output.stderr).expect("text");
    assert!(!said.contains("panicked"), "{said}");
    (
        output.status.code().expect("an exit, not a signal"),
        said.trim_end().to_owned(),
    )
}

fn assert_refused(args: &[&str], status: i32, message: &str) {
    let (code, said) = refused(args);
    assert_eq!((code, said.as_str()), (status, message), "{args:?}");
}

const QUIET: [&str; 2] = ["--no-multicast-scouting", "-ltcp/127.0.0.1:0"];

#[test]
fn an_id_that_is_not_hexadecimal_is_refused() {
    assert_refused(
        &["--id", "wombat"],
        1,
        "rect-router: --id wombat: give 1 to 32 lowercase hexadecimal digits, the first not 0: \
         Invalid id: wombat - invalid digit found in string",
    );
}

#[test]
fn an_endpoint_without_protocol_is_refused() {
    assert_refused(
        &["-l", "7447"],
        1,
        "rect-router: --listen 7447: not an endpoint; write PROTOCOL/ADDRESS, for example tcp/127.0.0.1:7447 or \
         ble/wombat-2: Endpoints must be of the form <protocol>/<address>[?<metadata>][#<config>]: 7447",
    );
    let (code, said) = refused(&["-e", "wombat-2"]);
    assert_eq!(code, 1);
    assert!(
        said.starts_with(
            "rect-router: --connect wombat-2: not an endpoint; write PROTOCOL/ADDRESS"
        ),
        "{said}"
    );
}

#[test]
fn an_unknown_protocol_to_listen_on_is_refused() {
    let (code, said) = refused(&["--no-multicast-scouting", "-l", "pigeon/home"]);
    assert_eq!(
        (code, said.as_str()),
        (
            1,
            "rect-router: can't start: Unicast not supported for pigeon protocol"
        )
    );
}

#[test]
fn a_ble_endpoint_that_can_never_work_is_refused_at_once() {
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
        let (code, said) = refused(&["--no-multicast-scouting", flag, endpoint]);
        assert_eq!(code, 1, "{said}");
        assert!(
            said.starts_with(&format!("rect-router: {endpoint}: {reason}")),
            "{said}"
        );
    }
}

#[test]
fn a_ble_endpoint_of_the_configuration_file_is_checked_too() {
    let dir = tempfile::tempdir().expect("a directory");
    let file = dir.path().join("router.json5");
    fs::write(
        &file,
        r#"{ connect: { endpoints: ["ble/wombat-2#mtu=3"] } }"#,
    )
    .expect("written");
    let (code, said) = refused(&["-c", file.to_str().expect("text")]);
    assert_eq!(code, 1);
    assert!(
        said.starts_with("rect-router: ble/wombat-2#mtu=3: option mtu=3"),
        "{said}"
    );
}

#[test]
fn a_port_that_is_taken_is_an_error_with_its_cause() {
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let endpoint = format!("tcp/{}", taken.local_addr().expect("an address"));
    let (code, said) = refused(&["--no-multicast-scouting", "-l", &endpoint]);
    assert_eq!(code, 1);
    assert!(
        said.starts_with("rect-router: can't start: Can not create a new TCP listener"),
        "{said}"
    );
    assert!(
        said.contains("Address already in use") && !said.contains(".rs:"),
        "{said}"
    );
}

#[test]
fn a_setting_that_can_not_be_made_is_refused() {
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
        let (code, said) = refused(&["--cfg", setting]);
        assert_eq!(code, 1, "{setting}");
        assert!(
            said.starts_with(&format!("rect-router: --cfg {setting}: ")),
            "{said}"
        );
        assert_eq!(said.lines().count(), 1, "{said}");
    }
    let (code, said) = refused(&["--cfg", ":{mode:1}"]);
    assert_eq!(code, 1);
    assert!(said.starts_with("rect-router: --cfg with an empty key gives the whole configuration, and this is none: "), "{said}");
}

#[test]
fn a_configuration_file_that_is_missing_empty_or_wrong_is_refused() {
    assert_refused(
        &["-c", "/nowhere/router.json5"],
        1,
        "rect-router: configuration file /nowhere/router.json5: No such file or directory (os error 2)",
    );
    let dir = tempfile::tempdir().expect("a directory");
    for (name, text, reason) in [
        ("empty.json5", "", "Empty config file"),
        ("open.json5", "{ mode: ", ""),
        ("unknown.json5", "{ colour: \"red\" }", "JSON error"),
        ("list.yaml", "- 1\n- 2\n", "YAML error"),
        ("router.ini", "x", "Unsupported file type"),
    ] {
        let file = dir.path().join(name);
        fs::write(&file, text).expect("written");
        let (code, said) = refused(&["-c", file.to_str().expect("text")]);
        assert_eq!(code, 1, "{said}");
        assert!(
            said.starts_with(&format!(
                "rect-router: configuration file {}: {reason}",
                file.display()
            )),
            "{said}"
        );
        assert_eq!(said.lines().count(), 1, "{said}");
    }
}

#[test]
fn a_plugin_that_is_not_there_is_an_error_and_no_panic() {
    let args = [&QUIET[..], &["-P", "nosuch"]].concat();
    let (code, said) = refused(&args);
    let what = "rect-router: can't start: Plugin load failure: Library file 'libzenoh_plugin_nosuch.so' not found";
    assert!(code == 1 && said.starts_with(what), "{code}: {said}");
    // And what to do.
    for advice in ["--plugin-search-dir", "scripts/build-plugins"] {
        assert!(said.contains(advice), "{said}");
    }
    let (code, said) = refused(&[&QUIET[..], &["-P", "nosuch:/nowhere/x.so"]].concat());
    assert_eq!(code, 1);
    assert!(
        said.starts_with("rect-router: can't start: Plugin load failure: "),
        "{said}"
    );
}

#[test]
fn wrong_flags_end_with_status_2() {
    for args in [
        &["--bogus"][..],
        &["--adminspace-permissions", "all"],
        &["-c"],
    ] {
        let (code, said) = refused(args);
        assert_eq!(code, 2, "{said}");
        assert!(said.starts_with("error: "), "{said}");
    }
}

#[test]
fn a_log_filter_that_is_none_is_refused() {
    let output = Command::new(env!("CARGO_BIN_EXE_rect-router"))
        .env("RUST_LOG", "zenoh=loud")
        .output()
        .expect("the router starts");
    let said = String::from_utf8(output.stderr).expect("text");
    assert_eq!(output.status.code(), Some(1));
    assert!(
        said.starts_with(
            "rect-router: RUST_LOG=zenoh=loud is not a log filter; use for example RUST_LOG=info"
        ),
        "{said}"
    );
}

#[test]
fn a_login_that_can_not_be_found_is_refused() {
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
    let (code, said) = refused(&args);
    assert_eq!(code, 1);
    assert!(
        said.contains("make one with a line `user:password` in it")
            && said.contains("No such file"),
        "{said}"
    );
    fs::write(&users, "other:secret\n").expect("written");
    let (code, said) = refused(&args);
    assert_eq!(code, 1);
    assert_eq!(
        said,
        format!(
            "rect-router: --login-as fleet: no line `fleet:password` in {}",
            users.display()
        )
    );
}
