//! Owns one simulated robot: its router as a child process, with a configuration and a log in the simulation's folder.
use std::{
    env, fs,
    net::TcpListener,
    os::unix::process::CommandExt,
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use nix::{
    sys::signal::{kill, Signal},
    unistd::Pid,
};
use rect::core::endpoint;
use serde_json::json;
use zenoh::Session;
use zenoh_link::ble::radio::sim::SOCKET_VARIABLE;

use super::{Air, Failure, SimArgs};
use crate::commands::{client, RouterArgs};

/// The shipped configuration of simulated robots.
const CONFIGURATION: &str = include_str!("../../../../config/simulation.json5");
/// How long routers have to end by themselves.
const STOP_TIMEOUT: Duration = Duration::from_secs(8);
/// How much of a log is shown.
const LOG_LINES: usize = 5;

/// A robot whose router is started.
pub struct Robot {
    /// Its name.
    pub name: String,
    /// Where its programs reach its router.
    pub endpoint: String,
    log: PathBuf,
    child: Child,
}

impl Robot {
    /// Starts the router of the robot with that number; all but the first connect to the first by name.
    pub fn start(number: u16, args: &SimArgs, air: &Air, folder: &Path) -> Result<Self, Failure> {
        let name = format!("wombat-{number}");
        let endpoint = format!("tcp/127.0.0.1:{}", free_port(args.port, number - 1)?);
        let first = json!({ "name": "wombat-1", "method": "ble", "address": "wombat-1" });
        let dialled: Vec<_> = (number > 1).then_some(first).into_iter().collect();
        let connections = folder.join(format!("{name}.connections.json"));
        let text = serde_json::to_string_pretty(&json!({ "connections": dialled }))?;
        fs::write(&connections, text)?;
        let configuration = folder.join("simulation.json5");
        fs::write(&configuration, CONFIGURATION)?;
        let settings = json!({ "fleet": args.fleet, "robot": name, "connections": connections });
        let log = folder.join(format!("{name}.log"));
        let file = fs::File::create(&log)?;
        let mut command = Command::new(env::current_exe()?);
        command
            .arg("--config")
            .arg(&configuration)
            .args(["--listen", &endpoint])
            .args(["--listen", &format!("ble/sim-{name}#name={name}")])
            .args(["--cfg", &format!("plugins/rect:{settings}")])
            .env(SOCKET_VARIABLE, air.socket())
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            // Ctrl-C is for this command, which then ends the routers.
            .process_group(0);
        let child = command.spawn()?;
        Ok(Self {
            name,
            endpoint,
            log,
            child,
        })
    }

    /// A session with its router.
    pub fn session(&self) -> Result<Session, Failure> {
        Ok(client::session(&RouterArgs {
            router: self.endpoint.clone(),
            users: PathBuf::new(),
        })?)
    }

    /// Whether programs that name no router reach this one.
    pub fn has_default_endpoint(&self) -> bool {
        self.endpoint == endpoint::DEFAULT_ROUTER
    }

    /// The end of its log.
    pub fn log_tail(&self) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<_> = log.lines().collect();
        lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
    }

    fn ask_to_end(&self) {
        let Ok(id) = i32::try_from(self.child.id()) else {
            return;
        };
        // One that has ended already needs no signal.
        let _ = kill(Pid::from_raw(id), Signal::SIGTERM);
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// An error for a router that has ended by itself.
pub fn all_run(robots: &mut [Robot]) -> Result<(), Failure> {
    for robot in robots {
        if let Some(status) = robot.child.try_wait()? {
            let (name, log) = (&robot.name, robot.log_tail());
            return Err(format!("the router of {name} ended with {status}:\n{log}").into());
        }
    }
    Ok(())
}

/// Ends all routers together; one that does not end by itself is killed.
pub fn stop(mut robots: Vec<Robot>) {
    for robot in &robots {
        robot.ask_to_end();
    }
    let deadline = Instant::now() + STOP_TIMEOUT;
    for robot in &mut robots {
        while matches!(robot.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Returns the port at that offset from the first, or any free one if that is taken or the first is 0.
fn free_port(first: u16, after: u16) -> Result<u16, Failure> {
    let wanted = if first == 0 {
        0
    } else {
        first.saturating_add(after)
    };
    let free = |port| TcpListener::bind(("127.0.0.1", port));
    let listener = free(wanted).or_else(|_| free(0))?;
    Ok(listener.local_addr()?.port())
}
