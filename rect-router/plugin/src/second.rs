//! Owns the plugin's router: a second one in the host's process, linked to it, with the host's rules about who may do what.
use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use rect_router::{
    config::{self, Settings},
    robot::{self, Robot, Running},
    status,
};
use serde_json::{json, Map, Value};
use zenoh::{
    config::ZenohId, internal::runtime::DynamicRuntime, Config, Result as ZResult, Session, Wait,
};

/// How often to look whether the host listens.
const LOOK_AGAIN: Duration = Duration::from_millis(20);
/// How long a host may take to listen until that is said.
const PATIENCE: Duration = Duration::from_secs(5);
/// What of the host's configuration holds for the plugin's router too: logins, access, quality of service, timestamps.
const SHARED: [&str; 6] = [
    "transport",
    "access_control",
    "timestamping",
    "metadata",
    "qos",
    "downsampling",
];

/// What a robot's router has for the sake of its radio.
const ROBOT: &str = include_str!("../../../config/robot.json5");
const FOR_SLOW_LINKS: [&str; 3] = [
    "/transport/link/tx/queue/size",
    "/transport/link/tx/queue/congestion_control/block/wait_before_close",
    "/transport/link/rx/max_message_size",
];

/// The plugin's router while it runs.
pub struct Second {
    session: Session,
    robot: Option<Running>,
}

impl Second {
    /// Waits until the host listens, and opens it. `None`: stopped before that.
    pub fn open(
        settings: Settings,
        host: &DynamicRuntime,
        is_stopped: &AtomicBool,
    ) -> ZResult<Option<Self>> {
        let Some(to_host) = listener_of(host, settings.host.clone(), is_stopped) else {
            return Ok(None);
        };
        let mut config = configuration(&host.get_config().to_string())?;
        config::listen(&mut config, &settings.listen)?;
        config::dial(&mut config, [to_host])?;
        config::log_in(&mut config, settings.login_as.as_deref())?;
        let robot = Robot::prepare(settings, &mut config)?;
        config::check_ble_endpoints(&config)?;
        let session = zenoh::open(config).wait()?;
        status::serve(&session)?;
        let of_host = zenoh::session::init(host.clone()).wait()?;
        let robot = robot.start(&session, Some(of_host))?;
        Ok(Some(Self {
            session,
            robot: Some(robot),
        }))
    }

    /// Its identifier.
    pub fn id(&self) -> ZenohId {
        self.session.zid()
    }
}

impl Drop for Second {
    fn drop(&mut self) {
        if let Err(error) = robot::close(&self.session, self.robot.take()) {
            tracing::warn!("rect: while closing: {error}");
        }
    }
}

/// Where the host can be reached: as the settings say, or at its first listener. Plugins start before it listens.
fn listener_of(
    host: &DynamicRuntime,
    given: Option<String>,
    is_stopped: &AtomicBool,
) -> Option<String> {
    let started = Instant::now();
    let mut is_said = false;
    loop {
        if is_stopped.load(Ordering::Relaxed) {
            return None;
        }
        if let Some(first) = host.get_locators().first() {
            return Some(given.unwrap_or_else(|| first.to_string()));
        }
        if !is_said && started.elapsed() > PATIENCE {
            is_said = true;
            tracing::warn!(
                "rect: this zenohd listens nowhere, and the plugin connects to a listener: start it with \
                 `-l tcp/127.0.0.1:7447`"
            );
        }
        thread::sleep(LOOK_AGAIN);
    }
}

fn configuration(of_host: &str) -> ZResult<Config> {
    let of_host: Map<String, Value> = serde_json::from_str(of_host)?;
    let mut ours = Map::new();
    for key in SHARED {
        if let Some(value) = of_host.get(key).filter(|value| !value.is_null()) {
            ours.insert(key.to_owned(), value.clone());
        }
    }
    let mut ours = Value::Object(ours);
    ours["mode"] = json!("router");
    ours["scouting"] = json!({ "multicast": { "enabled": false } });
    ours["listen"] = json!({ "exit_on_failure": false, "endpoints": [] });
    // The reasons are there; the host keeps its own.
    let robot: Value = serde_json::from_str(&Config::from_json5(ROBOT)?.to_string())?;
    ours["connect"] = robot["connect"].clone();
    ours["connect"]["endpoints"] = json!([]);
    for setting in FOR_SLOW_LINKS {
        let value = robot.pointer(setting).cloned().unwrap_or_default();
        put(&mut ours, setting, value);
    }
    Config::from_json5(&ours.to_string())
}

/// Puts a value where the path leads, and what is missing on the way there.
fn put(into: &mut Value, path: &str, value: Value) {
    let parts = path.split('/').skip(1);
    *parts.fold(into, |at, part| &mut at[part]) = value;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hosts_rules_hold_and_its_endpoints_do_not() {
        let mut host = Config::default();
        for (key, value) in [
            ("listen/endpoints", "['tcp/127.0.0.1:1']"),
            ("connect/endpoints", "['tcp/127.0.0.1:2']"),
            (
                "access_control",
                "{ enabled: true, default_permission: 'deny' }",
            ),
            ("plugins/rect", "{ robot: 'wombat-1' }"),
            ("id", "'abc'"),
        ] {
            host.insert_json5(key, value).expect(key);
        }
        let ours = configuration(&host.to_string()).expect("valid");
        let ours = serde_json::to_value(&ours).expect("JSON");
        assert_eq!(ours["access_control"]["default_permission"], "deny");
        assert_eq!(ours["listen"]["endpoints"], json!([]));
        assert!(!ours.to_string().contains("127.0.0.1"), "{ours}");
        assert_ne!(ours["id"], "abc");
        let queue = &ours["transport"]["link"]["tx"]["queue"];
        assert_eq!(queue["size"]["data"], 8, "{queue}");
        let block = &queue["congestion_control"]["block"];
        assert_eq!(block["wait_before_close"], 60_000_000, "{queue}");
        assert_eq!(
            ours["transport"]["link"]["rx"]["max_message_size"],
            16 << 20
        );
        assert_eq!(ours["connect"]["timeout_ms"], -1);
    }
}
