//! Tests of the config service: `cargo test -p rect-router --test behaviour config_service`

use std::{fs, thread, time::Duration};

use crate::support::{answers, ask, ble, change, client, connected, file, tcp, Air, Wombat};
use serde_json::{json, Value};
use zenoh::{Session, Wait};

/// Key of wombat-1's config service.
const KEY: &str = "rect/wombat-1/@rect/@config/connections";

/// Sends a change to the config service, and returns the reply or the error that it contains.
fn replaced(session: &Session, parameters: &str, text: &str) -> Result<Value, String> {
    change(session, &format!("{KEY}{parameters}"), text).expect("an answer")
}

#[test]
fn another_robot_reads_and_changes_the_connections() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let mut one = Wombat::start(&air, &folder, 1, &file(&[ble("radio", "wombat-2")]));
    let remote = client(&two.endpoint);
    let before = ask(&remote, KEY).expect("an answer");
    assert!(
        before["text"]
            .as_str()
            .is_some_and(|text| text.contains("radio")),
        "{before:#}"
    );
    let revision = before["revision"].as_str().expect("a revision");

    let new_text = format!(
        "// by query\n{}",
        file(&[ble("radio", "wombat-2"), tcp("base", 1)])
    );
    let expected = format!("?expect={revision};by=wombat-2");
    let changed = replaced(&remote, &expected, &new_text).expect("changed");
    assert_eq!(changed["added"], json!(["base"]), "{changed:#}");
    one.router
        .wait_for("the connections are changed by wombat-2: added base");
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), new_text);
    let registry = "rect/wombat-1/@rect/connections?name=base";
    answers(&remote, registry, |all| all[0]["state"] == "connecting");

    // The rule for automatic connections can be changed, too.
    let local = client(&one.endpoint);
    let rule = "{\"auto_connect\": \"fleet\", \"auto_links\": 1, \"connections\": []}";
    let changed_rule = replaced(&local, "", rule).expect("changed");
    assert_eq!(changed_rule["rule_changed"], true, "{changed_rule:#}");
    let status = answers(&local, "rect/wombat-1/@rect/status", |status| {
        status["auto_connect"] == "fleet"
    });
    assert_eq!(status["auto_links"], 1, "{status:#}");
    // The named connection to wombat-2 was removed, but there is a link to it as a robot of the fleet.
    let linked = "rect/wombat-1/@rect/connections?method=ble;peer=wombat-2";
    let linked = answers(&local, linked, |all| {
        all[0]["name"].is_null() && connected(all) == 1
    });
    assert_eq!(linked.as_array().map(Vec::len), Some(1), "{linked:#}");
    let back = replaced(&local, "", &new_text).expect("changed");
    assert_eq!(back["added"], json!(["radio", "base"]), "{back:#}");
    // The link has its name again, whichever robot dialled it.
    let radio = "rect/wombat-1/@rect/connections?name=radio";
    let radio = answers(&local, radio, |all| all[0]["peer"]["robot"] == "wombat-2");
    assert!(radio[0]["sent"]["bytes"].as_u64() > Some(0), "{radio:#}");
    assert!(radio[0]["up_s"].as_f64() > Some(0.0), "{radio:#}");
    ask(&remote, KEY).expect("an answer over the air");

    // An outdated revision, an invalid text and a text that is too large change nothing.
    let none = "{\"connections\": []}";
    let outdated = replaced(&remote, &format!("?expect={revision}"), none);
    assert!(outdated.is_err_and(|e| e.contains(changed["revision"].as_str().expect("text"))));
    let wrong = replaced(&remote, "", "{\"connections\": [\n  {\"name\": \"a\"}]}");
    assert!(wrong.is_err_and(|e| e.contains("2:3: method is missing")));
    let blanks = " ".repeat(2 << 20);
    let too_much = replaced(&client(&one.endpoint), "", &blanks);
    assert!(too_much.is_err_and(|e| e.contains("more than 1048576 bytes")));
    let unknown = replaced(&remote, "?expects=1", none);
    assert!(unknown.is_err_and(|e| e.contains("`expects` is unknown")));
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), new_text);
}

#[test]
fn adding_or_removing_a_connection_preserves_the_rest_of_the_file() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let local = client(&one.endpoint);
    let text = format!("// ours\n{}", file(&[tcp("base", 1)]));
    replaced(&local, "", &text).expect("changed");
    let added = replaced(&local, "?add;by=me", &tcp("laptop", 2).to_string()).expect("added");
    assert_eq!(added["added"], json!(["laptop"]), "{added:#}");
    let again = replaced(&local, "?add", &tcp("laptop", 2).to_string()).expect("unchanged");
    assert_eq!(again["revision"], added["revision"]);
    let removed = replaced(&local, "?remove", "base").expect("removed");
    assert_eq!(removed["removed"], json!(["base"]), "{removed:#}");
    let left = fs::read_to_string(&one.file).expect("the file");
    assert!(
        left.starts_with("// ours\n") && left.contains("laptop"),
        "{left}"
    );
    let unknown = replaced(&local, "?remove", "base");
    assert!(unknown.is_err_and(|e| e.contains("there are: laptop")));
    let wrong = replaced(
        &local,
        "?add",
        r#"{"name": "x", "method": "tcp", "address": "a"}"#,
    );
    assert!(wrong.is_err_and(|e| e.contains("tcp needs a port")));
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), left);
}

#[test]
fn replies_before_closing_the_link_of_the_requester() {
    let over_tcp = |two: &Wombat| tcp("way", two.port());
    let by_radio = |_: &Wombat| ble("way", "wombat-2");
    for way in [&over_tcp as &dyn Fn(&Wombat) -> Value, &by_radio] {
        replies_first(way, &file(&[]), "removed", None);
        replies_first(way, &file(&[tcp("way", 1)]), "changed", Some("connecting"));
    }
}

/// Changes the connections of wombat-1 to `after` from wombat-2, to which wombat-1 has only the connection `way`. The reply
/// must list `way` under `change`, and its state must then be `state_after`.
fn replies_first(
    way: &dyn Fn(&Wombat) -> Value,
    after: &Value,
    change: &str,
    state_after: Option<&str>,
) {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[way(&two)]));
    let (local, remote) = (client(&one.endpoint), client(&two.endpoint));
    ask(&remote, KEY).expect("wombat-1 answers");
    // This closes the only link between the two.
    let answer = replaced(&remote, "", &after.to_string()).expect("changed");
    assert_eq!(answer[change], json!(["way"]), "{answer:#}");
    let state = "rect/wombat-1/@rect/connections?name=way";
    answers(&local, state, |all| all[0]["state"].as_str() == state_after);
    // Only this test's session is left.
    let of_two = "rect/wombat-2/@rect/connections/count";
    answers(&remote, of_two, |count| count["connected"] == 1);
}

#[test]
fn killing_the_router_during_a_change_leaves_the_old_file_or_the_new_one() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    // The texts are large, so that the router can be killed while it writes one.
    let text = |name: &str| {
        let comment = format!("// {}\n", name.repeat(100_000));
        comment + &file(&[ble(name, name)]).to_string()
    };
    let texts = [text("a"), text("b")];
    for round in 0..10 {
        let one = Wombat::start(&air, &folder, 1, &file(&[]));
        let (path, local) = (one.file.clone(), client(&one.endpoint));
        let new = texts.clone();
        let changing = thread::spawn(move || {
            // The loop ends when the router no longer answers.
            for text in new.iter().cycle() {
                let replies = local.get(KEY).payload(text.as_str());
                let replies = replies.timeout(Duration::from_secs(1)).wait();
                if !replies.is_ok_and(|replies| replies.recv().is_ok()) {
                    return;
                }
            }
        });
        while !texts.contains(&fs::read_to_string(&path).expect("the file")) {
            thread::yield_now();
        }
        // Each round kills the router at another moment of a change.
        thread::sleep(Duration::from_millis(3 * round));
        drop(one);
        changing.join().expect("no panic");
        let left = fs::read_to_string(&path).expect("the file");
        assert!(texts.contains(&left), "round {round}: {} bytes", left.len());
    }
}
