//! Runs the plugin's router: a second router in the host's process that is linked to the host and uses its logins and access
//! control.
use std::{
    sync::atomic::{AtomicBool, Ordering},
    thread,
    time::{Duration, Instant},
};

use rect_router::{
    config::{self, Settings},
    robot_services::{self, RobotServices, RunningServices},
    status,
};
use serde_json::{json, Map, Value};
use zenoh::{
    config::ZenohId, internal::runtime::DynamicRuntime, Config, Result as ZResult, Session, Wait,
};

/// Interval at which the host is checked for a listener.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Time after which a missing listener of the host is logged.
const LISTENER_WARNING_DELAY: Duration = Duration::from_secs(5);
/// The parts of the host's configuration that the plugin's router uses, too. `transport` includes the logins.
const SHARED_SETTINGS: [&str; 6] = [
    "transport",
    "access_control",
    "timestamping",
    "metadata",
    "qos",
    "downsampling",
];

/// The configuration of a robot, from which the settings for slow links are taken.
const ROBOT: &str = include_str!("../../../config/robot.json5");
const SLOW_LINK_SETTINGS: [&str; 3] = [
    "/transport/link/tx/queue/size",
    "/transport/link/tx/queue/congestion_control/block/wait_before_close",
    "/transport/link/rx/max_message_size",
];

/// The running router of the plugin. Dropping it closes the router.
pub struct EmbeddedRouter {
    session: Session,
    robot: Option<RunningServices>,
}

impl EmbeddedRouter {
    /// Waits until the host listens, and opens the router. Returns `None` if `is_stopped` is set before.
    ///
    /// # Errors
    /// Fails if the settings are invalid or the router cannot be opened.
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
        let robot = RobotServices::prepare(settings, &mut config)?;
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

    /// Returns the Zenoh identifier of the router.
    pub fn id(&self) -> ZenohId {
        self.session.zid()
    }
}

impl Drop for EmbeddedRouter {
    fn drop(&mut self) {
        if let Err(error) = robot_services::close(&self.session, self.robot.take()) {
            tracing::warn!("rect: error while closing the plugin's router: {error}");
        }
    }
}

/// Waits until the host listens, and returns the endpoint to connect to: the given one, or the host's first listener.
/// Returns `None` if `is_stopped` is set before. Plugins start before their host listens.
fn listener_of(
    host: &DynamicRuntime,
    given: Option<String>,
    is_stopped: &AtomicBool,
) -> Option<String> {
    let started = Instant::now();
    let mut is_logged = false;
    loop {
        if is_stopped.load(Ordering::Relaxed) {
            return None;
        }
        if let Some(first) = host.get_locators().first() {
            return Some(given.unwrap_or_else(|| first.to_string()));
        }
        if !is_logged && started.elapsed() > LISTENER_WARNING_DELAY {
            is_logged = true;
            tracing::warn!(
                "rect: this zenohd has no listener for the plugin to connect to; start it with \
                 `-l tcp/127.0.0.1:7447`"
            );
        }
        thread::sleep(POLL_INTERVAL);
    }
}

/// Returns the configuration of the plugin's router, given the host's as JSON.
fn configuration(of_host: &str) -> ZResult<Config> {
    let of_host: Map<String, Value> = serde_json::from_str(of_host)?;
    let mut ours = Map::new();
    for key in SHARED_SETTINGS {
        if let Some(value) = of_host.get(key).filter(|value| !value.is_null()) {
            ours.insert(key.to_owned(), value.clone());
        }
    }
    let mut ours = Value::Object(ours);
    ours["mode"] = json!("router");
    ours["scouting"] = json!({ "multicast": { "enabled": false } });
    ours["listen"] = json!({ "exit_on_failure": false, "endpoints": [] });
    // `robot.json5` gives the reasons for these settings. The host's own values do not change.
    let robot: Value = serde_json::from_str(&Config::from_json5(ROBOT)?.to_string())?;
    ours["connect"] = robot["connect"].clone();
    ours["connect"]["endpoints"] = json!([]);
    for setting in SLOW_LINK_SETTINGS {
        let value = robot.pointer(setting).cloned().unwrap_or_default();
        put(&mut ours, setting, value);
    }
    let network = &mut ours["qos"]["network"];
    if network.as_array().is_none_or(Vec::is_empty) {
        *network = robot["qos"]["network"].clone();
    }
    Config::from_json5(&ours.to_string())
}

/// Sets the value at `path` and creates missing objects on the way.
fn put(into: &mut Value, path: &str, value: Value) {
    let parts = path.split('/').skip(1);
    *parts.fold(into, |at, part| &mut at[part]) = value;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn uses_the_hosts_access_control_but_not_its_endpoints() {
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
        assert_eq!(ours["qos"]["network"][0]["id"], "large messages");
    }
}
