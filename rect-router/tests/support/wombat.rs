//! A robot of a test: its router on a simulated air, and its named connections.
use std::{fs, path::PathBuf};

use serde_json::{json, Value};

use super::{repository, Air, Router};

/// A robot's router on the air, with a file of connections.
pub struct Wombat {
    pub router: Router,
    /// For its programs.
    pub endpoint: String,
    /// Of connections.
    pub file: PathBuf,
}

impl Wombat {
    /// Number `number`, with these connections.
    pub fn start(air: &Air, folder: &tempfile::TempDir, number: u32, connections: &Value) -> Self {
        let file = folder.path().join(format!("connections-{number}.json"));
        fs::write(&file, connections.to_string()).expect("written");
        let settings = json!({ "connections": &file, "max_connections": 4 });
        Self::start_with(air, number, settings, file)
    }

    /// With other settings than those.
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

    /// Of its listener.
    pub fn port(&self) -> u64 {
        let (_, port) = self.endpoint.rsplit_once(':').expect("a port");
        port.parse().expect("a number")
    }

    /// As an editor or a careful program would: a new file in the place of the old one.
    pub fn write(&self, connections: &Value) {
        let new = self.file.with_extension("new");
        fs::write(&new, connections.to_string()).expect("written");
        fs::rename(&new, &self.file).expect("renamed");
    }
}

/// A router with the simulation's configuration on the air as `wombat-<number>`, and where its programs reach it.
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

/// The content of a file of connections.
pub fn file(connections: &[Value]) -> Value {
    json!({ "connections": connections })
}

/// A connection with a port of this machine.
pub fn tcp(name: &str, port: u64) -> Value {
    json!({ "name": name, "method": "tcp", "address": "127.0.0.1", "port": port })
}

/// A connection with a robot on the air.
pub fn ble(name: &str, robot: &str) -> Value {
    json!({ "name": name, "method": "ble", "address": robot })
}

/// How many are there.
pub fn connected(answer: &Value) -> usize {
    let all = answer.as_array().expect("a list");
    all.iter().filter(|one| one["state"] == "connected").count()
}
