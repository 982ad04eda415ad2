//! A router as a child process, and the waiting for it: by its log and with a deadline, never by sleeping.
#![allow(dead_code, unused_imports)] // each test file uses its part

mod program;
mod session;
mod team;
mod wombat;

use std::{
    io::{BufRead, BufReader, Read, Write},
    net::{TcpListener, TcpStream},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    thread,
    time::{Duration, Instant},
};

use nix::{
    sys::signal::{kill, Signal},
    unistd::Pid,
};
use serde_json::Value;
use zenoh_link::ble::radio::sim::{AirOptions, AirServer, SimAir, SOCKET_VARIABLE};

pub use self::{
    program::joined,
    session::{admin, answers, arrives, ask, change, client, client_with},
    team::{init, program, rect_router, said, start, start_with},
    wombat::{ble, connected, file, simulated, tcp, Wombat},
};

/// No step of any test takes this long, not even on a busy machine.
pub const DEADLINE: Duration = Duration::from_secs(30);

/// A running router, killed at the end of the test.
pub struct Router {
    child: Child,
    log: Receiver<String>,
    seen: Vec<String>,
}

impl Router {
    /// Starts rect-router with these arguments.
    pub fn start(args: &[&str]) -> Self {
        Self::start_program(Path::new(env!("CARGO_BIN_EXE_rect-router")), args)
    }

    /// Starts rect-router on a simulated air.
    pub fn start_on(air: &Air, args: &[&str]) -> Self {
        Self::start_program_on(air, Path::new(env!("CARGO_BIN_EXE_rect-router")), args)
    }

    /// Starts any router that logs as zenohd does.
    pub fn start_program(program: &Path, args: &[&str]) -> Self {
        Self::spawn(Command::new(program).args(args))
    }

    /// The same on a simulated air.
    pub fn start_program_on(air: &Air, program: &Path, args: &[&str]) -> Self {
        Self::spawn(
            Command::new(program)
                .args(args)
                .env(SOCKET_VARIABLE, air.socket()),
        )
    }

    fn spawn(command: &mut Command) -> Self {
        let mut child = command
            .env("NO_COLOR", "1")
            .env(
                "RUST_LOG",
                "z=info,rect=info,rect_router=debug,zenoh::net::runtime::orchestrator=debug",
            )
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|error| panic!("{command:?} does not start: {error}"));
        let (lines, log) = mpsc::channel();
        let streams: [Box<dyn Read + Send>; 2] = [
            Box::new(child.stdout.take().expect("piped")),
            Box::new(child.stderr.take().expect("piped")),
        ];
        for stream in streams {
            let lines = lines.clone();
            thread::spawn(move || {
                for line in BufReader::new(stream).lines().map_while(Result::ok) {
                    if lines.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Self {
            child,
            log,
            seen: Vec::new(),
        }
    }

    /// The rest of the first line, from now on, that has `text` in it.
    pub fn wait_for(&mut self, text: &str) -> String {
        let deadline = Instant::now() + DEADLINE;
        loop {
            match self
                .log
                .recv_timeout(deadline.saturating_duration_since(Instant::now()))
            {
                Ok(line) => {
                    let rest = line
                        .split_once(text)
                        .map(|(_, rest)| rest.trim().to_owned());
                    self.seen.push(line);
                    if let Some(rest) = rest {
                        return rest;
                    }
                }
                Err(end) => {
                    let how = match end {
                        RecvTimeoutError::Timeout => "in time",
                        RecvTimeoutError::Disconnected => "before the router ended",
                    };
                    panic!(
                        "no `{text}` in the log {how}; it was:\n{}",
                        self.seen.join("\n")
                    );
                }
            }
        }
    }

    /// The endpoint of the next listener in the log (listen on port 0 to get a free one).
    pub fn listener(&mut self) -> String {
        self.wait_for("Listener added: ")
    }

    /// The endpoint of the next listener of that kind in the log, such as `tcp/`.
    pub fn listener_of(&mut self, protocol: &str) -> String {
        loop {
            let endpoint = self.listener();
            if endpoint.starts_with(protocol) {
                return endpoint;
            }
        }
    }

    /// The configuration in use, as the log shows it.
    pub fn configuration(&mut self) -> Value {
        let text = self.wait_for("Initial conf: ");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
    }

    /// Waits until the router serves.
    pub fn up(&mut self) -> &mut Self {
        self.wait_for("rect-router is up");
        self
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("the router runs");
    }

    /// The router's end.
    pub fn exit(&mut self) -> ExitStatus {
        let deadline = Instant::now() + DEADLINE;
        loop {
            if let Some(status) = self.child.try_wait().expect("our child") {
                return status;
            }
            assert!(
                Instant::now() < deadline,
                "the router does not end; its log:\n{}",
                self.drained().join("\n")
            );
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// All that was logged so far.
    pub fn drained(&mut self) -> &[String] {
        self.seen.extend(self.log.try_iter());
        &self.seen
    }

    /// All that was logged until the end.
    pub fn full_log(&mut self) -> String {
        self.exit();
        self.seen.extend(self.log.iter());
        self.seen.join("\n")
    }

    /// The memory it takes now.
    pub fn memory(&self) -> Memory {
        let path = format!("/proc/{}/smaps_rollup", self.child.id());
        let text = std::fs::read_to_string(path).expect("linux");
        let kb = |field: &str| -> u64 {
            let line = text.lines().find(|line| line.starts_with(field));
            let number = line.and_then(|line| line.split_whitespace().nth(1));
            number.expect(field).parse().expect("a number")
        };
        Memory {
            // Not `Private_Dirty`: that counts a program's text, too, until the system has written a new build to disk.
            own_kb: kb("Anonymous:") + kb("Swap:"),
            resident_kb: kb("Rss:"),
        }
    }
}

/// What a process takes of a machine's memory.
#[derive(Clone, Copy, Debug)]
pub struct Memory {
    /// What nobody else can have while it runs: its heap, its stacks, what it has changed of its program's data.
    pub own_kb: u64,
    /// With the pages of its program and libraries that are in memory at the moment, which the system drops and reads from
    /// the file again as it likes, and which processes share.
    pub resident_kb: u64,
}

impl Drop for Router {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A simulated air of this test's own, as `rect air` serves one.
pub struct Air {
    dir: tempfile::TempDir,
    runtime: tokio::runtime::Runtime,
    air: SimAir,
}

impl Air {
    /// Begins to serve.
    pub fn new() -> Self {
        Self::with(AirOptions::default())
    }

    /// The same with other properties.
    pub fn with(options: AirOptions) -> Self {
        let dir = tempfile::tempdir().expect("a directory");
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(1)
            .enable_all()
            .build()
            .expect("a runtime");
        let path = dir.path().join("air.sock");
        let air = runtime.block_on(async move {
            let server = AirServer::bind(&path, options).expect("an air");
            let air = server.air().clone();
            tokio::spawn(server.serve());
            air
        });
        Self { dir, runtime, air }
    }

    /// For cutting it, and the like.
    pub fn air(&self) -> &SimAir {
        &self.air
    }

    /// Where it is served.
    pub fn socket(&self) -> PathBuf {
        self.dir.path().join("air.sock")
    }

    /// The air is gone, and every link on it.
    pub fn end(self) {
        self.runtime.shutdown_background();
    }
}

/// Says why a test does not run here. With `RECT_NO_SKIP` set, as in CI, that is a failure.
pub fn skip(reason: &str) {
    assert!(
        std::env::var_os("RECT_NO_SKIP").is_none(),
        "not to be skipped: {reason}"
    );
    println!("skipped: {reason}");
}

/// A login file in that folder, and the arguments that make a router use it.
pub fn login_file(folder: &Path, logins: &str) -> [String; 2] {
    let path = folder.join("users");
    std::fs::write(&path, logins).expect("written");
    let setting = format!(
        "transport/auth/usrpwd/dictionary_file:\"{}\"",
        path.display()
    );
    ["--cfg".to_owned(), setting]
}

/// The repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("a member of the workspace")
        .to_owned()
}

/// Where a build of this profile puts its results.
pub fn built_with(profile: &str) -> PathBuf {
    let exe = std::env::current_exe().expect("this test is a program");
    let folder = if profile == "dev" { "debug" } else { profile };
    // target/debug/deps/this-test
    exe.ancestors().nth(3).expect("cargo's layout").join(folder)
}

/// Where big things that outlive a build are kept.
pub fn cache() -> PathBuf {
    match std::env::var_os("RECT_CACHE") {
        Some(cache) => cache.into(),
        None => PathBuf::from(std::env::var_os("HOME").expect("a home")).join(".cache/rect"),
    }
}

/// An address of this machine where nobody listens.
pub fn free_socket() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").to_string()
}

/// The answer to an HTTP GET, tried until there is one with a body of JSON that is not empty.
pub fn got(socket: &str, path: &str) -> String {
    let deadline = Instant::now() + DEADLINE;
    let mut last = String::new();
    while Instant::now() < deadline {
        if let Ok(mut stream) = TcpStream::connect(socket) {
            let request =
                format!("GET {path} HTTP/1.1\r\nHost: {socket}\r\nConnection: close\r\n\r\n");
            stream.write_all(request.as_bytes()).expect("sent");
            last.clear();
            let _ = stream.read_to_string(&mut last);
            if last.starts_with("HTTP/1.1 200") && last.contains('{') {
                return last;
            }
        }
        thread::sleep(Duration::from_millis(50));
    }
    panic!("GET {path} gives nothing: {last}");
}
