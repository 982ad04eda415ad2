//! Runs the router of one simulated robot as a child process, with a configuration and a log in the simulation's folder.
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
use rect_core::session::endpoint;
use serde_json::json;
use zenoh::Session;
use zenoh_link_ble_air::SOCKET_VARIABLE;

use super::{Air, Failure};
use crate::{
    args::{RouterArgs, SimArgs},
    commands::client,
};

/// The shipped configuration of simulated robots.
const CONFIGURATION: &str = include_str!("../../../../config/simulation.json5");
/// Time for which routers may end by themselves before they are killed.
const STOP_TIMEOUT: Duration = Duration::from_secs(8);
/// Number of lines of a log that are shown.
const LOG_LINES: usize = 5;

/// The files that all routers read. They are written before the first router starts, and never again, so that no router reads a
/// file while it is written.
pub struct SharedFiles {
    folder: PathBuf,
    configuration: PathBuf,
    secret: PathBuf,
}

impl SharedFiles {
    /// Writes the files to the folder of the simulation.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn write(folder: &Path) -> Result<Self, Failure> {
        let configuration = folder.join("simulation.json5");
        fs::write(&configuration, CONFIGURATION)?;
        let secret = folder.join("secret");
        fs::write(&secret, "sim:the secret of simulated robots\n")?;
        Ok(Self {
            folder: folder.to_owned(),
            configuration,
            secret,
        })
    }
}

/// A simulated robot. Dropping it kills its router.
pub struct SimulatedRobot {
    /// Name of the robot.
    pub name: String,
    /// Endpoint of its router for programs.
    pub endpoint: String,
    log: PathBuf,
    child: Child,
}

impl SimulatedRobot {
    /// Starts the router of the robot with this number, from 1. All robots except the first connect to the first by name.
    ///
    /// # Errors
    /// Fails if the configuration cannot be written or the router cannot be started.
    pub fn start(
        number: u16,
        args: &SimArgs,
        air: &Air,
        files: &SharedFiles,
    ) -> Result<Self, Failure> {
        let folder = &files.folder;
        let name = format!("wombat-{number}");
        let endpoint = format!("tcp/127.0.0.1:{}", free_port(args.port, number - 1)?);
        let method = if args.wifi { "any" } else { "ble" };
        let protection = match args.wifi {
            // A Wi-Fi path exists only for a link with a secret.
            true => format!(";secret={}", files.secret.display()),
            false => String::new(),
        };
        let first = json!({ "name": "wombat-1", "method": method, "address": "wombat-1" });
        let dialled: Vec<_> = (number > 1).then_some(first).into_iter().collect();
        let connections = folder.join(format!("{name}.connections.json"));
        let text = serde_json::to_string_pretty(&json!({ "connections": dialled }))?;
        fs::write(&connections, text)?;
        let settings = json!({ "fleet": args.fleet, "robot": name, "connections": connections });
        let log = folder.join(format!("{name}.log"));
        let file = fs::File::create(&log)?;
        let mut command = Command::new(env::current_exe()?);
        command
            .arg("--config")
            .arg(&files.configuration)
            .args(["--listen", &endpoint])
            .args([
                "--listen",
                &format!("{method}/sim-{name}#name={name}{protection}"),
            ])
            .args(["--cfg", &format!("plugins/rect:{settings}")])
            .env(SOCKET_VARIABLE, air.socket())
            .stdin(Stdio::null())
            .stdout(file.try_clone()?)
            .stderr(file)
            // A process group of its own keeps Ctrl-C from the routers; this command stops them.
            .process_group(0);
        let child = command.spawn()?;
        Ok(Self {
            name,
            endpoint,
            log,
            child,
        })
    }

    /// Opens a session with the robot's router.
    ///
    /// # Errors
    /// Fails if the router does not answer.
    pub fn session(&self) -> Result<Session, Failure> {
        Ok(client::session(&RouterArgs {
            router: self.endpoint.clone(),
            users: PathBuf::new(),
        })?)
    }

    /// Returns whether programs that name no router connect to this one.
    pub fn has_default_endpoint(&self) -> bool {
        self.endpoint == endpoint::DEFAULT_ROUTER
    }

    /// Returns the last lines of the router's log.
    pub fn log_tail(&self) -> String {
        let log = fs::read_to_string(&self.log).unwrap_or_default();
        let lines: Vec<_> = log.lines().collect();
        lines[lines.len().saturating_sub(LOG_LINES)..].join("\n")
    }

    fn terminate(&self) {
        let Ok(id) = i32::try_from(self.child.id()) else {
            return;
        };
        // Sending fails if the router has ended already.
        let _ = kill(Pid::from_raw(id), Signal::SIGTERM);
    }
}

impl Drop for SimulatedRobot {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Checks that all routers are running.
///
/// # Errors
/// Fails with the log of a router that has ended.
pub fn check_running(robots: &mut [SimulatedRobot]) -> Result<(), Failure> {
    for robot in robots {
        if let Some(status) = robot.child.try_wait()? {
            let (name, log) = (&robot.name, robot.log_tail());
            return Err(format!("the router of {name} ended with {status}:\n{log}").into());
        }
    }
    Ok(())
}

/// Stops all routers at the same time. A router that does not end in time is killed.
pub fn stop(mut robots: Vec<SimulatedRobot>) {
    for robot in &robots {
        robot.terminate();
    }
    let deadline = Instant::now() + STOP_TIMEOUT;
    for robot in &mut robots {
        while matches!(robot.child.try_wait(), Ok(None)) && Instant::now() < deadline {
            thread::sleep(Duration::from_millis(20));
        }
    }
}

/// Returns the port `first + offset`, or any free port if that one is in use or `first` is 0.
fn free_port(first: u16, offset: u16) -> Result<u16, Failure> {
    let preferred = if first == 0 {
        0
    } else {
        first.saturating_add(offset)
    };
    let free = |port| TcpListener::bind(("127.0.0.1", port));
    let listener = free(preferred).or_else(|_| free(0))?;
    Ok(listener.local_addr()?.port())
}
