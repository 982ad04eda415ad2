//! Flags become a Zenoh configuration, in zenohd's order: the file or the whole-configuration `--cfg`, then each flag,
//! then each `--cfg KEY:VALUE`. What zenohd answers with a panic or a warning is an error here.

use std::{fs, io, path::PathBuf};

use serde_json::Value;
use validated_struct::InsertionError;
use zenoh::{config::WhatAmI, Config};
use zenoh_config::{EndPoint, EndPoints, ModeDependent, ModeDependentValue, PermissionsConf};
use zenoh_link::ble::locator::{ConnectLocator, ListenLocator, LocatorError, BLE_LOCATOR_PREFIX};
use zenoh_util::LibSearchDirs;

use crate::args::Args;

/// The configuration that these flags ask for.
pub fn from_args(args: &Args) -> Result<Config, ConfigError> {
    let settings = args
        .cfg
        .iter()
        .map(|given| Setting::parse(given))
        .collect::<Result<Vec<_>, _>>()?;
    let mut config = base(args, &settings)?;
    set_identity(&mut config, args)?;
    set_plugins(&mut config, args)?;
    set_endpoints(&mut config, args)?;
    set_scouting_and_time(&mut config, args)?;
    set_permissions(&mut config, args)?;
    for setting in settings.iter().filter(|s| !s.key.is_empty()) {
        setting.apply(&mut config)?;
    }
    let logins = logins(&config)?;
    if let Some(user) = &args.login_as {
        log_in_as(&mut config, user, logins)?;
    }
    check_ble_endpoints(&config)?;
    tracing::debug!("Config: {}", without_secrets(&config));
    Ok(config)
}

/// The configuration as text for the log, its passwords and private keys struck out.
pub fn without_secrets(config: &Config) -> String {
    match serde_json::to_value(config) {
        Ok(mut value) => {
            strike_out(&mut value);
            value.to_string()
        }
        Err(error) => format!("(not to be shown: {error})"),
    }
}

fn strike_out(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                if value.is_string() && (key == "password" || key.contains("private_key")) {
                    *value = "***".into();
                } else {
                    strike_out(value);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(strike_out),
        _ => {}
    }
}

/// One `--cfg`.
struct Setting<'a> {
    given: &'a str,
    key: &'a str,
    value: &'a str,
}

impl<'a> Setting<'a> {
    fn parse(given: &'a str) -> Result<Self, ConfigError> {
        match given.split_once(':') {
            Some((key, value)) => Ok(Self { given, key, value }),
            None => Err(ConfigError::SettingWithoutColon {
                given: given.to_owned(),
            }),
        }
    }

    fn apply(&self, config: &mut Config) -> Result<(), ConfigError> {
        let refused = |reason: String| ConfigError::Setting {
            given: self.given.to_owned(),
            reason,
        };
        let mut value = json5::Deserializer::from_str(self.value)
            .map_err(|error| refused(format!("the value is not JSON5: {error}")))?;
        let key = self.key.strip_prefix('/').unwrap_or(self.key);
        config.insert(key, &mut value).map_err(|error| match error {
            InsertionError::Str(text) => refused(text.to_owned()),
            InsertionError::String(text) => refused(text),
            other => refused(other.to_string()),
        })
    }
}

fn base(args: &Args, settings: &[Setting]) -> Result<Config, ConfigError> {
    let whole = settings.iter().rev().find(|s| s.key.is_empty());
    let mut config = match (whole, &args.config) {
        (Some(whole), file) => {
            if let Some(file) = file {
                tracing::warn!("--cfg gives the whole configuration: {file} is not read");
            }
            Config::from_json5(whole.value).map_err(|source| ConfigError::Whole { source })?
        }
        (None, Some(path)) => Config::from_file(path).map_err(|source| ConfigError::File {
            path: path.into(),
            source,
        })?,
        (None, None) => Config::default(),
    };
    if config.mode().is_none() {
        set(config.set_mode(Some(WhatAmI::Router)), "mode", "router")?;
    }
    Ok(config)
}

fn set_identity(config: &mut Config, args: &Args) -> Result<(), ConfigError> {
    let Some(id) = &args.id else { return Ok(()) };
    let parsed = id.parse().map_err(|source| ConfigError::Id {
        given: id.clone(),
        source,
    })?;
    set(config.set_id(Some(parsed)), "id", id)
}

fn set_plugins(config: &mut Config, args: &Args) -> Result<(), ConfigError> {
    let mut insert = |key: String, value: Value| {
        config
            .insert_json5(&key, &value.to_string())
            .map_err(|source| ConfigError::Plugin {
                setting: format!("{key}:{value}"),
                source,
            })
    };
    if let Some(socket) = args
        .rest_http_port
        .as_deref()
        .filter(|s| !s.eq_ignore_ascii_case("none"))
    {
        insert("plugins/rest/http_port".into(), socket.into())?;
        insert("plugins/rest/__required__".into(), true.into())?;
    }
    for plugin in &args.plugin {
        let (name, path) = match plugin.split_once(':') {
            Some((name, path)) => (name, Some(path)),
            None => (plugin.as_str(), None),
        };
        insert(format!("plugins/{name}/__required__"), true.into())?;
        if let Some(path) = path {
            insert(format!("plugins/{name}/__path__"), path.into())?;
        }
    }
    set(
        config.adminspace.set_enabled(true),
        "adminspace/enabled",
        "true",
    )?;
    set(
        config.plugins_loading.set_enabled(true),
        "plugins_loading/enabled",
        "true",
    )?;
    if !args.plugin_search_dir.is_empty() {
        let dirs = LibSearchDirs::from_paths(&args.plugin_search_dir);
        set(
            config.plugins_loading.set_search_dirs(dirs),
            "plugins_loading/search_dirs",
            "as given",
        )?;
    }
    Ok(())
}

fn set_endpoints(config: &mut Config, args: &Args) -> Result<(), ConfigError> {
    if !args.connect.is_empty() {
        let endpoints: Vec<EndPoints> = args
            .connect
            .iter()
            .map(|given| endpoint("--connect", given))
            .collect::<Result<_, _>>()?;
        set(
            config.connect.endpoints.set(endpoints),
            "connect/endpoints",
            "as given",
        )?;
    }
    if !args.listen.is_empty() {
        let endpoints: Vec<EndPoint> = args
            .listen
            .iter()
            .map(|given| endpoint("--listen", given))
            .collect::<Result<_, _>>()?;
        set(
            config.listen.endpoints.set(endpoints),
            "listen/endpoints",
            "as given",
        )?;
    }
    Ok(())
}

fn endpoint<T>(flag: &'static str, given: &str) -> Result<T, ConfigError>
where
    T: std::str::FromStr<Err = zenoh::Error>,
{
    given.parse().map_err(|source| ConfigError::Endpoint {
        flag,
        given: given.to_owned(),
        source,
    })
}

fn set_scouting_and_time(config: &mut Config, args: &Args) -> Result<(), ConfigError> {
    if args.no_timestamp {
        let off = Some(ModeDependentValue::Unique(false));
        set(
            config.timestamping.set_enabled(off),
            "timestamping/enabled",
            "false",
        )?;
    }
    let multicast = &mut config.scouting.multicast;
    if args.no_multicast_scouting {
        set(
            multicast.set_enabled(Some(false)),
            "scouting/multicast/enabled",
            "false",
        )?;
    } else if multicast.enabled().is_none() {
        set(
            multicast.set_enabled(Some(true)),
            "scouting/multicast/enabled",
            "true",
        )?;
    }
    Ok(())
}

fn set_permissions(config: &mut Config, args: &Args) -> Result<(), ConfigError> {
    let Some(given) = &args.adminspace_permissions else {
        return Ok(());
    };
    // The flag's parser lets `r`, `w`, `rw` and `none` through.
    let permissions = PermissionsConf {
        read: given.starts_with('r'),
        write: given.ends_with('w'),
    };
    set(
        config.adminspace.set_permissions(permissions),
        "adminspace/permissions",
        given,
    )
}

/// A setter of Zenoh's configuration hands back what it refuses.
fn set<T>(result: Result<T, T>, key: &'static str, value: &str) -> Result<(), ConfigError> {
    match result {
        Ok(_before) => Ok(()),
        Err(_refused) => Err(ConfigError::Refused {
            key,
            value: value.to_owned(),
        }),
    }
}

/// The file of those who may log in, if there is one.
struct Logins {
    path: PathBuf,
    text: String,
}

fn logins(config: &Config) -> Result<Option<Logins>, ConfigError> {
    let Some(path) = config
        .transport
        .auth
        .usrpwd
        .dictionary_file()
        .as_ref()
        .map(PathBuf::from)
    else {
        return Ok(None);
    };
    let text = fs::read_to_string(&path).map_err(|source| ConfigError::LoginFile {
        path: path.clone(),
        source,
    })?;
    // Zenoh takes an empty file for no login at all, and would let everyone in.
    if text.trim().is_empty() {
        return Err(ConfigError::NoLogins { path });
    }
    Ok(Some(Logins { path, text }))
}

fn log_in_as(config: &mut Config, user: &str, logins: Option<Logins>) -> Result<(), ConfigError> {
    let Logins { path, text } = logins.ok_or_else(|| ConfigError::NoLoginFile {
        user: user.to_owned(),
    })?;
    let password = text
        .lines()
        .filter_map(|line| line.split_once(':'))
        .find(|(name, _)| name.trim() == user)
        .map(|(_, password)| password.trim())
        .ok_or_else(|| ConfigError::NoSuchLogin {
            user: user.to_owned(),
            path: path.clone(),
        })?;
    let login = serde_json::json!({ "user": user, "password": password, "dictionary_file": path });
    config
        .insert_json5("transport/auth/usrpwd", &login.to_string())
        .map_err(|_| ConfigError::Refused {
            key: "transport/auth/usrpwd",
            value: user.to_owned(),
        })
}

/// Zenoh would try a malformed `ble/` endpoint again and again; better to hear of it at once.
fn check_ble_endpoints(config: &Config) -> Result<(), ConfigError> {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    let is_ble = |endpoint: &EndPoint| endpoint.protocol().as_str() == BLE_LOCATOR_PREFIX;
    let wrong = |endpoint: &EndPoint, source| ConfigError::Ble {
        endpoint: endpoint.to_string(),
        source,
    };

    for group in config.connect.endpoints.get(mode).into_iter().flatten() {
        for endpoint in group.as_vec().into_iter().filter(is_ble) {
            ConnectLocator::parse(&endpoint).map_err(|source| wrong(&endpoint, source))?;
        }
    }
    for endpoint in config
        .listen
        .endpoints
        .get(mode)
        .into_iter()
        .flatten()
        .filter(|e| is_ble(e))
    {
        ListenLocator::parse(endpoint).map_err(|source| wrong(endpoint, source))?;
    }
    Ok(())
}

/// What is wrong with the flags or the configuration file.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// Not there, not readable, or not a configuration: the cause says which.
    #[error("configuration file {}", path.display())]
    File { path: PathBuf, source: zenoh::Error },
    /// `--cfg ':{...}'` is not a whole configuration.
    #[error("--cfg with an empty key gives the whole configuration, and this is none")]
    Whole { source: zenoh::Error },
    /// Write it as KEY:VALUE.
    #[error("--cfg {given}: not a KEY:VALUE pair; write for example --cfg 'scouting/multicast/enabled:false'")]
    SettingWithoutColon { given: String },
    /// Unknown key, or a value of the wrong kind.
    #[error("--cfg {given}: {reason}")]
    Setting { given: String, reason: String },
    /// Not an identifier.
    #[error("--id {given}: give 1 to 32 lowercase hexadecimal digits, the first not 0")]
    Id { given: String, source: zenoh::Error },
    /// Not an endpoint.
    #[error("{flag} {given}: not an endpoint; write PROTOCOL/ADDRESS, for example tcp/127.0.0.1:7447 or ble/wombat-2")]
    Endpoint {
        flag: &'static str,
        given: String,
        source: zenoh::Error,
    },
    /// A `ble/` endpoint, from a flag or the file, that can never work.
    #[error("{endpoint}")]
    Ble {
        endpoint: String,
        source: LocatorError,
    },
    /// A plugin's name or path that can't be part of a configuration.
    #[error("plugin setting {setting} can't be made")]
    Plugin {
        setting: String,
        source: zenoh::Error,
    },
    /// A value that does not fit the rest of the configuration.
    #[error("{key} can't be set to {value}")]
    Refused { key: &'static str, value: String },
    /// `--login-as` needs the file of users.
    #[error("--login-as {user}: the configuration names no transport/auth/usrpwd/dictionary_file to take the password from")]
    NoLoginFile { user: String },
    /// Make one: one line `user:password`, readable by the router only.
    #[error("login file {} (make one with a line `user:password` in it, see config/README.md)", path.display())]
    LoginFile { path: PathBuf, source: io::Error },
    /// Write a line into it, or take `dictionary_file` out of the configuration to do without logins.
    #[error("login file {} is empty; write a line `user:password` into it, see config/README.md", path.display())]
    NoLogins { path: PathBuf },
    /// Add the line, or log in as another.
    #[error("--login-as {user}: no line `{user}:password` in {}", path.display())]
    NoSuchLogin { user: String, path: PathBuf },
}
