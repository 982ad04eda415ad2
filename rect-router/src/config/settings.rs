//! Owns RECT's own settings, `plugins/rect` in the configuration: what a robot is called and which connections it has.
//! They are taken out of it, or Zenoh would look for a plugin of that name.
use std::path::PathBuf;

use rect::core::name::Name;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use zenoh::Config;

use super::ConfigError;
use crate::limits::SessionSettings;

const KEY: &str = "plugins/rect";
/// A slot that is not used costs a wake-up in ten seconds.
const DEFAULT_MAX_CONNECTIONS: usize = 32;
const MAX_CONNECTIONS: usize = 1000;
/// A Raspberry Pi's controller manages some 7 links, others dial too, and Zenoh routes over the rest of the fleet.
const DEFAULT_AUTO_LINKS: usize = 3;
/// With `auto_connect: "fleet"`, to how many a robot connects by itself at most: what a controller manages.
pub const MAX_AUTO_LINKS: usize = 7;

/// Whom a robot connects to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AutoConnect {
    /// Nobody: it waits for others.
    None,
    /// Those in the file of connections.
    #[default]
    Listed,
    /// Those, and anyone of its fleet that is heard by Bluetooth.
    Fleet,
}

impl AutoConnect {
    /// By its name.
    pub fn parse(text: &str) -> Option<Self> {
        serde_json::from_value(text.into()).ok()
    }
}

/// To whom a robot connects by itself, as the settings say, or the file of connections instead.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rule {
    /// By what rule.
    pub auto_connect: AutoConnect,
    /// With [`AutoConnect::Fleet`], to how many beside those listed.
    pub auto_links: usize,
}

impl Rule {
    /// To how many of the fleet.
    pub fn dials(&self) -> usize {
        match self.auto_connect {
            AutoConnect::Fleet => self.auto_links,
            AutoConnect::None | AutoConnect::Listed => 0,
        }
    }
}

/// `plugins: { rect: { ... } }`
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// The team, the first part of all its keys; default `rect`.
    #[serde(default = "default_fleet")]
    pub fleet: String,
    /// This robot's name, the second part.
    pub robot: String,
    /// The file of named connections; left out, there are none.
    pub connections: Option<PathBuf>,
    /// Whom to connect to; default `listed`.
    #[serde(default)]
    pub auto_connect: AutoConnect,
    /// With `auto_connect: "fleet"`: to how many by itself, 1 to 7; default 3.
    #[serde(default = "default_auto_links")]
    pub auto_links: usize,
    /// How many there may be, 1 to 1000; default 32.
    #[serde(default = "default_max_connections")]
    pub max_connections: usize,
    /// How the sessions that the router accepts are shared out; in a stock zenohd without effect.
    #[serde(default)]
    pub sessions: SessionSettings,
    /// Further listeners, such as `ble/hci0#name=wombat-1`: in a stock zenohd those of Bluetooth belong here.
    #[serde(default)]
    pub listen: Vec<String>,
    /// As whom of the login file to log in where one has to; under `rect-router`, the same as its `--login-as`.
    pub login_as: Option<String>,
    /// In a stock zenohd: its listener that RECT connects to, such as `tcp/127.0.0.1:7447`; left out, its first.
    pub host: Option<String>,
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
    /// To whom to connect as long as the file of connections does not say otherwise.
    pub fn rule(&self) -> Rule {
        Rule {
            auto_connect: self.auto_connect,
            auto_links: self.auto_links,
        }
    }

    /// Reads and checks them.
    pub fn parse(mut given: Value) -> Result<Self, ConfigError> {
        let refused = |reason: String| ConfigError::Settings { reason };
        if let Some(fields) = given.as_object_mut() {
            // Zenoh's own, about the loading of a plugin.
            fields.retain(|key, _| !key.starts_with("__"));
        }
        let settings: Self =
            serde_json::from_value(given).map_err(|error| refused(error.to_string()))?;
        for (key, name) in [("fleet", &settings.fleet), ("robot", &settings.robot)] {
            Name::new(name).map_err(|error| refused(format!("{key}: {error}")))?;
        }
        for (key, given, most) in [
            ("max_connections", settings.max_connections, MAX_CONNECTIONS),
            ("auto_links", settings.auto_links, MAX_AUTO_LINKS),
        ] {
            if !(1..=most).contains(&given) {
                return Err(refused(format!("{key} {given} is to be 1 to {most}")));
            }
        }
        Ok(settings)
    }
}

/// Takes them out of a configuration; `None`: RECT adds nothing to this router.
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
        assert!(take(&mut config)?.is_none(), "taken out");
        Ok(settings)
    }

    #[test]
    fn what_is_left_out_has_a_default() {
        assert_eq!(taken("{}").expect("none"), None);
        let settings = taken(r#"{ plugins: { rect: { robot: "wombat-1" } } }"#);
        let expected = Settings {
            fleet: "rect".into(),
            robot: "wombat-1".into(),
            connections: None,
            auto_connect: AutoConnect::Listed,
            auto_links: DEFAULT_AUTO_LINKS,
            max_connections: DEFAULT_MAX_CONNECTIONS,
            sessions: SessionSettings::default(),
            listen: Vec::new(),
            login_as: None,
            host: None,
        };
        assert_eq!(settings.expect("valid"), Some(expected));
    }

    #[test]
    fn what_is_wrong_is_named() {
        for (text, named) in [
            ("{}", "robot"),
            ("{ robot: 'a/b' }", "a/b"),
            ("{ robot: '**' }", "**"),
            ("{ robot: 'a', fleet: '' }", "fleet"),
            ("{ robot: 'a', fleat: 'b' }", "fleat"),
            ("{ robot: 'a', auto_connect: 'all' }", "`all`"),
            ("{ robot: 'a', auto_links: 8 }", "auto_links"),
            ("{ robot: 'a', max_connections: 0 }", "max_connections"),
            ("{ robot: 'a', max_connections: 1001 }", "max_connections"),
            ("{ robot: 'a', sessions: { per_robot: 1 } }", "per_robot"),
        ] {
            let error = taken(&format!("{{ plugins: {{ rect: {text} }} }}")).expect_err(text);
            assert!(error.to_string().contains(named), "{error}");
        }
    }
}
