//! Tests of the parser of connections files: `cargo test -p rect-connections file`
use std::{fs::File, io::Write};

use super::*;

const MAX_CONNECTIONS: usize = 3;

fn limits() -> Limits {
    Limits {
        robot: "me".to_owned(),
        max_connections: MAX_CONNECTIONS,
        option_folders: vec!["/etc/rect".into()],
    }
}

fn mistake(text: &str) -> String {
    parse(text, &limits()).expect_err("invalid").to_string()
}

/// Returns the text of a file with these connections, one per line, the first in line 2.
fn file(connections: &[&str]) -> String {
    format!("{{\"connections\": [\n{}\n]}}", connections.join(",\n"))
}

const BASE: &str = r#"{"name": "base", "method": "tcp", "address": "10.0.0.1", "port": 7447}"#;

#[test]
fn accepts_comments_and_trailing_commas() {
    let text = r#"// our robots
    {
      "$schema": "connections.schema.json",
      "connections": [
        /* by radio */
        { "name": "wombat-2", "method": "ble", "address": "wombat-2", "options": { "mtu": 500 } },
      ],
    }"#;
    let contents = parse(text, &limits()).expect("valid");
    assert_eq!(
        contents.connections[0].endpoint.to_string(),
        "ble/wombat-2#mtu=500"
    );
    assert_eq!(parse(&file(&[]), &limits()), Ok(FileContents::default()));
}

#[test]
fn reports_each_mistake_with_its_position() {
    for (text, place) in [
        ("", "1:1: the file must contain"),
        ("[]", "1:1: the file must contain"),
        ("{}", "1:1: the file must contain"),
        (
            "{\n  \"connections\": {}}",
            "2:18: connections must be a list",
        ),
        ("{\"connections\": [\n  1]}", "2:3: a connection must be"),
        (
            "{\"connections\": [], \"more\": 1}",
            "1:21: `more` is unknown",
        ),
        ("{\"connections\": [\n", "1:17: "),
        ("{\"connections\": [\0]}", "1:18: "),
    ] {
        let mistake = mistake(text);
        assert!(mistake.starts_with(place), "{text}: {mistake}");
    }
    for (connection, place) in [
        (r#"{"name": "a"}"#, "2:1: method is missing"),
        (r#"{"name": 1}"#, "2:10: name must be a string"),
        (r#"{"name": "a", "name": "b"}"#, "2:15: name is given twice"),
        (
            r#"{"name": "a", "port": 70000, "method": "tcp", "address": "h"}"#,
            "2:23: port must be",
        ),
        (
            r#"{"name": "a", "port": 1.5, "method": "tcp", "address": "h"}"#,
            "2:23: port must be",
        ),
        (
            r#"{"name": "a b", "method": "ble", "address": "h"}"#,
            "2:10: a name has",
        ),
        (
            r#"{"name": "a", "method": "tcp", "address": "h"}"#,
            "2:1: tcp needs a port",
        ),
        (r#"{"name": "a", "prot": 1}"#, "2:15: `prot` is unknown"),
        (
            r#"{"name": "a", "method": "ble", "address": "b", "options": {"mtu": []}}"#,
            "2:67: an option must be",
        ),
        (
            r#"{"name": "a", "method": "ble", "address": "b", "options": {"secret": "/root/key"}}"#,
            "2:70: option secret: the file must be",
        ),
    ] {
        let mistake = mistake(&file(&[connection]));
        assert!(mistake.starts_with(place), "{connection}: {mistake}");
    }
}

#[test]
fn a_duplicate_name_or_peer_is_reported_with_the_first_line() {
    assert!(
        mistake(&file(&[BASE, BASE])).starts_with("3:1: the name base is already used in line 2")
    );
    let other = BASE.replace("base", "other");
    assert!(mistake(&file(&[BASE, &other])).starts_with("3:1: other leads to the same peer"));
}

#[test]
fn rejects_a_connection_to_the_robot_itself() {
    let own = r#"{"name": "a", "method": "ble", "address": "me"}"#;
    let mistake = mistake(&file(&[BASE, own]));
    assert_eq!(mistake, "3:1: a leads to this robot itself");
}

#[test]
fn a_file_may_override_the_rule_for_automatic_connections() {
    let text = r#"{"auto_connect": "fleet", "auto_links": 2, "connections": []}"#;
    let contents = parse(text, &limits()).expect("valid");
    assert_eq!(contents.auto_connect, Some(AutoConnect::Fleet));
    assert_eq!(contents.auto_links, Some(2));
    for (text, place) in [
        (
            r#"{"auto_connect": "all", "connections": []}"#,
            "1:18: auto_connect must be",
        ),
        (
            r#"{"auto_connect": 1, "connections": []}"#,
            "1:18: auto_connect must be",
        ),
        (
            r#"{"auto_links": 0, "connections": []}"#,
            "1:16: auto_links must be 1 to 7",
        ),
        (
            r#"{"auto_links": 8, "connections": []}"#,
            "1:16: auto_links must be 1 to 7",
        ),
        (
            r#"{"auto_links": "2", "connections": []}"#,
            "1:16: auto_links must be",
        ),
    ] {
        let mistake = mistake(text);
        assert!(mistake.starts_with(place), "{text}: {mistake}");
    }
}

/// An editor that uses the schema accepts the same files as the router.
#[test]
fn the_schema_and_the_parser_agree() {
    let config = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../config");
    let text = |name| std::fs::read_to_string(config.join(name)).expect("a file");
    let schema = serde_json::from_str(&text("connections.schema.json")).expect("JSON");
    let schema = jsonschema::validator_for(&schema).expect("a schema");
    let agree = |text: &str| {
        let document = jsonc_parser::parse_to_serde_value(text, &json_with_comments());
        let ours = parse(text, &limits());
        let theirs = schema.is_valid(&document.expect("JSON"));
        assert_eq!(ours.is_ok(), theirs, "{text}: {ours:?}");
        theirs
    };
    assert!(agree(&text("connections.json")));
    let one = |fields: &str| agree(&file(&[&format!("{{{fields}}}")]));
    assert!(one(
        r#""name": "a", "method": "ble", "address": "b", "psm": 128, "options": {"mtu": 500}"#
    ));
    assert!(one(
        r#""name": "a", "method": "udp", "address": "::1", "port": 1"#
    ));
    assert!(one(
        r#""name": "a", "method": "unixsock-stream", "address": "/run/a""#
    ));
    for wrong in [
        r#""name": "a", "method": "ble""#,
        r#""name": "", "method": "ble", "address": "b""#,
        r#""name": "a b", "method": "ble", "address": "b""#,
        r#""name": 1, "method": "ble", "address": "b""#,
        r#""name": "a", "method": "tpc", "address": "b", "port": 1"#,
        r#""name": "a", "method": "tcp", "address": "b""#,
        r#""name": "a", "method": "tcp", "address": "b", "port": 0"#,
        r#""name": "a", "method": "tcp", "address": "b", "port": 65536"#,
        r#""name": "a", "method": "tcp", "address": "b", "port": "1""#,
        r#""name": "a", "method": "tcp", "address": "b", "port": 1, "psm": 128"#,
        r#""name": "a", "method": "ble", "address": "b", "port": 1"#,
        r#""name": "a", "method": "ble", "address": "b", "psm": 127"#,
        r#""name": "a", "method": "ble", "address": "b c""#,
        r#""name": "a", "method": "ble", "address": """#,
        r#""name": "a", "method": "ble", "address": "b", "more": 1"#,
        r#""name": "a", "method": "ble", "address": "b", "options": []"#,
        r#""name": "a", "method": "ble", "address": "b", "options": {"mtu": null}"#,
    ] {
        assert!(!one(wrong), "{wrong}");
    }
    assert!(agree(
        r#"{"connections": [], "auto_connect": "none", "auto_links": 7}"#
    ));
    for rule in [
        r#""auto_connect": "all""#,
        r#""auto_links": 8"#,
        r#""auto_links": 1.5"#,
    ] {
        assert!(!agree(&format!(r#"{{"connections": [], {rule}}}"#)));
    }
    assert!(!agree("{}") && !agree("[]") && !agree(r#"{"connections": [], "more": 1}"#));
}

#[test]
fn enforces_the_limits_at_their_boundaries() {
    let many: Vec<_> = (0..=MAX_CONNECTIONS)
        .map(|n| format!(r#"{{"name": "r{n}", "method": "ble", "address": "r{n}"}}"#))
        .collect();
    let many: Vec<_> = many.iter().map(String::as_str).collect();
    assert_eq!(
        (parse(&file(&many[..MAX_CONNECTIONS]), &limits()).expect("valid"))
            .connections
            .len(),
        MAX_CONNECTIONS
    );
    assert!(mistake(&file(&many)).starts_with("5:1: too many connections"));

    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("connections.json");
    let written = |bytes: &[u8]| {
        File::create(&path)
            .and_then(|mut file| file.write_all(bytes))
            .expect("written");
        read(&path, &limits())
            .map(|contents| contents.connections.len())
            .map_err(|error| error.to_string())
    };
    assert_eq!(written(file(&[BASE]).as_bytes()), Ok(1));
    assert!(written(b"{\n\xff").is_err_and(|e| e.ends_with(":2:1: this is not valid UTF-8 text")));
    let blanks = vec![b' '; MAX_BYTES as usize + 1];
    assert!(written(&blanks).is_err_and(|e| e.contains("larger")));
    assert!(written(&blanks[1..]).is_err_and(|e| e.contains("the file must contain")));
    let deep = "[".repeat(100_000);
    assert!(written(deep.as_bytes()).is_err_and(|e| e.contains("depth")));
    let nowhere = read(&folder.path().join("nowhere"), &limits()).expect_err("missing");
    assert!(nowhere.to_string().contains("nowhere"));
}

#[test]
fn rejects_a_pipe_without_blocking() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("connections.json");
    nix::unistd::mkfifo(&path, nix::sys::stat::Mode::S_IRWXU).expect("a pipe");
    let error = read(&path, &limits()).expect_err("a pipe");
    assert!(matches!(error, FileError::Unreadable { .. }), "{error}");
}
