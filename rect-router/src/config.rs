//! Builds a Zenoh configuration from the flags, in zenohd's order: first the file or the `--cfg` that gives the whole
//! configuration, then each flag, then each `--cfg KEY:VALUE`. Where zenohd panics or only warns, this module returns an
//! error.

mod error;
mod listener_check;
mod login;
mod settings;
mod slow_link_advice;
mod syntax;

use std::{fs, path::Path};

use rect_core::text::humanize;
use serde_json::Value;
use validated_struct::InsertionError;
use zenoh::{config::WhatAmI, Config};
use zenoh_config::{EndPoint, EndPoints, ModeDependent, ModeDependentValue, PermissionsConf};
use zenoh_link_any::locator::{self as any, is_any};
use zenoh_link_ble::locator::{ConnectLocator, ListenLocator};
use zenoh_link_placeholder::PLACEHOLDER_LOCATOR_PREFIX;
use zenoh_util::LibSearchDirs;

pub(crate) use self::error::ConfigError;
pub use self::listener_check::{listener_problems, missing_adapters, MAX_SOCKET_PATH};
pub use self::login::{exposed_login_file, read_login_file, ExposedLogins};
use self::login::{log_in_as, logins};
pub use self::settings::{SessionSettings, Settings};
use crate::args::Args;

/// Builds the configuration that the flags describe, and separates RECT's own settings from it.
///
/// # Errors
/// A [`ConfigError`] that names the flag, key or file.
pub fn from_args(args: &Args) -> Result<(Config, Option<Settings>), ConfigError> {
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
    let settings = settings::take(&mut config)?;
    if let Some(settings) = &settings {
        listen(&mut config, &settings.listen)?;
    }
    let of_settings = settings
        .as_ref()
        .and_then(|settings| settings.login_as.as_deref());
    log_in(&mut config, args.login_as.as_deref().or(of_settings))?;
    check_ble_endpoints(&config)?;
    tracing::debug!("Config: {}", without_secrets(&config));
    Ok((config, settings))
}

/// Adds endpoints that the router dials.
///
/// # Errors
/// [`ConfigError::Endpoint`] if one cannot be parsed.
pub fn dial(
    config: &mut Config,
    endpoints: impl IntoIterator<Item = impl AsRef<str>>,
) -> Result<(), ConfigError> {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    change(
        &mut config.connect.endpoints,
        mode,
        "connect/endpoints",
        |all| {
            for given in endpoints {
                all.push(endpoint("connect", given.as_ref())?);
            }
            Ok(())
        },
    )?;
    // If the user restricts the protocols, placeholders must be among them.
    let mut protocols = config.transport.link.protocols().clone();
    if let Some(protocols) = protocols.as_mut() {
        protocols.push(PLACEHOLDER_LOCATOR_PREFIX.to_owned());
    }
    set(
        config.transport.link.set_protocols(protocols),
        "transport/link/protocols",
        "as given",
    )
}

/// Adds endpoints that the router listens on.
///
/// # Errors
/// [`ConfigError::Endpoint`] if one cannot be parsed.
pub fn listen(
    config: &mut Config,
    endpoints: impl IntoIterator<Item = impl AsRef<str>>,
) -> Result<(), ConfigError> {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    change(&mut config.listen.endpoints, mode, LISTEN, |all| {
        for given in endpoints {
            all.push(endpoint("listen", given.as_ref())?);
        }
        Ok(())
    })
}

/// Returns the endpoints that the router listens on.
pub fn listens_on(config: &Config) -> Vec<EndPoint> {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    config
        .listen
        .endpoints
        .get(mode)
        .cloned()
        .unwrap_or_default()
}

/// Returns whether the configuration has a Bluetooth endpoint to listen on or to dial.
pub fn uses_bluetooth(config: &Config) -> bool {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    let connect = config.connect.endpoints.get(mode).into_iter().flatten();
    let mut connect = connect.flat_map(EndPoints::as_vec);
    connect.any(|one| has_radio(&one)) || listens_on(config).iter().any(has_radio)
}

/// Returns the names of the adapters of the Bluetooth listeners.
pub fn adapters(config: &Config) -> Vec<String> {
    let listeners = listens_on(config).into_iter().filter(has_radio);
    listeners
        .map(|one| one.address().as_str().to_owned())
        .collect()
}

/// Returns whether the links of an endpoint use Bluetooth.
fn has_radio(endpoint: &EndPoint) -> bool {
    any::has_radio(endpoint.protocol().as_str())
}

/// Makes the Bluetooth listeners advertise the fleet, unless their locators name one.
///
/// # Errors
/// [`ConfigError::Refused`] if the fleet's name cannot be part of a locator.
pub fn announce(config: &mut Config, fleet: &str) -> Result<(), ConfigError> {
    const KEY: &str = "fleet";
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    change(&mut config.listen.endpoints, mode, LISTEN, |all| {
        for endpoint in all.iter_mut().filter(|endpoint| has_radio(endpoint)) {
            if endpoint.config().get(KEY).is_none() {
                let refused = |_| ConfigError::Refused {
                    key: LISTEN,
                    value: fleet.to_owned(),
                };
                endpoint.config_mut().insert(KEY, fleet).map_err(refused)?;
            }
        }
        Ok(())
    })
}

const LISTEN: &str = "listen/endpoints";

/// Changes the list of endpoints of `mode`.
fn change<T: Clone>(
    endpoints: &mut ModeDependentValue<Vec<T>>,
    mode: WhatAmI,
    key: &'static str,
    change: impl FnOnce(&mut Vec<T>) -> Result<(), ConfigError>,
) -> Result<(), ConfigError> {
    let mut all = endpoints.get(mode).cloned().unwrap_or_default();
    change(&mut all)?;
    set(endpoints.set(all), key, "as given")
}

/// Checks the login file, if there is one, and configures the login of `user` for all links that this router dials.
///
/// # Errors
/// Fails if the login file cannot be read, is empty, or has no line for `user`.
pub fn log_in(config: &mut Config, user: Option<&str>) -> Result<(), ConfigError> {
    let logins = logins(config)?;
    if let Some(exposed) = exposed_login_file(config) {
        tracing::warn!("{exposed}; run: {}", exposed.remedy());
    }
    match user {
        Some(user) => log_in_as(config, user, logins),
        None => Ok(()),
    }
}

/// Returns the configuration as text for the log, with passwords and private keys masked.
pub fn without_secrets(config: &Config) -> String {
    match serde_json::to_value(config) {
        Ok(mut value) => {
            mask_secrets(&mut value);
            value.to_string()
        }
        Err(error) => format!("(cannot be shown: {error})"),
    }
}

fn mask_secrets(value: &mut Value) {
    match value {
        Value::Object(fields) => {
            for (key, value) in fields {
                if value.is_string() && (key == "password" || key.contains("private_key")) {
                    *value = "***".into();
                } else {
                    mask_secrets(value);
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(mask_secrets),
        _ => {}
    }
}

/// One `--cfg KEY:VALUE`.
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
                tracing::warn!(
                    "--cfg gives the whole configuration, so the file {file} is ignored"
                );
            }
            Config::from_json5(whole.value).map_err(|source| ConfigError::Whole { source })?
        }
        (None, Some(path)) => read(Path::new(path))?,
        (None, None) => Config::default(),
    };
    if config.mode().is_none() {
        set(config.set_mode(Some(WhatAmI::Router)), "mode", "router")?;
    }
    Ok(config)
}

/// Reads a configuration file.
///
/// # Errors
/// [`ConfigError::Syntax`] or [`ConfigError::File`].
fn read(path: &Path) -> Result<Config, ConfigError> {
    let syntax = |reason| ConfigError::Syntax {
        path: path.to_owned(),
        reason,
    };
    let is_json =
        (path.extension()).is_some_and(|extension| extension == "json5" || extension == "json");
    // Zenoh reads the file itself, and reports one that cannot be read.
    let text = Some(path).filter(|path| is_json && path.is_file());
    let text = text.and_then(|path| fs::read_to_string(path).ok());
    let text = text.filter(|text| !text.trim().is_empty());
    if let Some(reason) = text.as_deref().and_then(syntax::problem) {
        return Err(syntax(reason));
    }
    Config::from_file(path).map_err(|source| {
        match syntax::value_problem(&humanize::on_one_line(&source.to_string())) {
            Some(reason) => syntax(reason),
            None => ConfigError::File {
                path: path.to_owned(),
                source,
            },
        }
    })
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
    // The parser of the flag accepts only `r`, `w`, `rw` and `none`.
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

/// Converts the result of a setter of Zenoh's configuration, which returns a value that it rejects.
fn set<T>(result: Result<T, T>, key: &'static str, value: &str) -> Result<(), ConfigError> {
    match result {
        Ok(_before) => Ok(()),
        Err(_refused) => Err(ConfigError::Refused {
            key,
            value: value.to_owned(),
        }),
    }
}

/// Checks all `any/` and `ble/` endpoints. Without this check, Zenoh would retry an invalid endpoint forever.
///
/// # Errors
/// [`ConfigError::Any`] or [`ConfigError::Ble`] for the first invalid endpoint.
pub fn check_ble_endpoints(config: &Config) -> Result<(), ConfigError> {
    let mode = config.mode().unwrap_or(WhatAmI::Router);
    let wrong = |endpoint: &EndPoint, source| ConfigError::Ble {
        endpoint: endpoint.to_string(),
        source,
    };
    let wrong_any = |endpoint: &EndPoint, source| ConfigError::Any {
        endpoint: endpoint.to_string(),
        source,
    };
    let connect = config.connect.endpoints.get(mode).into_iter().flatten();
    let mut has_ble = false;
    for endpoint in connect.flat_map(EndPoints::as_vec).filter(has_radio) {
        let radio = match is_any(&endpoint) {
            true => any::ConnectLocator::parse(&endpoint).and_then(|any| any.bluetooth()),
            false => Ok(endpoint.clone()),
        };
        let radio = radio.map_err(|source| wrong_any(&endpoint, source))?;
        ConnectLocator::parse(&radio).map_err(|source| wrong(&endpoint, source))?;
        has_ble = true;
    }
    let listen = config.listen.endpoints.get(mode).into_iter().flatten();
    for endpoint in listen.filter(|endpoint| has_radio(endpoint)) {
        let radio = match is_any(endpoint) {
            true => any::ListenLocator::parse(endpoint).map(|any| any.ble),
            false => Ok(endpoint.clone()),
        };
        let radio = radio.map_err(|source| wrong_any(endpoint, source))?;
        ListenLocator::parse(&radio).map_err(|source| wrong(endpoint, source))?;
        has_ble = true;
    }
    if has_ble {
        for advice in slow_link_advice::advice(config) {
            tracing::warn!(
                "unsuitable for a Bluetooth link: {advice} (docs/reference/configuration.md)"
            );
        }
    }
    Ok(())
}
