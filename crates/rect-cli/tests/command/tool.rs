//! Tests the `rect` command, connected to a robot in the test's own process: `cargo test -p rect-cli --test command tool`
use std::{
    io::{BufRead, BufReader, Read, Write},
    process::{Child, Command, Output, Stdio},
    sync::mpsc::{self, RecvTimeoutError},
    time::{Duration, Instant},
};

use rect::{blocking, Options, Payload};

use crate::pair::{free_endpoint, stock_client, TIMEOUT};
use serde_json::Value;

/// Returns the `rect` command with `arguments`, ready to be started.
fn rect(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_rect"));
    command.args(arguments).stdin(Stdio::null());
    command
}

/// Runs `rect` with `arguments` until it exits.
fn ran(arguments: &[&str]) -> Output {
    rect(arguments).output().expect("started")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// Starts a robot to which the command can connect; returns it with its endpoint.
fn robot(name: &str) -> (blocking::Robot, String) {
    let endpoint = free_endpoint();
    let options = Options::new(name).expect("a name").login_file("/none");
    let robot = blocking::Robot::connect(options.listen(&endpoint)).expect("connected");
    (robot, endpoint)
}

/// A process that is killed when this value is dropped.
struct Killed(Child);

impl Drop for Killed {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn pub_and_send_deliver_messages() {
    let (a, endpoint) = robot("a");
    let mut messages = a.subscribe::<Payload>("b/**").expect("subscribed");
    let join = ["--as", "b", "--router", &endpoint];
    let published = ran(&[
        &["pub", "arm/angle", "12.5", "--urgency", "urgent"],
        &join[..],
    ]
    .concat());
    assert!(published.status.success(), "{}", text(&published.stderr));
    let message = messages.next_timeout(TIMEOUT).expect("received");
    assert_eq!(
        (message.sender.as_str(), message.topic.as_str()),
        ("b", "arm/angle")
    );
    assert_eq!(message.payload.value::<f64>().expect("JSON"), 12.5);
    assert_eq!(message.urgency, rect::Urgency::Urgent);
    let sent = ran(&[
        &["send", "a", "note", "hello there", "--codec", "zstd:5"],
        &join[..],
    ]
    .concat());
    assert!(sent.status.success(), "{}", text(&sent.stderr));
    let message = messages.next_timeout(TIMEOUT).expect("received");
    assert_eq!(message.payload.text().expect("text"), "hello there");
    assert_eq!(message.recipient.expect("a recipient"), "a");
}

#[test]
fn sub_prints_messages_as_text_or_json() {
    let (a, endpoint) = robot("a");
    for (json, expected) in [(false, r#"a/x: {"n":1}"#), (true, r#""value":{"n":1}"#)] {
        let mut arguments = vec![
            "sub", "a/**", "--count", "1", "--as", "b", "--router", &endpoint,
        ];
        arguments.extend(json.then_some("--json"));
        let mut child = Killed(
            rect(&arguments)
                .stdout(Stdio::piped())
                .spawn()
                .expect("started"),
        );
        let began = Instant::now();
        while child.0.try_wait().expect("the child's status").is_none() {
            assert!(began.elapsed() < TIMEOUT, "ends after one message");
            a.publish("x", serde_json::json!({"n": 1}))
                .expect("published");
            std::thread::sleep(Duration::from_millis(10));
        }
        let mut line = String::new();
        let output = child.0.stdout.take().expect("piped");
        BufReader::new(output).read_line(&mut line).expect("text");
        assert!(line.contains(expected), "{line}");
    }
}

#[test]
fn retained_value_is_published_printed_and_forgotten() {
    let (_a, endpoint) = robot("a");
    // A program without a router keeps the values of its robot.
    let join = ["--as", "a", "--router", &endpoint];
    let run = |arguments: &[&str]| ran(&[arguments, &join].concat());
    let none = run(&["topic", "get", "a/mode"]);
    assert_eq!(none.status.code(), Some(1));
    let message = text(&none.stderr);
    assert!(message.contains("a keeps no value of mode"), "{message}");

    for (place, value) in [("--retained", "auto"), ("--retained=disk", "manual")] {
        let published = run(&["pub", "mode", place, value]);
        assert!(published.status.success(), "{}", text(&published.stderr));
        let got = text(&run(&["topic", "get", "a/mode"]).stdout);
        assert!(got.ends_with(&format!("): {value}\n")), "{got}");
    }
    let got = text(&run(&["topic", "get", "a/mode"]).stdout);
    assert!(got.starts_with("a/mode (") && got.contains(" ago"), "{got}");
    let json = run(&["topic", "get", "a/mode", "--json"]).stdout;
    let json: Value = serde_json::from_slice(&json).expect("JSON");
    assert_eq!(json["value"], "manual");
    assert_eq!(json["retained"]["is_forgotten"], false);
    assert!(json["retained"]["age_s"].as_f64() > Some(0.0), "{json}");

    let subscribe = |arguments: &[&str]| {
        let arguments = [&["sub", "a/mode"], arguments, &join];
        let mut command = rect(&arguments.concat());
        let mut child = Killed(command.stdout(Stdio::piped()).spawn().expect("started"));
        let lines = BufReader::new(child.0.stdout.take().expect("piped")).lines();
        (child, lines.map(|line| line.expect("text")))
    };
    let (_plain, mut plain) = subscribe(&["--count", "2", "--no-time"]);
    let (_json, mut json) = subscribe(&["--count", "2", "--json"]);
    let first = plain.next().expect("the retained value");
    assert!(
        first.starts_with("a/mode (retained") && first.ends_with("): manual"),
        "{first}"
    );
    let first: Value = serde_json::from_str(&json.next().expect("a line")).expect("JSON");
    assert_eq!(first["retained"]["is_forgotten"], false, "{first}");

    let forgotten = run(&["topic", "forget", "mode"]);
    assert!(forgotten.status.success(), "{}", text(&forgotten.stderr));
    assert_eq!(plain.next().expect("a line"), "a/mode (forgotten)");
    let last: Value = serde_json::from_str(&json.next().expect("a line")).expect("JSON");
    assert_eq!(last["retained"]["is_forgotten"], true, "{last}");
    assert_eq!(
        (&last["value"], &last["problem"]),
        (&Value::Null, &Value::Null)
    );
    assert_eq!(run(&["topic", "get", "a/mode"]).status.code(), Some(1));
}

#[test]
fn value_that_no_router_keeps_is_published_with_a_warning() {
    let (a, endpoint) = robot("a");
    let mut messages = a.subscribe::<Payload>("b/mode").expect("subscribed");
    let arguments = ["pub", "mode", "auto", "--retained", "--as", "b", "--router"];
    let published = ran(&[&arguments[..], &[&endpoint]].concat());
    assert_eq!(published.status.code(), Some(1));
    let message = text(&published.stderr);
    assert!(
        message.contains("mode is not retained: no router"),
        "{message}"
    );
    let message = messages.next_timeout(TIMEOUT).expect("received");
    assert_eq!(message.payload.text().expect("text"), "auto");
    assert_eq!(message.retained, None);
}

#[test]
fn serve_replies_with_program_output_or_failure() {
    let (a, endpoint) = robot("a");
    let join = ["--as", "b", "--router", &endpoint];
    let serving = [&["serve", "upper"], &join[..], &["--", "tr", "a-z", "A-Z"]].concat();
    let _serving = Killed(
        rect(&serving)
            .stderr(Stdio::null())
            .spawn()
            .expect("started"),
    );
    let failing = [
        &["serve", "fail"],
        &join[..],
        &["--", "sh", "-c", "echo no arm >&2; exit 3"],
    ]
    .concat();
    let _failing = Killed(
        rect(&failing)
            .stderr(Stdio::null())
            .spawn()
            .expect("started"),
    );
    let asked = |topic: &str| {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            match a.request::<Payload>("b", topic, "hello") {
                Err(rect::Error::NoService { .. }) if Instant::now() < deadline => {}
                answer => break answer,
            }
        }
    };
    let reply = asked("upper").expect("a reply");
    assert_eq!(reply.payload.text().expect("text"), "HELLO");
    let error = asked("fail").expect_err("it fails").to_string();
    assert!(
        error.contains("no arm") && error.contains("b replied"),
        "{error}"
    );
}

#[test]
fn serve_passes_large_requests_to_programs_that_read_and_write_at_once() {
    let (a, endpoint) = robot("a");
    let join = ["--as", "b", "--router", &endpoint];
    let serve = |topic: &str, program: &[&str]| {
        let arguments = [&["serve", topic], &join[..], &["--"], program].concat();
        let mut command = rect(&arguments);
        Killed(command.stderr(Stdio::null()).spawn().expect("started"))
    };
    let _echoing = serve("echo", &["cat"]);
    let _ignoring = serve("ignore", &["sh", "-c", "sleep 0.1; echo done"]);
    // Larger than the pipes of a program.
    let large = "a".repeat(1 << 20);
    let asked = |topic: &str| {
        let deadline = Instant::now() + TIMEOUT;
        loop {
            match a.request::<Payload>("b", topic, large.as_str()) {
                Err(rect::Error::NoService { .. }) if Instant::now() < deadline => {}
                answer => break answer.expect("a reply").payload,
            }
        }
    };
    let echoed = asked("echo");
    assert!(echoed.text().expect("text") == large, "the same text");
    assert_eq!(asked("ignore").text().expect("text"), "done");
}

#[test]
fn serve_ends_a_program_that_never_reads_at_the_timeout() {
    let (a, endpoint) = robot("a");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("pid").display().to_string();
    let program = ["sh", "-c", "echo $$ > $0; exec sleep 600", file.as_str()];
    let arguments = ["serve", "stuck", "--as", "b", "--router", &endpoint, "--"];
    let mut serving = rect(&[&arguments[..], &program[..]].concat());
    let _serving = Killed(serving.stderr(Stdio::null()).spawn().expect("started"));
    let large = "a".repeat(1 << 20);
    let deadline = Instant::now() + TIMEOUT;
    let pid = loop {
        // Fails at once until the service is discovered, and then at the timeout.
        let _ = a.request::<Payload>("b", "stuck", large.as_str());
        let pid = std::fs::read_to_string(&file).unwrap_or_default();
        if pid.ends_with('\n') {
            break pid;
        }
        assert!(Instant::now() < deadline, "the program is started");
    };
    while std::path::Path::new("/proc").join(pid.trim()).exists() {
        assert!(Instant::now() < deadline, "the program is ended");
        std::thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn request_prints_the_reply_or_the_error() {
    let (a, endpoint) = robot("a");
    let _service = a
        .serve("double", |request| match request.payload.value::<f64>() {
            Ok(number) => Ok(rect::Json(number * 2.0)),
            Err(error) => Err(error.to_string()),
        })
        .expect("served");
    let join = ["--as", "b", "--router", &endpoint];
    let answer = ran(&[&["request", "a", "double", "21", "--json"], &join[..]].concat());
    let answer: Value = serde_json::from_slice(&answer.stdout).expect("JSON");
    assert_eq!(
        (&answer["sender"], &answer["value"]),
        (&"a".into(), &42.0.into())
    );
    for (robot, option) in [("a", "--retry"), ("a", "--stream"), ("*", "--timeout=20s")] {
        let answer = ran(&[&["request", robot, "double", "4", option], &join[..]].concat());
        assert_eq!(text(&answer.stdout), "a: 8.0\n", "{}", text(&answer.stderr));
    }
    let refused = ran(&[&["request", "*", "double", "x"], &join[..]].concat());
    assert_eq!(refused.status.code(), Some(1));
    assert!(
        text(&refused.stderr).contains("a replied with an error"),
        "{}",
        text(&refused.stderr)
    );
    for (options, expected) in [
        (
            &["*", "nothing"][..],
            "no program of the fleet serves nothing",
        ),
        (&["*", "double", "--retry"], "need the name of a robot"),
    ] {
        let failed = ran(&[&["request"], options, &join[..]].concat());
        assert_eq!(failed.status.code(), Some(1));
        let failed = text(&failed.stderr);
        assert!(failed.contains(expected), "{failed}");
    }
    let wrong = ran(&[&["request", "a", "double", "x"], &join[..]].concat());
    assert_eq!(wrong.status.code(), Some(1));
    assert!(
        text(&wrong.stderr).contains("a replied with an error"),
        "{}",
        text(&wrong.stderr)
    );
    let missing = ran(&[&["request", "a", "nothing"], &join[..]].concat());
    assert!(
        text(&missing.stderr).contains("no program serves nothing at a"),
        "{}",
        text(&missing.stderr)
    );
}

#[test]
fn transfer_sends_and_receives_files() {
    let (a, endpoint) = robot("a");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("map.bin");
    std::fs::write(&file, vec![7u8; 300_000]).expect("written");
    let file = file.to_str().expect("text");
    let refused = ran(&[
        "transfer",
        "send",
        "a",
        file,
        "--as",
        "b",
        "--router",
        &endpoint,
        "--timeout",
        "1s",
    ]);
    assert_eq!(refused.status.code(), Some(1), "no program receives files");
    assert!(
        text(&refused.stderr).contains("rect: "),
        "{}",
        text(&refused.stderr)
    );
    let destination = folder.path().join("received").display().to_string();
    let receiving = [
        "transfer",
        "receive",
        "--folder",
        &destination,
        "--as",
        "b",
        "--router",
        &endpoint,
    ];
    let _receiving = Killed(
        rect(&receiving)
            .stdout(Stdio::null())
            .spawn()
            .expect("started"),
    );
    let sent = a
        .transfer("b", "files", vec![9u8; 200_000])
        .expect("valid arguments");
    let sent = sent.name("nine.bin").timeout(TIMEOUT);
    sent.wait().expect("sent");
    let content = std::fs::read(folder.path().join("received/a/nine.bin")).expect("present");
    assert_eq!(content, vec![9u8; 200_000]);
}

#[test]
fn stream_send_publishes_pictures() {
    let (a, endpoint) = robot("a");
    let folder = tempfile::tempdir().expect("a folder");
    let pixels: Vec<u8> = (0..64 * 48 * 3u32).map(|n| n as u8).collect();
    let picture = rect_core::codec::picture::Picture::new(
        64,
        48,
        rect_core::codec::picture::Format::Rgb8,
        pixels,
    );
    let raw = rect::ToPayload::to_payload(&picture.expect("a picture")).expect("a payload");
    let png = rect_core::codec::parse("png")
        .expect("a codec")
        .encode(&raw)
        .expect("written");
    let file = folder.path().join("seen.png");
    std::fs::write(&file, &png.bytes).expect("written");
    let join = ["--as", "b", "--router", &endpoint];
    let sending = [
        &["stream", "send", "camera", file.to_str().expect("text")],
        &join[..],
    ]
    .concat();
    let _sending = Killed(
        rect(&sending)
            .stderr(Stdio::null())
            .spawn()
            .expect("started"),
    );
    let mut watch = a.watch("b/camera").expect("watched");
    let frame = watch.next_timeout(TIMEOUT).expect("in time");
    let shown = frame
        .payload
        .picture(&Default::default())
        .expect("a picture");
    assert!(
        shown.width() <= 64 && shown.width() * 3 == shown.height() * 4,
        "{shown:?}"
    );
    let wrong = ran(&["stream", "send", "camera", "/none.png"]);
    assert!(
        text(&wrong.stderr).contains("/none.png"),
        "{}",
        text(&wrong.stderr)
    );
}

#[test]
fn dictionary_is_trained_from_a_recording() {
    let folder = tempfile::tempdir().expect("a folder");
    let recording = folder.path().join("telemetry.jsonl");
    let mut file = std::fs::File::create(&recording).expect("made");
    for n in 0..2000 {
        let value =
            serde_json::json!({"sensor": "elbow", "angle_deg": f64::from(n % 900) / 10.0, "n": n});
        writeln!(file, "{value}").expect("written");
    }
    let output = folder.path().join("telemetry.dict");
    let trained = ran(&[
        "dictionary",
        "train",
        recording.to_str().expect("text"),
        "-o",
        output.to_str().expect("text"),
        "--size",
        "2048",
    ]);
    let output_text = text(&trained.stdout);
    assert!(trained.status.success(), "{}", text(&trained.stderr));
    assert!(
        output_text.contains("with 1600 messages") && output_text.contains("400 other messages"),
        "{output_text}"
    );
    rect_core::codec::dictionary::Dictionary::read(&output).expect("a dictionary");
    let nothing = ran(&["dictionary", "train", "/none.jsonl", "-o", "/none"]);
    assert!(
        text(&nothing.stderr).contains("/none.jsonl"),
        "{}",
        text(&nothing.stderr)
    );
}

/// The exit status of a program whose reader has exited.
const CLOSED_PIPE: i32 = 141;

#[test]
fn closed_pipe_ends_a_command_without_a_message() {
    let (a, endpoint) = robot("a");
    for json in [false, true] {
        let mut arguments = vec!["sub", "a/**", "--as", "b", "--router", &endpoint];
        arguments.extend(json.then_some("--json"));
        let mut command = rect(&arguments);
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        let mut child = Killed(command.spawn().expect("started"));
        drop(child.0.stdout.take());
        let began = Instant::now();
        let status = loop {
            if let Some(status) = child.0.try_wait().expect("the child's status") {
                break status;
            }
            assert!(began.elapsed() < TIMEOUT, "runs without a reader");
            a.publish("x", "1").expect("published");
            std::thread::sleep(Duration::from_millis(10));
        };
        let mut message = String::new();
        let mut stderr = child.0.stderr.take().expect("piped");
        stderr.read_to_string(&mut message).expect("text");
        assert_eq!(status.code(), Some(CLOSED_PIPE), "{message}");
        assert!(!message.contains("panicked"), "{message}");
    }
}

#[test]
fn unwritable_output_is_an_error_and_no_panic() {
    let (_a, endpoint) = robot("a");
    let full = || std::fs::File::create("/dev/full").expect("linux");
    for arguments in [
        &["completion", "bash"][..],
        &["peers", "--as", "b", "--router", &endpoint],
        &["peers", "--json", "--as", "b", "--router", &endpoint],
    ] {
        let mut command = rect(arguments);
        let output = command.stdout(full()).output().expect("started");
        let message = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        assert!(
            message.contains("cannot write") && !message.contains("panicked"),
            "{message}"
        );
    }
    // The same applies to an error message that cannot be written to stderr.
    let mut command = rect(&["pub", "x", "1", "--router", "tcp/127.0.0.1:1"]);
    let status = command.stderr(full()).status().expect("started");
    assert_eq!(status.code(), Some(1));
}

/// A topic with a line break and control sequences for the terminal.
const HOSTILE: &str = "a\x1b]0;pwned\x07\x1b[2Jb\nfake/c: 12.5";

#[test]
fn control_characters_from_other_robots_are_replaced() {
    let (a, endpoint) = robot("a");
    let stock = stock_client(&endpoint);
    let mut command = rect(&["sub", "*/**", "--as", "b", "--router", &endpoint]);
    let mut child = Killed(command.stdout(Stdio::piped()).spawn().expect("started"));
    let mut lines = BufReader::new(child.0.stdout.take().expect("piped")).lines();
    let (stop, stopped) = mpsc::channel::<()>();
    let publishing = std::thread::spawn(move || {
        let running =
            || stopped.recv_timeout(Duration::from_millis(20)) == Err(RecvTimeoutError::Timeout);
        while running() {
            for key in [format!("rect/c/{HOSTILE}"), "rect/c/end".to_owned()] {
                let put = stock.put(key, format!("1\nfake/d: 3{HOSTILE}"));
                zenoh::Wait::wait(put.encoding(HOSTILE)).expect("put");
            }
        }
    });
    let mut shown = Vec::new();
    // The second occurrence ends one complete round.
    while shown
        .iter()
        .filter(|line: &&String| line.contains("c/end"))
        .count()
        < 2
    {
        shown.push(lines.next().expect("a line").expect("text"));
    }
    drop(stop);
    publishing.join().expect("no panic");
    for line in &shown {
        assert!(!line.contains(['\x1b', '\x07']), "{line:?}");
        assert!(!line.starts_with("fake/"), "{line:?}");
    }
    let _failing = a.serve("fail", |_| Err::<String, _>(format!("{HOSTILE}\u{202e}")));
    let failed = ran(&["request", "a", "fail", "--as", "b", "--router", &endpoint]);
    let message = text(&failed.stderr);
    assert!(message.contains("a replied with an error"), "{message}");
    assert!(!message.contains(['\x1b', '\u{202e}']), "{message:?}");
    assert!(
        !message.lines().any(|line| line.starts_with("fake/")),
        "{message:?}"
    );
}

#[test]
fn sub_warns_if_the_robot_is_not_reachable() {
    let (a, endpoint) = robot("a");
    for (pattern, hinted) in [("wombat-9/**", true), ("a/**", false), ("*/**", false)] {
        let arguments = [
            "sub", pattern, "--count", "1", "--as", "b", "--router", &endpoint,
        ];
        let mut child = Killed(
            rect(&arguments)
                .stderr(Stdio::piped())
                .stdout(Stdio::null())
                .spawn()
                .expect("started"),
        );
        let mut lines = BufReader::new(child.0.stderr.take().expect("piped")).lines();
        let first = lines.next().expect("a line").expect("text");
        assert!(
            first.contains(&format!("subscribed to {pattern}")),
            "{first}"
        );
        if hinted {
            let hint = lines.next().expect("a line").expect("text");
            let expected = "no robot called wombat-9 is reachable yet; reachable robots: a";
            assert!(hint.ends_with(expected), "{hint}");
            continue;
        }
        let began = Instant::now();
        while child.0.try_wait().expect("the child's status").is_none() {
            assert!(began.elapsed() < TIMEOUT, "ends after one message");
            a.publish("x", "1").expect("published");
            std::thread::sleep(Duration::from_millis(10));
        }
        let more: Vec<_> = lines.map_while(Result::ok).collect();
        assert_eq!(more, Vec::<String>::new());
    }
}

#[test]
fn output_is_coloured_on_terminals_or_on_demand() {
    let (_a, endpoint) = robot("a");
    let shown = |options: &[&str]| {
        let mut arguments = vec!["peers", "--as", "b", "--router", &endpoint];
        arguments.extend(options);
        let output = rect(&arguments)
            .env_remove("CLICOLOR_FORCE")
            .output()
            .expect("started");
        text(&output.stdout)
    };
    assert!(!shown(&[]).contains('\x1b'));
    assert!(shown(&["--color", "always"]).contains('\x1b'));
    assert!(!shown(&["--color", "never"]).contains('\x1b'));
}

#[test]
fn router_address_without_protocol_defaults_to_tcp() {
    let (_a, endpoint) = robot("a");
    let address = endpoint.strip_prefix("tcp/").expect("tcp");
    let reached = ran(&["peers", "--as", "b", "--router", address]);
    assert!(reached.status.success(), "{}", text(&reached.stderr));
    let wrong = ran(&["peers", "--as", "b", "--router", "localhost"]);
    let message = text(&wrong.stderr);
    assert!(
        message.contains("tcp/127.0.0.1:7447") && !message.contains("Json5"),
        "{message}"
    );
}

#[test]
fn usage_errors_suggest_a_solution() {
    for (arguments, suggestion) in [
        (&["pub", "a/*", "1"][..], "wildcard"),
        (&["sub", "angle"], "<robot>/<topic>"),
        (&["pub", "x", "1", "--codec", "zip", "--as", "b"], "zstd"),
        (
            &["pub", "x", "1", "--router", "tcp/127.0.0.1:1"],
            "rect-router -l",
        ),
        (&["send", "no robot", "x"], "' '"),
        (&["pub", "x", "--file", "/none"], "/none"),
    ] {
        let (_a, endpoint) = robot("a");
        let mut all = arguments.to_vec();
        if !all.contains(&"--router") {
            all.extend(["--router", &endpoint]);
        }
        let failed = ran(&all);
        assert!(!failed.status.success());
        let message = text(&failed.stderr);
        assert!(message.contains(suggestion), "{arguments:?}: {message}");
        assert!(
            !message.contains(".rs:"),
            "no source lines in messages: {message}"
        );
    }
    let help = text(&ran(&["--help"]).stdout);
    assert!(help.contains("rect sub '*/arm/*'"), "{help}");
    let completion = text(&ran(&["completion", "bash"]).stdout);
    assert!(completion.contains("complete -F"));
    for choices in [
        "desk room wall edge-of-range crowded-hall",
        "bulk normal urgent",
        "1m 2m",
    ] {
        assert!(completion.contains(choices), "{choices}");
    }
}

#[test]
fn air_says_what_it_has_changed() {
    let folder = tempfile::tempdir().expect("a folder");
    let socket = folder.path().join("air.sock");
    let socket = socket.to_str().expect("text");
    let mut command = rect(&["air", "--socket", socket]);
    let mut air = Killed(command.stdout(Stdio::piped()).spawn().expect("started"));
    let mut line = String::new();
    let output = air.0.stdout.take().expect("piped");
    BufReader::new(output).read_line(&mut line).expect("text");
    assert!(line.contains("simulated air (room)"), "{line}");
    for (change, expected) in [
        (&["cut"][..], "all adapters are out of range of each other"),
        (&["restore"], "all adapters are in range of each other"),
        (&["condition", "desk"], "the radio condition is desk"),
    ] {
        let done = ran(&[&["air"], change, &["--socket", socket]].concat());
        assert!(done.status.success(), "{}", text(&done.stderr));
        assert!(
            text(&done.stdout).contains(expected),
            "{}",
            text(&done.stdout)
        );
    }
}
