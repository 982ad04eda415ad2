//! Tests `rect record`, `rect replay` and `rect recording`: `cargo test -p rect-cli --test command recording`
use std::{
    collections::BTreeMap,
    fs,
    io::{BufRead, BufReader, Write},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Output, Stdio},
    time::{Duration, Instant},
};

use rect::{
    blocking, Json, Level, LogLine, Message, Options, Payload, QueueOptions, RecordOptions,
    StreamOptions, Urgency, WhenFull,
};
use rect_core::{
    codec::picture::{Format, Picture},
    message::encoding::Encoding,
    video::bitstream::is_key_frame,
};
use rect_recording::{
    file::{self, OpenFile},
    log, Entry, ReadError, Reader, RetainedKind,
};

use crate::pair::{free_endpoint, pair, stock_client, TIMEOUT};
use zenoh::Wait;

fn entry(sequence: u32) -> Entry {
    let topics = ["a/pose", "b/camera/front", "a/log"];
    let encodings = [Encoding::JSON, Encoding::JPEG, Encoding::TEXT];
    let kind = sequence as usize % topics.len();
    let urgency = [Urgency::Normal, Urgency::Bulk, Urgency::Urgent][kind];
    let logged = Duration::from_millis(1_795_000_000_000 + u64::from(sequence) * 20);
    Entry {
        topic: topics[kind].to_owned(),
        recipient: (kind == 2).then(|| "c".to_owned()),
        payload: Payload::new(format!("{{\"n\": {sequence}}}"), encodings[kind].clone()),
        urgency,
        sequence,
        publisher: (kind == 0).then_some(7),
        logged,
        sent: logged - Duration::from_millis(3),
        retained: None,
        foreign: None,
    }
}

fn about() -> BTreeMap<String, String> {
    BTreeMap::from([("robot".to_owned(), "a".to_owned())])
}

fn read(path: &Path) -> (Vec<Entry>, Option<ReadError>) {
    let (mut entries, mut error) = (Vec::new(), None);
    match Reader::open(path) {
        Ok(reader) => reader.for_each(|read| match read {
            Ok(entry) => entries.push(entry),
            Err(failed) => error = Some(failed),
        }),
        Err(failed) => error = Some(failed),
    }
    (entries, error)
}

fn wait_until(what: &str, is_so: impl Fn() -> bool) {
    let deadline = Instant::now() + TIMEOUT;
    while !is_so() {
        assert!(Instant::now() < deadline, "{what}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn rect(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
    command
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::null());
    command
}

fn ran(folder: &Path, arguments: &[&str]) -> Output {
    rect(folder, arguments).output().expect("started")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

struct Killed(Child);

impl Killed {
    fn signal(&self, name: &str) {
        let id = self.0.id().to_string();
        let sent = Command::new("kill").args([name, &id]).status();
        assert!(sent.expect("started").success());
    }

    fn end(&mut self) -> ExitStatus {
        self.0.wait().expect("ended")
    }
}

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Starts a program of the robot `a`, and `rect record` at it; returns when its messages arrive.
fn recorded(folder: &Path) -> (blocking::Robot, Killed) {
    recorded_at(folder, &free_endpoint())
}

/// Does the same at an endpoint.
fn recorded_at(folder: &Path, endpoint: &str) -> (blocking::Robot, Killed) {
    let options = Options::new("a").expect("a name").login_file("/none");
    let robot = blocking::Robot::connect(options.listen(endpoint)).expect("connected");
    let arguments = [
        "record",
        "a/**",
        "--as",
        "b",
        "--router",
        endpoint,
        "-o",
        "match.mcap",
    ];
    let mut child = rect(folder, &arguments);
    let child = child.stdout(Stdio::null()).stderr(Stdio::piped());
    let mut recording = Killed(child.spawn().expect("started"));
    let mut line = String::new();
    let mut lines = BufReader::new(recording.0.stderr.take().expect("piped"));
    while !line.contains("recording a/**") {
        line.clear();
        assert!(lines.read_line(&mut line).expect("text") > 0, "it ended");
    }
    std::thread::spawn(move || lines.lines().for_each(drop));
    let publisher = robot.publisher::<Payload>("n").expect("declared");
    publisher.wait_for_subscriber(TIMEOUT).expect("recording");
    (robot, recording)
}

#[test]
fn recorded_messages_are_replayed() {
    let folder = tempfile::tempdir().expect("a folder");
    let (robot, mut recording) = recorded(folder.path());
    let picture: Vec<u8> = (0..20_000u32).map(|n| (n * 7 % 251) as u8).collect();
    for n in 0..100u32 {
        robot.publish("n", Json(n)).expect("published");
        if n % 10 == 0 {
            let picture = Payload::new(picture.clone(), Encoding::JPEG);
            robot.publish("camera", picture).expect("published");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    robot
        .with_urgency(Urgency::Urgent)
        .publish("end", "end")
        .expect("published");
    wait_until("the last message is on the disk", || {
        read(&folder.path().join("match.segments"))
            .0
            .iter()
            .any(|entry| entry.topic == "a/end")
    });
    recording.signal("-INT");
    assert!(recording.end().success());
    let info = ran(
        folder.path(),
        &["recording", "info", "match.mcap", "--json"],
    );
    let info: serde_json::Value = serde_json::from_slice(&info.stdout).expect("JSON");
    assert_eq!(info["messages"], 111, "{info:#}");
    assert_eq!(info["topics"]["a/n"]["missed"], 0, "{info:#}");
    assert_eq!(info["about"]["robot"], "b", "{info:#}");
    let checked = ran(folder.path(), &["recording", "check", "match.mcap"]);
    assert_eq!(text(&checked.stdout), "ok: 111 messages\n");
    let csv = ran(
        folder.path(),
        &[
            "recording",
            "export",
            "match.mcap",
            "--format",
            "csv",
            "--topic",
            "a/n",
        ],
    );
    assert_eq!(text(&csv.stdout).lines().count(), 101);
    let exported = ran(
        folder.path(),
        &[
            "recording",
            "export",
            "match.mcap",
            "--format",
            "pictures",
            "-o",
            "pictures",
        ],
    );
    assert_eq!(text(&exported.stdout), "pictures: 10 pictures\n");
    let first = fs::read(folder.path().join("pictures/a-camera/000001.jpeg"));
    assert_eq!(first.expect("a file"), picture);

    let listen = free_endpoint();
    let mut child = rect(
        folder.path(),
        &["replay", "match.mcap", "--wait", "--listen", &listen],
    );
    let mut replaying = Killed(child.stderr(Stdio::null()).spawn().expect("started"));
    let options = Options::new("viewer").expect("a name").login_file("/none");
    let options = options.router(&listen).timeout(TIMEOUT);
    let viewer = blocking::Robot::connect(options).expect("connected");
    viewer.wait_for_peer("a", TIMEOUT).expect("it appears");
    let queue = QueueOptions {
        when_full: WhenFull::Block,
        ..QueueOptions::default()
    };
    let mut messages = viewer
        .subscribe_with::<Payload>("a/**", queue)
        .expect("subscribed");
    let mut replayed = Vec::new();
    while replayed.len() < 111 {
        let message = messages.next_timeout(TIMEOUT).expect("replayed");
        assert!(message.replayed && message.missed == 0, "{message:?}");
        replayed.push((
            format!("a/{}", message.topic),
            message.urgency,
            message.payload,
        ));
    }
    assert!(replaying.end().success());
    let (entries, error) = read(&folder.path().join("match.mcap"));
    assert!(error.is_none(), "{error:?}");
    // Urgent messages may overtake others.
    let of = |topic: &str| {
        let found = replayed.iter().filter(|(replayed, ..)| replayed == topic);
        let expected = entries.iter().filter(|entry| entry.topic == topic);
        let found: Vec<_> = found
            .map(|(_, urgency, payload)| (*urgency, payload))
            .collect();
        let expected: Vec<_> = expected
            .map(|entry| (entry.urgency, &entry.payload))
            .collect();
        assert_eq!(found, expected, "{topic}");
        found.len()
    };
    assert_eq!([of("a/n"), of("a/camera"), of("a/end")], [100, 10, 1]);
}

#[test]
fn retained_values_are_recorded_and_retained_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let options = Options::new("a").expect("a name").login_file("/none");
    let _robot = blocking::Robot::connect(options.listen(&endpoint)).expect("connected");
    let at_robot = ["--as", "a", "--router", &endpoint];
    let run = |arguments: &[&str]| {
        let done = ran(folder.path(), &[arguments, &at_robot].concat());
        assert!(done.status.success(), "{}", text(&done.stderr));
    };
    // Before the recording begins.
    run(&["pub", "mode", "auto", "--retained"]);
    run(&["pub", "map", "old", "--retained"]);
    let recording = ["record", "a/**", "-o", "match.mcap"];
    let mut recording = rect(folder.path(), &[&recording[..], &at_robot].concat());
    let recording = recording.stdout(Stdio::null()).stderr(Stdio::null());
    let mut recording = Killed(recording.spawn().expect("started"));
    let entries = || read(&folder.path().join("match.segments")).0;
    wait_until("the values are recorded", || entries().len() == 2);
    run(&["topic", "forget", "map"]);
    wait_until("that is recorded", || entries().len() == 3);
    std::thread::sleep(Duration::from_millis(300));
    run(&["pub", "end", "end"]);
    wait_until("the end is recorded", || entries().len() == 4);
    recording.signal("-INT");
    assert!(recording.end().success());
    let (entries, _) = read(&folder.path().join("match.mcap"));
    let kinds = |topic: &str| {
        let of_topic = entries.iter().filter(|entry| entry.topic == topic);
        of_topic.map(|entry| entry.retained).collect::<Vec<_>>()
    };
    assert_eq!(kinds("a/mode"), [Some(RetainedKind::Value)]);
    assert_eq!(
        kinds("a/map"),
        [Some(RetainedKind::Value), Some(RetainedKind::Forgotten)]
    );
    assert_eq!(kinds("a/end"), [None]);

    let listen = free_endpoint();
    let replay = ["replay", "match.mcap", "--loop", "--listen", &listen];
    let mut replaying = rect(folder.path(), &replay);
    let _replaying = Killed(replaying.stderr(Stdio::null()).spawn().expect("started"));
    let got = |topic: &str| {
        let arguments = ["topic", "get", topic, "--router", &listen];
        let done = ran(folder.path(), &arguments);
        done.status.success().then(|| text(&done.stdout))
    };
    wait_until("it is retained", || {
        got("a/mode").is_some_and(|got| got.ends_with("): auto\n"))
    });
    wait_until("it is forgotten", || got("a/map").is_none());
    // Also a program that starts later receives it.
    let arguments = [
        "sub", "a/mode", "--count", "1", "--json", "--router", &listen,
    ];
    let received = ran(folder.path(), &arguments);
    let received: serde_json::Value = serde_json::from_slice(&received.stdout).expect("JSON");
    assert_eq!(received["value"], "auto");
    assert_eq!(received["retained"]["is_forgotten"], false, "{received}");
    assert_eq!(received["replayed"], true, "{received}");
    let played = entries.iter().find(|entry| entry.topic == "a/mode");
    let sent_ms = played.map(|entry| entry.sent.as_millis());
    assert_eq!(received["sent_ms"].as_u64().map(u128::from), sent_ms);
}

#[test]
fn replay_is_paused_and_stepped_by_keys() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut file = OpenFile::create(folder.path().join("match.mcap"), &about()).expect("created");
    for sequence in 0..4 {
        let mut entry = entry(3 * sequence);
        entry.logged = Duration::from_secs(1000 + 2 * u64::from(sequence));
        file.add(&entry).expect("written");
    }
    file.finish().expect("on the disk");
    let listen = free_endpoint();
    let replay = format!(
        "'{}' replay match.mcap --wait --paused --remap a=z --listen {listen}",
        env!("CARGO_BIN_EXE_rect")
    );
    // `script` gives the program a terminal.
    let mut command = Command::new("script");
    command.args(["-qec", &replay, "/dev/null"]);
    command.current_dir(folder.path()).stdout(Stdio::null());
    let child = command.stdin(Stdio::piped()).spawn();
    let mut replaying = Killed(child.expect("util-linux has `script`"));
    let mut keyboard = replaying.0.stdin.take().expect("piped");
    let mut press = |keys: &str| keyboard.write_all(keys.as_bytes()).expect("it runs");

    let options = Options::new("viewer").expect("a name").login_file("/none");
    let options = options.router(&listen).timeout(TIMEOUT);
    let viewer = blocking::Robot::connect(options).expect("connected");
    let mut messages = viewer.subscribe::<Payload>("z/**").expect("subscribed");
    let short = Duration::from_millis(300);
    assert!(messages.next_timeout(short).is_none(), "paused");
    let n =
        |message: Message| message.payload.value::<serde_json::Value>().expect("JSON")["n"].clone();
    for expected in [0, 3] {
        press("n");
        let message = messages.next_timeout(TIMEOUT).expect("stepped");
        assert_eq!(n(message), expected);
        assert!(messages.next_timeout(short).is_none(), "one message");
    }
    let continued = Instant::now();
    press("++ ");
    for expected in [6, 9] {
        let message = messages.next_timeout(TIMEOUT).expect("continued");
        assert_eq!(n(message), expected);
    }
    // Two messages, 2 s apart, at four times the rate.
    assert!(continued.elapsed() >= Duration::from_millis(990));
    assert!(replaying.end().success());
}

/// A power cut cannot be tested here, but what it leaves is what the other tests read: whole files, and one that breaks off.
#[test]
fn killed_recorder_leaves_whole_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let (robot, mut recording) = recorded(folder.path());
    let parts: PathBuf = folder.path().join("match.segments");
    let complete = || {
        let files = fs::read_dir(&parts).expect("a folder");
        let mut files: Vec<_> = files.map(|file| file.expect("a file").path()).collect();
        files.retain(|file| {
            file.extension()
                .is_some_and(|ending| ending == file::COMPLETE)
        });
        files
    };
    let mut n = 0u32;
    while complete().is_empty() {
        robot.publish("n", Json(n)).expect("published");
        n += 1;
        std::thread::sleep(Duration::from_millis(2));
    }
    recording.signal("-KILL");
    recording.end();
    for file in complete() {
        let (entries, error) = read(&file);
        assert!(error.is_none() && !entries.is_empty(), "{error:?}");
    }
    let (entries, error) = read(&parts);
    assert!(error.is_none(), "{error:?}");
    let messages = entries.iter().filter(|entry| !entry.is_report());
    let numbers: Vec<_> = messages.map(|entry| entry.sequence).collect();
    assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1));
    let again = ran(
        folder.path(),
        &["record", "-o", "match.mcap", "--router", "tcp/127.0.0.1:1"],
    );
    assert!(!again.status.success());
    let checked = ran(folder.path(), &["recording", "check", "match.segments"]);
    let merged = ran(
        folder.path(),
        &["recording", "merge", "match.segments", "-o", "match.mcap"],
    );
    assert!(merged.status.success(), "{}", text(&merged.stderr));
    let (merged, error) = read(&folder.path().join("match.mcap"));
    assert!(error.is_none(), "{error:?}");
    assert_eq!(merged, entries);
    // Killed between two files, it leaves no part.
    if !checked.status.success() {
        assert!(
            text(&checked.stderr).contains("was interrupted"),
            "{}",
            text(&checked.stderr)
        );
    }
}

#[test]
fn part_of_a_running_recording_is_fetched() {
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let (robot, _recording) = recorded_at(folder.path(), &endpoint);
    // Several answers, and several files at the recorder.
    let sent: Vec<String> = (0..400)
        .map(|n| format!("{n} {}", "x".repeat(1000)))
        .collect();
    let publisher = robot.publisher::<Payload>("n").expect("declared");
    for value in &sent {
        publisher.publish(value.as_str()).expect("published");
    }
    robot.publish("other", "1").expect("published");
    let fetch = |arguments: &[&str], file: &str| {
        let common = [
            "recording",
            "fetch",
            "--as",
            "c",
            "--router",
            &endpoint,
            "-o",
            file,
        ];
        ran(folder.path(), &[&common[..], arguments].concat())
    };
    let values = |file: &str| -> Vec<String> {
        let (entries, error) = read(&folder.path().join(file));
        assert!(error.is_none(), "{error:?}");
        let messages = entries.iter().filter(|entry| entry.topic == "a/n");
        messages.map(|entry| text(&entry.payload.bytes)).collect()
    };
    let fetched = fetch(&["b"], "all.mcap");
    assert!(fetched.status.success(), "{fetched:?}");
    assert_eq!(text(&fetched.stdout), "all.mcap: 401 messages\n");
    assert_eq!(values("all.mcap"), sent);
    let fetched = fetch(&["b", "--topic", "a/other"], "other.mcap");
    assert_eq!(
        text(&fetched.stdout),
        "other.mcap: 1 messages\n",
        "{fetched:?}"
    );
    for (arguments, file, problem) in [
        (&["b"][..], "all.mcap", "all.mcap"),
        (&["nobody"], "x.mcap", "rect record"),
        (&["b", "--last", "1s", "--until", "2s"], "x.mcap", "--until"),
        (
            &["b", "--topic", "nothing/**"],
            "x.mcap",
            "nothing was recorded",
        ),
        (&["b", "--topic", "a//b"], "x.mcap", "a//b"),
    ] {
        let fetched = fetch(arguments, file);
        assert!(!fetched.status.success(), "{arguments:?}");
        assert!(text(&fetched.stderr).contains(problem), "{fetched:?}");
        assert!(!folder.path().join("x.mcap").exists());
    }
}

#[test]
fn requests_are_recorded_at_the_service() {
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let listening = Options::new("wombat-1")
        .expect("a name")
        .login_file("/none");
    let robot = blocking::Robot::connect(listening.listen(&endpoint)).expect("connected");
    let asking = Options::new("wombat-2")
        .expect("a name")
        .login_file("/none");
    let asking = blocking::Robot::connect(asking.router(&endpoint)).expect("connected");
    let options = RecordOptions::default();
    let recorder = robot.record(folder.path().join("match.mcap"), options);
    let recorder = recorder.expect("a recorder");
    let sum = |request: &rect::Request| {
        let numbers: Vec<f64> = request.payload.value().map_err(|error| error.to_string())?;
        Ok::<_, String>(Json(numbers.iter().sum::<f64>()))
    };
    let _service = robot.serve("sum", sum).expect("a service");
    let reply = asking.request::<Payload>("wombat-1", "sum", Json([1, 2]));
    let sum: f64 = reply.expect("a reply").payload.value().expect("a number");
    assert_eq!(sum, 3.0);
    let large = asking.request::<Payload>("wombat-1", "sum", vec![7; 5000]);
    assert!(large.is_err());
    // A recorder does not count as a service.
    let nobody = asking.request::<Payload>("wombat-1", "difference", "now");
    assert!(
        matches!(nobody, Err(rect::Error::NoService { .. })),
        "{nobody:?}"
    );
    let (files, _) = recorder.finish().expect("finished");
    let (entries, error) = read(&files[0]);
    assert!(error.is_none(), "{error:?}");
    let requests = entries
        .iter()
        .filter(|entry| entry.topic == "wombat-1/@rect/requests");
    let requests: Vec<_> = requests.map(|entry| text(&entry.payload.bytes)).collect();
    assert_eq!(
        requests,
        [
            r#"{"sender":"wombat-2","topic":"sum","value":[1,2],"encoding":"application/json","bytes":5}"#,
            r#"{"sender":"wombat-2","topic":"sum","value":null,"encoding":"zenoh/bytes","bytes":5000}"#,
            r#"{"sender":"wombat-2","topic":"difference","value":"now","encoding":"text/plain","bytes":3}"#,
        ]
    );
}

#[test]
fn lines_and_alerts_are_recorded_and_lines_are_not_replayed() {
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let options = Options::new("a").expect("a name").login_file("/none");
    let robot = blocking::Robot::connect(options.listen(&endpoint)).expect("connected");
    robot.log(Level::Info, "before the recording");
    let record = |file: &str, without_logs| {
        let patterns = vec!["a/**".parse().expect("a pattern")];
        let options = RecordOptions {
            patterns,
            without_logs,
            ..RecordOptions::default()
        };
        let recorder = robot.record(folder.path().join(file), options);
        recorder.expect("a recorder")
    };
    let (with, without) = (record("with.mcap", false), record("without.mcap", true));
    let lines = || {
        let (entries, _) = read(&folder.path().join("with.segments"));
        let lines = entries.iter().filter(|entry| log::is_log(&entry.topic));
        lines
            .map(|entry| text(&entry.payload.bytes))
            .collect::<Vec<_>>()
    };
    // The recorder follows once the router, which this program is, has answered.
    wait_until("lines are recorded", || {
        robot.log(Level::Info, "begins");
        !lines().is_empty()
    });
    robot.log_line(LogLine {
        logger: "driver".to_owned(),
        source: "arm.rs:7".to_owned(),
        ..LogLine::new(1_795_000_000_123, Level::Error, "too hot:\n  motor 2")
    });
    robot.log_private(LogLine::new(5, Level::Error, "password"));
    robot.alert(Level::Warn, "battery low").expect("raised");
    let alerts = |recording: &str| {
        let (entries, _) = read(&folder.path().join(recording));
        let alerts = entries
            .iter()
            .filter(|entry| entry.topic == "a/alerts/battery-low");
        alerts.map(|entry| entry.retained).collect::<Vec<_>>()
    };
    wait_until("the alert is recorded", || {
        !alerts("without.segments").is_empty() && !alerts("with.segments").is_empty()
    });
    robot.clear_alert("battery low").expect("cleared");
    robot.log(Level::Info, "last");
    wait_until("all lines are recorded", || {
        lines().iter().any(|line| line.contains("last"))
    });
    let recorded = lines();
    let expected = r#"{"timestamp":{"sec":1795000000,"nsec":123000000},"level":4,"message":"too hot:\n  motor 2","name":"unnamed/driver","file":"arm.rs","line":7}"#;
    assert!(recorded.iter().any(|line| line == expected), "{recorded:?}");
    for absent in ["before", "password"] {
        let is_recorded = recorded.iter().any(|line| line.contains(absent));
        assert!(!is_recorded, "{recorded:?}");
    }
    for recorder in [with, without] {
        recorder.finish().expect("finished");
    }
    let info = |file: &str| {
        let done = ran(folder.path(), &["recording", "info", file]);
        text(&done.stdout)
    };
    assert!(
        info("with.mcap").contains(" log lines\n"),
        "{}",
        info("with.mcap")
    );
    assert!(
        !info("without.mcap").contains("log line"),
        "{}",
        info("without.mcap")
    );
    assert!(
        !info("with.mcap").contains("@rect"),
        "{}",
        info("with.mcap")
    );
    assert_eq!(
        alerts("without.mcap"),
        [Some(RetainedKind::Value), Some(RetainedKind::Forgotten)]
    );
    let replayed = ran(folder.path(), &["replay", "with.mcap", "--dry-run"]);
    let replayed = text(&replayed.stdout);
    assert!(replayed.contains("a/alerts/battery-low"), "{replayed}");
    assert!(!replayed.contains("log"), "{replayed}");
}

#[test]
fn stock_zenoh_programs_query_a_running_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let endpoint = free_endpoint();
    let (robot, _recording) = recorded_at(folder.path(), &endpoint);
    let stock = stock_client(&endpoint);
    for n in 0..20 {
        robot.publish("n", Json(n)).expect("published");
    }
    let ask = |selector: &str| -> Vec<Result<String, String>> {
        let key = format!("rect/b/@rect/recording/{selector}");
        let replies = stock.get(key).timeout(TIMEOUT).wait().expect("asked");
        replies
            .iter()
            .map(|reply| match reply.result() {
                Ok(sample) => {
                    assert!(sample.timestamp().is_some());
                    let value = text(&sample.payload().to_bytes());
                    Ok(format!("{} {value}", sample.key_expr()))
                }
                Err(error) => Err(text(&error.payload().to_bytes())),
            })
            .collect()
    };
    let key = |n: i32| Ok(format!("rect/b/@rect/recording/a/n {n}"));
    // The recorder may not have received the last messages yet.
    let complete: Vec<_> = (0..20).map(key).collect();
    wait_until("all messages are recorded", || {
        ask("a/*?_time=[now(-1m)..]") == complete
    });
    assert_eq!(ask("a/n?_time=[now(1m)..]"), []);
    for (selector, problem) in [
        ("**", "name the time"),
        ("**?_time=[yesterday]", "yesterday"),
        ("**?_time=[now()..];form=csv", "form is mcap"),
        ("**?_time=[now()..];last=5", "`last` is unknown"),
    ] {
        let answers = ask(selector);
        let [Err(error)] = &answers[..] else {
            panic!("{selector}: {answers:?}");
        };
        assert!(error.contains(problem), "{selector}: {error}");
    }
    let large = "x".repeat(50_000);
    for _ in 0..3 {
        robot.publish("n", large.as_str()).expect("published");
    }
    wait_until("only a part is sent at once", || {
        let answers = ask("**?_time=[now(-1m)..]");
        matches!(answers.last(), Some(Err(error)) if error.contains("rect recording fetch b"))
    });
}

#[tokio::test(flavor = "multi_thread")]
async fn a_recording_of_a_video_begins_with_a_key_frame() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let camera = one.stream("camera", StreamOptions::video()).await;
    let camera = camera.expect("a stream");
    let sending = tokio::spawn(async move {
        let mut ticks = tokio::time::interval(Duration::from_millis(50));
        for n in (0..200u8).cycle() {
            ticks.tick().await;
            let pixels = (0..160 * 120).map(|at: u32| (at as u8 / 2).wrapping_add(n));
            let picture = Picture::new(160, 120, Format::Grey8, pixels.collect::<Vec<_>>());
            camera
                .send_picture(&picture.expect("a picture"))
                .expect("sent");
        }
    });
    // The video runs already.
    let watch = two.watch("wombat-1/camera").await.expect("watched");
    while watch.next().await.expect("open").number < 10 {}
    let folder = tempfile::tempdir().expect("a folder");
    let options = RecordOptions {
        patterns: vec!["wombat-1/camera".parse().expect("a pattern")],
        ..RecordOptions::default()
    };
    let recorder = two.record(folder.path().join("match.mcap"), options).await;
    let recorder = recorder.expect("a recorder");
    let begun = Instant::now();
    while recorder.progress().written < 30 {
        assert!(begun.elapsed() < TIMEOUT, "{:?}", recorder.progress());
        watch.next().await;
    }
    sending.abort();
    let (files, _) = recorder.finish().await.expect("finished");
    let (entries, error) = read(&files[0]);
    assert!(error.is_none(), "{error:?}");
    let is_frame = |entry: &&Entry| entry.topic == "wombat-1/camera";
    let frames = entries.iter().filter(is_frame);
    let keys: Vec<_> = frames
        .map(|entry| is_key_frame(&entry.payload.bytes))
        .collect();
    // Without the recorder's request, one of two hundred would be a key frame.
    assert!(keys[..15].contains(&true), "{keys:?}");
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_robot_sends_and_is_sent_is_recorded_once() {
    let (one, two) = pair("wombat-1", "wombat-2").await;
    let folder = tempfile::tempdir().expect("a folder");
    let overlapping = ["wombat-1/**", "*/**"].map(|text| text.parse().expect("a pattern"));
    let by_default = ["wombat-1/pose", "wombat-1/grab", "wombat-2/drive"];
    let with_others = [&by_default[..], &["wombat-2/pose"]].concat();
    for (name, patterns, expected) in [
        ("default.mcap", vec![], by_default.to_vec()),
        ("all.mcap", overlapping.to_vec(), with_others),
    ] {
        let options = RecordOptions {
            patterns,
            ..RecordOptions::default()
        };
        let recorder = one.record(folder.path().join(name), options).await;
        let recorder = recorder.expect("a recorder");
        one.wait_until_established(TIMEOUT)
            .await
            .expect("established");
        two.publish("pose", Json(1)).await.expect("published");
        two.send("wombat-1", "drive", Json(2)).await.expect("sent");
        one.publish("pose", Json(3)).await.expect("published");
        one.send("wombat-2", "grab", Json(4)).await.expect("sent");
        let begun = Instant::now();
        while recorder.progress().written < expected.len() as u64 {
            assert!(begun.elapsed() < TIMEOUT, "{:?}", recorder.progress());
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
        let (files, _) = recorder.finish().await.expect("finished");
        let (entries, error) = read(&files[0]);
        assert!(error.is_none(), "{error:?}");
        let messages = entries.iter().filter(|entry| !entry.is_report());
        let mut topics: Vec<_> = messages.clone().map(|entry| entry.topic.as_str()).collect();
        topics.sort_unstable();
        let mut expected = expected;
        expected.sort_unstable();
        assert_eq!(topics, expected, "{name}");
        for (topic, recipient) in [
            ("wombat-1/grab", Some("wombat-2")),
            ("wombat-2/drive", Some("wombat-1")),
            ("wombat-1/pose", None),
        ] {
            let message = messages.clone().find(|entry| entry.topic == topic);
            let message = message.expect("recorded");
            assert_eq!(message.recipient.as_deref(), recipient, "{topic}");
        }
    }
}
