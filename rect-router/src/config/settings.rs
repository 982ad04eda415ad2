//! Parses RECT's own settings, `plugins/rect` in the configuration: the robot's name, its fleet and its connections.
//! They are removed from the configuration afterwards, as Zenoh would look for a plugin of that name.
use std::path::PathBuf;

use rect_connections::{AutoConnect, AutoConnectRule, MAX_AUTO_LINKS};
use rect_core::name::Name;
use serde::Deserialize;
use serde_json::Value;
use zenoh::Config;

use super::ConfigError;

const KEY: &str = "plugins/rect";
/// Default of `max_connections`. An unused placeholder costs one wake-up in ten seconds.
const DEFAULT_MAX_CONNECTIONS: usize = 32;
const MAX_CONNECTIONS: usize = 1000;
/// Default of `auto_links`. The controller of a Raspberry Pi supports about 7 links, other robots dial too, and Zenoh
/// routes through the rest of the fleet.
const DEFAULT_AUTO_LINKS: usize = 3;

/// RECT's settings in the configuration: `plugins: { rect: { ... } }`.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Name of the fleet, the first part of all its keys; default `rect`.
    #[serde(default = "default_fleet")]
    pub fleet: String,
    /// Name of this robot, the second part of its keys.
    pub robot: String,
    /// Path of the connections file; without it the robot has no named connections.
    pub connections: Option<PathBuf>,
    /// Path of the file of the retained values that survive a restart; default `retained.cbor` beside the connections file.
    pub retained: Option<PathBuf>,
    /// Folders of the files that options of named connections may name, such as certificates, besides `/etc/rect` and the folder
    /// of the connections file. Absolute paths.
    #[serde(default)]
    pub option_folders: Vec<PathBuf>,
    /// Robots to connect to; default `listed`.
    #[serde(default)]
    pub auto_connect: AutoConnect,
    /// With `auto_connect: "fleet"`: number of links to discovered robots, 1 to 7; default 3.
    #[serde(default = "default_auto_links")]
    pub auto_links: usize,
    /// Maximum number of named connections, 1 to 1000; default 32.
    #[serde(default = "default_max_connections")]
    pub max_connections: usize,
    /// Shares of the sessions that the router accepts; without effect in a stock zenohd.
    #[serde(default)]
    pub sessions: SessionSettings,
    /// Additional listeners, such as `ble/hci0#name=wombat-1`. In a stock zenohd, Bluetooth listeners must be given here.
    #[serde(default)]
    pub listen: Vec<String>,
    /// User of the login file as which this router logs in when it dials; equivalent to `rect-router --login-as`.
    pub login_as: Option<String>,
    /// Adapters of the Bluetooth listeners. Not a setting: it is filled in from the listeners of the configuration.
    #[serde(skip)]
    pub adapters: Vec<String>,
    /// In a stock zenohd: the listener of the host that the plugin connects to, such as `tcp/127.0.0.1:7447`; default its
    /// first listener.
    pub host: Option<String>,
}

/// The settings `plugins: { rect: { sessions: { ... } } }`. An omitted one is a share of
/// `transport/unicast/max_sessions`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SessionSettings {
    /// Number of sessions reserved for links over Bluetooth and for connections that this router dials; default a quarter of
    /// all. Ignored without a Bluetooth endpoint: nothing is reserved then.
    pub bluetooth: Option<usize>,
    /// Maximum number of sessions of one login over other links than Bluetooth; default half of the remainder.
    pub per_user: Option<usize>,
    /// Maximum number of sessions from one IP address, or from all programs of this computer, over other links than
    /// Bluetooth; default three quarters of the remainder.
    pub per_address: Option<usize>,
}

fn default_fleet() -> String {
    "rect".to_owned()
}

fn default_auto_links() -> usize {
    DEFAULT_AUTO_LINKS
}

fn default_max_connections() -> usize {
    DEFAULT_MAX_CONNECTIONS
}

impl Settings {
    /// Returns the rule for automatic connections, which the connections file may override.
    pub fn rule(&self) -> AutoConnectRule {
        AutoConnectRule {
            auto_connect: self.auto_connect,
            auto_links: self.auto_links,
        }
    }

    /// Parses and validates the settings.
    ///
    /// # Errors
    /// [`ConfigError::Settings`], which names the key, if a key is unknown, missing or out of range.
    pub fn parse(mut given: Value) -> Result<Self, ConfigError> {
        let refused = |reason: String| ConfigError::Settings { reason };
        if let Some(fields) = given.as_object_mut() {
            // Zenoh's own fields, which control how a plugin is loaded.
            fields.retain(|key, _| !key.starts_with("__"));
        }
        let settings: Self =
            serde_json::from_value(given).map_err(|error| refused(error.to_string()))?;
        for (key, name) in [("fleet", &settings.fleet), ("robot", &settings.robot)] {
            Name::new(name).map_err(|error| refused(format!("{key}: {error}")))?;
        }
        for (key, given, max) in [
            ("max_connections", settings.max_connections, MAX_CONNECTIONS),
            ("auto_links", settings.auto_links, MAX_AUTO_LINKS),
        ] {
            if !(1..=max).contains(&given) {
                return Err(refused(format!("{key} is {given}, but must be 1 to {max}")));
            }
        }
        if let Some(relative) = settings
            .option_folders
            .iter()
            .find(|folder| !folder.is_absolute())
        {
            let folder = relative.display();
            return Err(refused(format!(
                "option_folders: {folder} is not an absolute path"
            )));
        }
        Ok(settings)
    }
}

/// Removes RECT's settings from a configuration and returns them; `None` if there are none, so that RECT adds no services.
pub fn take(config: &mut Config) -> Result<Option<Settings>, ConfigError> {
    let given = config.get_json(KEY).unwrap_or_default();
    let settings = match serde_json::from_str(&given) {
        Ok(Value::Null) | Err(_) => return Ok(None),
        Ok(given) => Settings::parse(given)?,
    };
    config.remove(KEY).map_err(|error| ConfigError::Settings {
        reason: error.to_string(),
    })?;
    Ok(Some(settings))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(text: &str) -> Result<Option<Settings>, ConfigError> {
        let mut config = Config::from_json5(text).expect("valid");
        let settings = take(&mut config)?;
        assert!(take(&mut config)?.is_none(), "the settings were removed");
        Ok(settings)
    }

    #[test]
    fn omitted_settings_have_defaults() {
        assert_eq!(taken("{}").expect("none"), None);
        let settings = taken(r#"{ plugins: { rect: { robot: "wombat-1" } } }"#);
        let expected = Settings {
            fleet: "rect".into(),
            robot: "wombat-1".into(),
            connections: None,
            retained: None,
            option_folders: Vec::new(),
            auto_connect: AutoConnect::Listed,
            auto_links: DEFAULT_AUTO_LINKS,
            max_connections: DEFAULT_MAX_CONNECTIONS,
            sessions: SessionSettings::default(),
            listen: Vec::new(),
            login_as: None,
            adapters: Vec::new(),
            host: None,
        };
        assert_eq!(settings.expect("valid"), Some(expected));
    }

    #[test]
    fn an_invalid_setting_is_named_in_the_error() {
        for (text, expected) in [
            ("{}", "robot"),
            ("{ robot: 'a/b' }", "a/b"),
            ("{ robot: '**' }", "**"),
            ("{ robot: 'a', fleet: '' }", "fleet"),
            ("{ robot: 'a', fleat: 'b' }", "fleat"),
            ("{ robot: 'a', auto_connect: 'all' }", "`all`"),
            ("{ robot: 'a', auto_links: 8 }", "auto_links"),
            ("{ robot: 'a', max_connections: 0 }", "max_connections"),
            ("{ robot: 'a', max_connections: 1001 }", "max_connections"),
            ("{ robot: 'a', option_folders: ['tls'] }", "option_folders"),
            ("{ robot: 'a', sessions: { per_robot: 1 } }", "per_robot"),
        ] {
            let error = taken(&format!("{{ plugins: {{ rect: {text} }} }}")).expect_err(text);
            assert!(error.to_string().contains(expected), "{error}");
        }
    }
}
