//! Runs routers as child processes for tests. Tests wait for lines of their logs with a deadline rather than sleep.
#![allow(dead_code, unused_imports)] // each test file uses only a part

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
use zenoh_link_ble_air::{AirOptions, AirServer, SimAir, SOCKET_VARIABLE};

pub use self::{
    program::joined,
    session::{admin, answers, arrives, ask, change, client, client_with},
    team::{init, program, rect_router, start, start_with, text_of},
    wombat::{ble, connected, file, simulated, tcp, Wombat},
};

/// Timeout of each step of a test, sufficient even on a busy machine.
pub const DEADLINE: Duration = Duration::from_secs(30);

/// Applies the shipped rules for links to other computers to the TCP links of a test; programs use the socket file.
pub const AS_ROBOTS: &str = "access_control/subjects:[{id:'robots',link_protocols:['tcp']},\
                         {id:'programs over tcp',link_protocols:['ws']},\
                         {id:'configuration users',link_protocols:['ws']},\
                         {id:'programs over a socket file',link_protocols:['unixsock-stream']}]";

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

    /// Starts any router on a simulated air.
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

    /// Waits for the next line of the log that contains `text`, and returns the rest of that line.
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
                    let when = match end {
                        RecvTimeoutError::Timeout => "in time",
                        RecvTimeoutError::Disconnected => "before the router ended",
                    };
                    panic!(
                        "no `{text}` in the log {when}; the log:\n{}",
                        self.seen.join("\n")
                    );
                }
            }
        }
    }

    /// Returns the endpoint of the next listener in the log. Tests listen on port 0 to get a free port.
    pub fn listener(&mut self) -> String {
        self.wait_for("Listener added: ")
    }

    /// Returns the endpoint of the next listener in the log whose protocol is `protocol`, such as `tcp/`.
    pub fn listener_of(&mut self, protocol: &str) -> String {
        loop {
            let endpoint = self.listener();
            if endpoint.starts_with(protocol) {
                return endpoint;
            }
        }
    }

    /// Returns the configuration in use, as shown in the log.
    pub fn configuration(&mut self) -> Value {
        let text = self.wait_for("Initial conf: ");
        serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {text}"))
    }

    /// Waits until the router is up.
    pub fn up(&mut self) -> &mut Self {
        self.wait_for("rect-router is up");
        self
    }

    /// Sends a signal.
    pub fn signal(&self, signal: Signal) {
        kill(Pid::from_raw(self.child.id() as i32), signal).expect("the router runs");
    }

    /// Waits until the router exits, and returns its status.
    pub fn exit(&mut self) -> ExitStatus {
        let deadline = Instant::now() + DEADLINE;
        loop {
            if let Some(status) = self.child.try_wait().expect("our child") {
                return status;
            }
            assert!(
                Instant::now() < deadline,
                "the router does not exit; its log:\n{}",
                self.drained().join("\n")
            );
            thread::sleep(Duration::from_millis(5));
        }
    }

    /// Returns all lines logged so far.
    pub fn drained(&mut self) -> &[String] {
        self.seen.extend(self.log.try_iter());
        &self.seen
    }

    /// Waits until the router exits, and returns its whole log.
    pub fn full_log(&mut self) -> String {
        self.exit();
        self.seen.extend(self.log.iter());
        self.seen.join("\n")
    }

    /// Returns the current memory use of the router.
    pub fn memory(&self) -> Memory {
        let path = format!("/proc/{}/smaps", self.child.id());
        let text = std::fs::read_to_string(path).expect("linux");
        let mut memory = Memory::default();
        let mut is_file = false;
        for line in text.lines() {
            let fields: Vec<&str> = line.split_whitespace().collect();
            match fields[..] {
                [field, kb, "kB"] => {
                    let kb: u64 = kb.parse().expect("a number");
                    match field {
                        "Anonymous:" | "Swap:" if !is_file => memory.heap_and_stacks_kb += kb,
                        "Rss:" => memory.resident_kb += kb,
                        _ => {}
                    }
                }
                // A mapping: addresses, permissions, offset, device, inode and the name, which may be missing.
                [_, _, _, _, inode, ..] if !line.starts_with("VmFlags:") => is_file = inode != "0",
                _ => {}
            }
        }
        memory
    }
}

/// Memory use of a process.
#[derive(Clone, Copy, Debug, Default)]
pub struct Memory {
    /// Memory in kB that the process has allocated, without the data of the program, whose size depends on the optimisation.
    pub heap_and_stacks_kb: u64,
    /// Resident memory in kB, which includes the program and its libraries.
    pub resident_kb: u64,
}

impl Drop for Router {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A simulated air for one test, served as by `rect air`.
pub struct Air {
    dir: tempfile::TempDir,
    runtime: tokio::runtime::Runtime,
    air: SimAir,
}

impl Air {
    /// Starts serving an air with default options.
    pub fn new() -> Self {
        Self::with(AirOptions::default())
    }

    /// Starts serving an air with other options.
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

    /// Returns the air, which tests can cut, for example.
    pub fn air(&self) -> &SimAir {
        &self.air
    }

    /// Returns the path of its socket.
    pub fn socket(&self) -> PathBuf {
        self.dir.path().join("air.sock")
    }

    /// Stops the air, and with it all links.
    pub fn end(self) {
        self.runtime.shutdown_background();
    }
}

/// Reports why a test is skipped. With `RECT_NO_SKIP` set, as in CI, skipping is a failure.
pub fn skip(reason: &str) {
    assert!(
        std::env::var_os("RECT_NO_SKIP").is_none(),
        "RECT_NO_SKIP is set, but this test cannot run: {reason}"
    );
    println!("skipped: {reason}");
}

/// Writes a login file to `folder`, and returns the arguments that make a router use it.
pub fn login_file(folder: &Path, logins: &str) -> [String; 2] {
    let path = folder.join("users");
    std::fs::write(&path, logins).expect("written");
    let setting = format!(
        "transport/auth/usrpwd/dictionary_file:\"{}\"",
        path.display()
    );
    ["--cfg".to_owned(), setting]
}

/// Returns the root folder of the repository.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("a member of the workspace")
        .to_owned()
}

/// Returns the folder of what was built with the profile of this test.
pub fn built() -> PathBuf {
    let exe = std::env::current_exe().expect("this test is a program");
    // target/checked/deps/this-test
    exe.ancestors().nth(2).expect("cargo's layout").to_owned()
}

/// Returns the folder for large files that are kept between builds.
pub fn cache() -> PathBuf {
    match std::env::var_os("RECT_CACHE") {
        Some(cache) => cache.into(),
        None => PathBuf::from(std::env::var_os("HOME").expect("a home")).join(".cache/rect"),
    }
}

/// Returns a socket address of this machine that is not in use.
pub fn free_socket() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    listener.local_addr().expect("an address").to_string()
}

/// Repeats an HTTP GET until the response has a JSON body that is not empty, and returns the response.
pub fn http_get(socket: &str, path: &str) -> String {
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
    panic!("GET {path} returns no data: {last}");
}
