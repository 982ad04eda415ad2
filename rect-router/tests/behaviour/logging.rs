//! Tests that the log never blocks the router, even if nothing reads it: `cargo test -p rect-router --test behaviour logging`

use std::{
    fs::{File, OpenOptions},
    io::{BufRead, BufReader},
    process::{Child, Command, ExitStatus, Stdio},
    thread,
    time::{Duration, Instant},
};

use crate::support::{arrives, client_with, free_socket, DEADLINE};
use nix::{
    sys::signal::{kill, Signal},
    unistd::Pid,
};
use zenoh::Session;

/// A router whose stdout and stderr are chosen by the test; killed at the end.
struct RunningRouter(Child);

impl RunningRouter {
    fn start(endpoint: &str, filter: Option<&str>, stdout: Stdio, stderr: Stdio) -> Self {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rect-router"));
        command.args(["--no-multicast-scouting", "-l", endpoint]);
        match filter {
            Some(filter) => command.env("RUST_LOG", filter),
            None => command.env_remove("RUST_LOG"),
        };
        let command = command.env_remove("NO_COLOR").stdout(stdout).stderr(stderr);
        Self(command.spawn().expect("the router starts"))
    }

    fn end_at(&mut self, signal: Signal) -> ExitStatus {
        kill(Pid::from_raw(self.0.id() as i32), signal).expect("the router runs");
        let deadline = Instant::now() + DEADLINE;
        loop {
            if let Some(status) = self.0.try_wait().expect("our child") {
                return status;
            }
            assert!(
                Instant::now() < deadline,
                "{signal} does not end the router"
            );
            thread::sleep(Duration::from_millis(5));
        }
    }
}

impl Drop for RunningRouter {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Opens a session as soon as the router listens.
fn session(endpoint: &str) -> Session {
    let deadline = Instant::now() + DEADLINE;
    loop {
        match client_with(endpoint, &[]) {
            Ok(session) => return session,
            Err(error) => assert!(Instant::now() < deadline, "{error}"),
        }
        thread::sleep(Duration::from_millis(20));
    }
}

fn endpoint() -> String {
    format!("tcp/{}", free_socket())
}

#[test]
fn a_signal_ends_the_router_after_the_log_was_closed() {
    let endpoint = endpoint();
    let mut router = RunningRouter::start(&endpoint, None, Stdio::piped(), Stdio::piped());
    let (log, errors) = (router.0.stdout.take(), router.0.stderr.take());
    let mut lines = BufReader::new(log.expect("piped")).lines();
    lines
        .find(|line| (line.as_ref()).is_ok_and(|line| line.contains("rect-router is up")))
        .expect("it starts")
        .expect("text");
    drop((lines, errors));
    let (one, two) = (session(&endpoint), session(&endpoint));
    assert!(arrives(&one, &two, "demo/x"));
    assert_eq!(router.end_at(Signal::SIGTERM).code(), Some(0));
}

#[test]
fn the_router_starts_and_ends_although_the_log_cannot_be_written() {
    let endpoint = endpoint();
    let full = || -> Stdio {
        let full = OpenOptions::new().write(true).open("/dev/full");
        full.expect("Linux has it").into()
    };
    let mut router = RunningRouter::start(&endpoint, None, full(), full());
    let (one, two) = (session(&endpoint), session(&endpoint));
    assert!(arrives(&one, &two, "demo/x"));
    assert_eq!(router.end_at(Signal::SIGTERM).code(), Some(0));
}

#[test]
fn the_router_works_and_ends_although_the_log_is_not_read() {
    let endpoint = endpoint();
    // This level logs far more than a pipe holds, and nothing reads the pipe.
    let mut router = RunningRouter::start(&endpoint, Some("trace"), Stdio::piped(), Stdio::piped());
    let (one, two) = (session(&endpoint), session(&endpoint));
    for _ in 0..5 {
        assert!(arrives(&one, &two, "demo/x"));
    }
    assert_eq!(router.end_at(Signal::SIGTERM).code(), Some(0));
}

#[test]
fn a_log_file_has_no_colours_and_no_long_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("log");
    let (endpoint, log) = (endpoint(), File::create(&path).expect("created"));
    let mut router = RunningRouter::start(&endpoint, None, log.into(), Stdio::null());
    drop(session(&endpoint));
    let deadline = Instant::now() + DEADLINE;
    let text = || std::fs::read_to_string(&path).expect("text");
    while !text().contains("rect-router is up") {
        assert!(Instant::now() < deadline, "{}", text());
        thread::sleep(Duration::from_millis(5));
    }
    assert_eq!(router.end_at(Signal::SIGTERM).code(), Some(0));
    let text = text();
    assert!(text.contains("closed"), "{text}");
    assert!(!text.contains('\x1b'), "{text}");
    assert!(text.lines().all(|line| line.len() < 1000), "{text}");
}
