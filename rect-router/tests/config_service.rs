//! A robot's connections read and changed by a query: `cargo test -p rect-router --test config_service`

mod support;

use std::{fs, thread, time::Duration};

use serde_json::{json, Value};
use support::{answers, ask, ble, change, client, connected, file, tcp, Air, Wombat};
use zenoh::{Session, Wait};

/// Wombat-1's.
const KEY: &str = "rect/wombat-1/@rect/@config/connections";

/// What comes back for a new text, or the error that does.
fn replaced(session: &Session, parameters: &str, text: &str) -> Result<Value, String> {
    change(session, &format!("{KEY}{parameters}"), text).expect("an answer")
}

#[test]
fn connections_are_read_and_changed_by_a_query_from_another_robot() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let mut one = Wombat::start(&air, &folder, 1, &file(&[ble("radio", "wombat-2")]));
    let there = client(&two.endpoint);
    let before = ask(&there, KEY).expect("an answer");
    assert!(
        before["text"]
            .as_str()
            .is_some_and(|text| text.contains("radio")),
        "{before:#}"
    );
    let revision = before["revision"].as_str().expect("a revision");

    let wanted = format!(
        "// by query\n{}",
        file(&[ble("radio", "wombat-2"), tcp("base", 1)])
    );
    let expected = format!("?expect={revision};by=wombat-2");
    let changed = replaced(&there, &expected, &wanted).expect("changed");
    assert_eq!(changed["added"], json!(["base"]), "{changed:#}");
    one.router
        .wait_for("the connections are changed by wombat-2: added base");
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), wanted);
    let registry = "rect/wombat-1/@rect/connections?name=base";
    answers(&there, registry, |all| all[0]["state"] == "connecting");

    // What it does by itself, too.
    let here = client(&one.endpoint);
    let rule = "{\"auto_connect\": \"fleet\", \"auto_links\": 1, \"connections\": []}";
    let changed_rule = replaced(&here, "", rule).expect("changed");
    assert_eq!(changed_rule["rule_changed"], true, "{changed_rule:#}");
    let status = answers(&here, "rect/wombat-1/@rect/status", |status| {
        status["auto_connect"] == "fleet"
    });
    assert_eq!(status["auto_links"], 1, "{status:#}");
    // It had a link with wombat-2 by name, and has one with it as one of the fleet now.
    let linked = "rect/wombat-1/@rect/connections?method=ble;peer=wombat-2";
    let linked = answers(&here, linked, |all| {
        all[0]["name"].is_null() && connected(all) == 1
    });
    assert_eq!(linked.as_array().map(Vec::len), Some(1), "{linked:#}");
    let back = replaced(&here, "", &wanted).expect("changed");
    assert_eq!(back["added"], json!(["radio", "base"]), "{back:#}");
    // By its name again, whoever dialled.
    let radio = "rect/wombat-1/@rect/connections?name=radio";
    let radio = answers(&here, radio, |all| all[0]["peer"]["robot"] == "wombat-2");
    assert!(radio[0]["sent"]["bytes"].as_u64() > Some(0), "{radio:#}");
    assert!(radio[0]["up_s"].as_f64() > Some(0.0), "{radio:#}");
    ask(&there, KEY).expect("is asked by radio again");

    // A second one who has read the same, nonsense, and what is too much: nothing changes.
    let none = "{\"connections\": []}";
    let outdated = replaced(&there, &format!("?expect={revision}"), none);
    assert!(outdated.is_err_and(|e| e.contains(changed["revision"].as_str().expect("text"))));
    let wrong = replaced(&there, "", "{\"connections\": [\n  {\"name\": \"a\"}]}");
    assert!(wrong.is_err_and(|e| e.contains("2:3: method is missing")));
    let blanks = " ".repeat(2 << 20);
    let too_much = replaced(&client(&one.endpoint), "", &blanks);
    assert!(too_much.is_err_and(|e| e.contains("more than 1048576 bytes")));
    let unknown = replaced(&there, "?expects=1", none);
    assert!(unknown.is_err_and(|e| e.contains("`expects` is unknown")));
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), wanted);
}

#[test]
fn one_connection_is_added_or_removed_and_the_rest_of_the_file_stays() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let one = Wombat::start(&air, &folder, 1, &file(&[]));
    let here = client(&one.endpoint);
    let text = format!("// ours\n{}", file(&[tcp("base", 1)]));
    replaced(&here, "", &text).expect("changed");
    let added = replaced(&here, "?add;by=me", &tcp("laptop", 2).to_string()).expect("added");
    assert_eq!(added["added"], json!(["laptop"]), "{added:#}");
    let again = replaced(&here, "?add", &tcp("laptop", 2).to_string()).expect("as it is");
    assert_eq!(again["revision"], added["revision"]);
    let removed = replaced(&here, "?remove", "base").expect("removed");
    assert_eq!(removed["removed"], json!(["base"]), "{removed:#}");
    let left = fs::read_to_string(&one.file).expect("the file");
    assert!(
        left.starts_with("// ours\n") && left.contains("laptop"),
        "{left}"
    );
    let unknown = replaced(&here, "?remove", "base");
    assert!(unknown.is_err_and(|e| e.contains("there are: laptop")));
    let wrong = replaced(
        &here,
        "?add",
        r#"{"name": "x", "method": "tcp", "address": "a"}"#,
    );
    assert!(wrong.is_err_and(|e| e.contains("tcp needs a port")));
    assert_eq!(fs::read_to_string(&one.file).expect("the file"), left);
}

#[test]
fn who_removes_or_changes_the_connection_he_comes_over_is_answered_first() {
    let over_tcp = |two: &Wombat| tcp("way", two.port());
    let by_radio = |_: &Wombat| ble("way", "wombat-2");
    for way in [&over_tcp as &dyn Fn(&Wombat) -> Value, &by_radio] {
        is_answered_first(way, &file(&[]), "removed", None);
        is_answered_first(way, &file(&[tcp("way", 1)]), "changed", Some("connecting"));
    }
}

/// Wombat-1 has the connection `way` with wombat-2, from where its connections become `after`; it is `told` what that did to
/// `way`, whose state is `then` another.
fn is_answered_first(
    way: &dyn Fn(&Wombat) -> Value,
    after: &Value,
    told: &str,
    then: Option<&str>,
) {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    let two = Wombat::start(&air, &folder, 2, &file(&[]));
    let one = Wombat::start(&air, &folder, 1, &file(&[way(&two)]));
    let (here, there) = (client(&one.endpoint), client(&two.endpoint));
    ask(&there, KEY).expect("the way is known");
    // It is the only one, and soon there is none.
    let answer = replaced(&there, "", &after.to_string()).expect("changed");
    assert_eq!(answer[told], json!(["way"]), "{answer:#}");
    let state = "rect/wombat-1/@rect/connections?name=way";
    answers(&here, state, |all| all[0]["state"].as_str() == then);
    // This program is left.
    let of_two = "rect/wombat-2/@rect/connections/count";
    answers(&there, of_two, |count| count["connected"] == 1);
}

#[test]
fn a_router_killed_while_its_connections_are_changed_leaves_the_old_file_or_the_new_one() {
    let (air, folder) = (Air::new(), tempfile::tempdir().expect("a folder"));
    // Large enough to be killed in the middle of.
    let text = |name: &str| {
        let comment = format!("// {}\n", name.repeat(100_000));
        comment + &file(&[ble(name, name)]).to_string()
    };
    let texts = [text("a"), text("b")];
    for round in 0..10 {
        let one = Wombat::start(&air, &folder, 1, &file(&[]));
        let (path, here) = (one.file.clone(), client(&one.endpoint));
        let new = texts.clone();
        let changing = thread::spawn(move || {
            // Until nobody answers any more.
            for text in new.iter().cycle() {
                let replies = here.get(KEY).payload(text.as_str());
                let replies = replies.timeout(Duration::from_secs(1)).wait();
                if !replies.is_ok_and(|replies| replies.recv().is_ok()) {
                    return;
                }
            }
        });
        while !texts.contains(&fs::read_to_string(&path).expect("the file")) {
            thread::yield_now();
        }
        // At another moment of a change each time.
        thread::sleep(Duration::from_millis(3 * round));
        drop(one);
        changing.join().expect("no panic");
        let left = fs::read_to_string(&path).expect("the file");
        assert!(texts.contains(&left), "round {round}: {} bytes", left.len());
    }
}
