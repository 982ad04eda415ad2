//! Tests groups of parameters with their files: `cargo test -p rect-core parameters`
use std::{
    fs,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use super::{
    file::{self, ParametersFile},
    group::{Group, Work},
    order::{InForce, Order, Reset, Snapshot, Stored},
    Declaration, Parameter, Value,
};
use crate::{
    message::{encoding::Encoding, payload::Payload},
    stream::simulation::Random,
};

fn declaration() -> Declaration {
    Declaration::new(vec![
        Parameter::new("kp", 1.0).range(0.0, 10.0),
        Parameter::new("side", "left").choices(["left", "right"]),
        Parameter::new("turbo", false),
        Parameter::new("serial", 7).read_only(),
        Parameter::new("points", vec![0.0]),
    ])
    .expect("valid")
}

fn group(path: &Path) -> (Group, Vec<String>) {
    Group::new(declaration(), Some(ParametersFile::new(path)))
}

/// Carries out an order of the robot `laptop`.
fn change(group: &mut Group, order: Order, now: Instant) -> Result<Vec<String>, String> {
    let proposal = group.propose(order, false)?;
    let change = group.commit(&proposal, Some("laptop"), now);
    let changed = change.map(|change| change.changed).unwrap_or_default();
    Ok(changed
        .into_iter()
        .map(|changed| format!("{} {} {}", changed.name, changed.old, changed.new))
        .collect())
}

fn set<V: Into<Value> + Clone>(values: &[(&str, V)]) -> Order {
    Order::set(values.iter().map(|(name, value)| (*name, value.clone())))
}

/// Stores what has changed. Returns a warning.
fn save(group: &mut Group, now: Instant) -> Option<String> {
    let mut saving = group.begin_saving()?;
    saving.run();
    group.on_saved(saving, now)
}

fn value(group: &Group, name: &str) -> String {
    group.value(name).expect("declared").to_string()
}

#[test]
fn a_change_is_in_force_at_once_then_published_and_then_stored() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("wombat/drive.json");
    let start = Instant::now();
    let (mut group, warnings) = group(&path);
    assert_eq!(warnings, [""; 0]);
    let Work::Publish(first) = group.work(start) else {
        panic!("the values are published at the start");
    };
    let first: Snapshot = first.value().expect("a snapshot");
    assert_eq!((first.values.len(), first.changed.len()), (5, 0));
    assert!(matches!(group.work(start), Work::Wait(None)));

    let order = Order {
        by: "page".to_owned(),
        ..set(&[("kp", Value::from(2)), ("side", "right".into())])
    };
    let proposal = group.propose(order, false).expect("valid");
    let change = group
        .commit(&proposal, Some("laptop"), start)
        .expect("a change");
    assert_eq!(
        (change.by.as_str(), change.changed.len()),
        ("laptop/page", 2)
    );
    let reply: InForce = group.in_force(&proposal).value().expect("a reply");
    assert_eq!(reply.values.len(), 2);
    assert_eq!(group.stored(group.revision()), None);
    let Work::Publish(second) = group.work(start) else {
        panic!("the change is published");
    };
    let second: Snapshot = second.value().expect("a snapshot");
    assert_eq!(second.values["kp"], Value::Number(2.0));
    assert_eq!(
        (second.changed.len(), second.by.as_str()),
        (2, "laptop/page")
    );
    let Work::Wait(Some(at)) = group.work(start) else {
        panic!("it waits for further changes");
    };
    assert!(at - start <= Duration::from_secs(1));
    assert!(!path.exists());
    assert!(matches!(group.work(at), Work::Save));
    assert_eq!(save(&mut group, at), None);
    let stored: Stored = group
        .stored(group.revision())
        .expect("it is stored")
        .value()
        .expect("a reply");
    assert!(stored.stored);
    // People read it, so it has only what somebody has changed.
    let text = fs::read_to_string(&path).expect("written");
    assert_eq!(text, "{\n  \"kp\": 2.0,\n  \"side\": \"right\"\n}\n");
    let (again, warnings) = self::group(&path);
    assert_eq!((value(&again, "kp"), warnings.len()), ("2".to_owned(), 0));
}

#[test]
fn an_order_is_carried_out_as_a_whole_or_refused_with_a_reason() {
    let now = Instant::now();
    let (mut group, _) = Group::new(declaration(), None);
    for (order, reason) in [
        (
            set(&[("kp", 2.0), ("kpp", 1.0)]),
            "there is no parameter \"kpp\"; did you mean kp?",
        ),
        (set(&[("kp", 2.0), ("side", 1.0)]), "side cannot be 1"),
        (set(&[("serial", 8)]), "serial is read-only"),
        (
            Order {
                reset: Reset::Some(vec!["kpp".to_owned()]),
                ..set(&[("kp", 3.0)])
            },
            "did you mean kp?",
        ),
    ] {
        let refused = change(&mut group, order, now).expect_err(reason);
        assert!(refused.contains(reason), "{refused}");
        assert_eq!(value(&group, "kp"), "1");
    }
    assert_eq!(change(&mut group, set(&[("kp", 1.0)]), now), Ok(vec![]));
    let both = Order {
        reset: Reset::All(true),
        ..set(&[("kp", 4.0)])
    };
    assert_eq!(change(&mut group, both, now), Ok(vec!["kp 1 4".to_owned()]));
    // The program itself may change everything.
    let own = group.propose(set(&[("serial", 8)]), true).expect("its own");
    assert_eq!(group.commit(&own, None, now).expect("a change").by, "");
    let reset = Order {
        reset: Reset::All(true),
        ..Order::default()
    };
    assert_eq!(
        change(&mut group, reset, now),
        Ok(vec!["kp 4 1".to_owned()])
    );
    assert_eq!(value(&group, "serial"), "8");
    let stored: Stored = group
        .stored(group.revision())
        .expect("an answer")
        .value()
        .expect("a reply");
    assert!(
        !stored.stored && stored.reason.contains("file"),
        "{stored:?}"
    );
}

#[test]
fn orders_of_peers_are_read_with_limits() {
    let json = |text: &str| Payload::new(text.to_owned(), Encoding::JSON);
    let order = Order::read(&json(
        r#"{"set":{"a":1,"b":"x","c":[1,2.5]},"reset":["d"]}"#,
    ));
    assert_eq!(order.expect("valid").set.len(), 3);
    // A stock program leaves out the encoding.
    let bytes = Payload::new(r#"{"reset":true}"#, Encoding::BYTES);
    assert_eq!(Order::read(&bytes).expect("valid").reset, Reset::All(true));
    let long = json(&format!(r#"{{"by":"{}\u001b"}}"#, "x".repeat(500)));
    assert_eq!(Order::read(&long).expect("valid").by.len(), 60);
    for (wrong, reason) in [
        (
            r#"{"set":{"a":null}}"#,
            "a bool, number, text or list of numbers",
        ),
        (r#"{"set":{"a":{"b":1}}}"#, "list of numbers"),
        (r#"{"set":1}"#, "the request must be like"),
        (r#"{"reset":3}"#, "a list of names"),
        ("", "the request must be like"),
    ] {
        let refused = Order::read(&json(wrong)).expect_err(reason);
        assert!(refused.contains(reason), "{refused}");
    }
    let large = Payload::new(vec![b' '; 1 << 20], Encoding::JSON);
    assert!(Order::read(&large)
        .expect_err("too large")
        .contains("allowed"));
}

#[test]
fn a_file_that_does_not_fit_costs_only_what_does_not_fit() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.json");
    fs::write(
        &path,
        r#"{"kp": 2, "side": "up", "turbo": null, "old": [{}], "kp": 3, "serial": 9}"#,
    )
    .expect("written");
    let now = Instant::now();
    let (mut group, warnings) = group(&path);
    let all = warnings.join("\n");
    for part in [
        "kp occurs twice",
        "side cannot be \"up\"",
        "turbo: a bool",
        "no parameters old",
    ] {
        assert!(all.contains(part), "{all}");
    }
    assert_eq!(warnings.len(), 4);
    let values = ["kp", "side", "turbo", "serial"].map(|name| value(&group, name));
    assert_eq!(values, ["3", "\"left\"", "false", "9"]);
    // Values that the program does not know, and those that do not fit, remain until they are changed.
    change(&mut group, set(&[("kp", 1.0)]), now).expect("valid");
    assert_eq!(save(&mut group, now), None);
    let text = fs::read_to_string(&path).expect("written");
    assert!(
        !text.contains("kp") && text.contains("old") && text.contains("up"),
        "{text}"
    );
}

#[test]
fn a_damaged_file_is_moved_aside_by_the_next_change() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.json");
    for damage in ["{\"kp\": 2", "[1]", "{} {}", "\u{0}\u{0}"] {
        fs::write(&path, damage).expect("written");
        let (mut group, warnings) = group(&path);
        assert_eq!((warnings.len(), value(&group, "kp").as_str()), (1, "1"));
        let now = Instant::now();
        change(&mut group, set(&[("kp", 5.0)]), now).expect("valid");
        let warning = save(&mut group, now).expect("a warning");
        let damaged = folder.path().join("drive.damaged.json");
        assert!(warning.contains("drive.damaged.json"), "{warning}");
        assert_eq!(fs::read_to_string(&damaged).expect("moved"), damage);
        assert_eq!(value(&self::group(&path).0, "kp"), "5");
    }
}

#[test]
fn an_edit_while_the_program_runs_remains_in_the_file() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("drive.json");
    let (mut group, _) = group(&path);
    let now = Instant::now();
    change(&mut group, set(&[("kp", 5.0)]), now).expect("valid");
    assert_eq!(save(&mut group, now), None);
    fs::write(&path, r#"{"kp": 6, "side": "right"}"#).expect("edited");
    change(&mut group, set(&[("turbo", true)]), now).expect("valid");
    let warning = save(&mut group, now).expect("a warning");
    assert!(warning.contains("kp, side there"), "{warning}");
    // It is reported once, and later changes keep the edit as well.
    change(&mut group, set(&[("turbo", false)]), now).expect("valid");
    assert_eq!(save(&mut group, now), None);
    let (next, _) = self::group(&path);
    assert_eq!(
        (value(&next, "kp").as_str(), value(&next, "side").as_str()),
        ("6", "\"right\"")
    );
    change(&mut group, set(&[("kp", 7.0)]), now).expect("valid");
    assert_eq!(save(&mut group, now), None);
    assert_eq!(value(&self::group(&path).0, "kp"), "7");
}

#[test]
fn a_file_that_cannot_be_written_is_reported_once_and_tried_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let blocked = folder.path().join("robot");
    fs::write(&blocked, "not a folder").expect("written");
    let path = blocked.join("drive.json");
    let (mut group, _) = group(&path);
    let now = Instant::now();
    change(&mut group, set(&[("kp", 5.0)]), now).expect("valid");
    let revision = group.revision();
    let warning = save(&mut group, now).expect("a warning");
    assert!(warning.contains("cannot write"), "{warning}");
    let stored: Stored = group
        .stored(revision)
        .expect("an answer")
        .value()
        .expect("a reply");
    assert!(!stored.stored && stored.reason == warning, "{stored:?}");
    assert_eq!(value(&group, "kp"), "5");
    fs::remove_file(&blocked).expect("removed");
    assert!(matches!(group.work(now), Work::Publish(_)));
    let Work::Wait(Some(again)) = group.work(now) else {
        panic!("it is tried again");
    };
    assert_eq!(save(&mut group, again), None);
    assert_eq!(value(&self::group(&path).0, "kp"), "5");
}

#[test]
fn the_path_follows_the_environment() {
    let of = |set: &[(&str, &str)]| {
        let set: Vec<_> = set
            .iter()
            .map(|(name, value)| (name.to_string(), value.to_string()))
            .collect();
        let variable = move |name: &str| {
            let found = set.iter().find(|(known, _)| known == name);
            found.map(|(_, value)| value.into())
        };
        file::path("wombat", "drive", variable).map(|path| path.display().to_string())
    };
    assert_eq!(of(&[]), None);
    assert_eq!(of(&[("HOME", "")]), None);
    let home = ("HOME", "/home/kipr");
    let expected = "/home/kipr/.local/state/rect/parameters/wombat/drive.json";
    assert_eq!(of(&[home]).as_deref(), Some(expected));
    let all = [
        home,
        ("XDG_STATE_HOME", "/state"),
        ("RECT_PARAMETERS", "/kept"),
    ];
    assert_eq!(
        of(&all[..2]).as_deref(),
        Some("/state/rect/parameters/wombat/drive.json")
    );
    assert_eq!(of(&all).as_deref(), Some("/kept/wombat/drive.json"));
}

/// Runs of a program that is killed and restarted while others change two parameters that always have the same value.
#[test]
fn no_setting_that_was_stored_is_lost_and_none_is_half_applied_in_1000_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let path: PathBuf = folder.path().join("pair.json");
    for seed in 0..1000 {
        let mut random = Random(seed);
        let mut below = |limit: u64| random.next() % limit;
        drop(fs::remove_file(&path));
        let pair = || {
            let pair = ["left", "right"].map(|name| Parameter::new(name, 0).range(0.0, 100.0));
            let declaration = Declaration::new(pair.into()).expect("valid");
            Group::new(declaration, Some(ParametersFile::new(&path))).0
        };
        let (mut group, mut now) = (pair(), Instant::now());
        // The value that is in force, and the values that may be in the file: the one that was stored last, or one after it.
        let (mut current, mut stored): (i64, i64) = (0, 0);
        let mut later: Vec<i64> = Vec::new();
        for _ in 0..8 + below(12) {
            now += Duration::from_millis(below(400));
            match below(10) {
                0..=5 => {
                    // Some of them are out of range.
                    let number = i64::try_from(below(130)).expect("small");
                    let order = set(&[("left", number), ("right", number)]);
                    if change(&mut group, order, now).is_ok() {
                        current = number;
                        later.push(number);
                    } else {
                        assert!(number > 100, "{seed}");
                    }
                }
                6 => {
                    let wrong = set(&[("left", Value::from(5)), ("right", "x".into())]);
                    assert!(change(&mut group, wrong, now).is_err());
                }
                7 | 8 => {
                    let saved = save(&mut group, now);
                    assert_eq!(saved, None, "{seed}");
                    if group.stored(group.revision()).is_some() {
                        stored = current;
                        later.clear();
                    }
                }
                _ => {
                    // The kill may come while the file is written.
                    let saving = group.begin_saving();
                    if let (Some(mut saving), 0) = (saving, below(2)) {
                        saving.run();
                    }
                    group = pair();
                    let [left, right] = ["left", "right"].map(|name| value(&group, name));
                    assert_eq!(left, right, "half applied, seed {seed}");
                    current = left.parse().expect("a number");
                    assert!(
                        current == stored || later.contains(&current),
                        "lost, seed {seed}"
                    );
                    (stored, later) = (current, Vec::new());
                }
            }
            let [left, right] = ["left", "right"].map(|name| value(&group, name));
            assert_eq!(
                (&left, &right),
                (&current.to_string(), &current.to_string())
            );
        }
    }
}
