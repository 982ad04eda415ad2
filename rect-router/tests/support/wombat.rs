//! Starts the router of a robot on a simulated air, with named connections.
use std::{fs, path::PathBuf};

use serde_json::{json, Value};

use super::{repository, Air, Router};

/// The router of a robot on the air, with a connections file.
pub struct Wombat {
    pub router: Router,
    /// Endpoint of the router for programs.
    pub endpoint: String,
    /// Path of the connections file.
    pub file: PathBuf,
}

impl Wombat {
    /// Starts `wombat-<number>` with these connections.
    pub fn start(air: &Air, folder: &tempfile::TempDir, number: u32, connections: &Value) -> Self {
        let file = folder.path().join(format!("connections-{number}.json"));
        fs::write(&file, connections.to_string()).expect("written");
        let settings = json!({ "connections": &file, "max_connections": 4 });
        Self::start_with(air, number, settings, file)
    }

    /// Starts `wombat-<number>` with these settings.
    pub fn start_with(air: &Air, number: u32, mut settings: Value, file: PathBuf) -> Self {
        settings["robot"] = json!(format!("wombat-{number}"));
        let settings = format!("plugins/rect:{settings}");
        let (mut router, endpoint) = simulated(air, number, &["--cfg", &settings]);
        router.up();
        Self {
            router,
            endpoint,
            file,
        }
    }

    /// Returns the TCP port of its listener.
    pub fn port(&self) -> u64 {
        let (_, port) = self.endpoint.rsplit_once(':').expect("a port");
        port.parse().expect("a number")
    }

    /// Replaces the connections file by a new one, as an editor does.
    pub fn write(&self, connections: &Value) {
        let new = self.file.with_extension("new");
        fs::write(&new, connections.to_string()).expect("written");
        fs::rename(&new, &self.file).expect("renamed");
    }
}

/// Starts a router as `wombat-<number>` with the configuration of simulations, and returns it with its endpoint for programs.
pub fn simulated(air: &Air, number: u32, more: &[&str]) -> (Router, String) {
    let config = repository().join("config/simulation.json5");
    let config = config.display().to_string();
    let radio = format!("ble/sim-wombat-{number}#name=wombat-{number}");
    let mut args = vec!["-c", &config, "-l", "tcp/127.0.0.1:0", "-l", &radio];
    args.extend(more);
    let mut router = Router::start_on(air, &args);
    let endpoint = router.listener();
    (router, endpoint)
}

/// Returns the contents of a connections file.
pub fn file(connections: &[Value]) -> Value {
    json!({ "connections": connections })
}

/// Returns a connection to a TCP port of this machine.
pub fn tcp(name: &str, port: u64) -> Value {
    json!({ "name": name, "method": "tcp", "address": "127.0.0.1", "port": port })
}

/// Returns a connection to a robot on the air.
pub fn ble(name: &str, robot: &str) -> Value {
    json!({ "name": name, "method": "ble", "address": robot })
}

/// Returns the number of connections in a reply that are connected.
pub fn connected(answer: &Value) -> usize {
    let all = answer.as_array().expect("a list");
    all.iter().filter(|one| one["state"] == "connected").count()
}
