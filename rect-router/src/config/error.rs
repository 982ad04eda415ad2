//! Defines the errors of flags and configuration files, with messages for the user.

use std::{io, path::PathBuf};

use zenoh_link_any::locator::LocatorError as AnyLocatorError;
use zenoh_link_ble::locator::LocatorError;

/// An error in the flags or the configuration file.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file is missing, unreadable or not a configuration; the source says which.
    #[error("configuration file {}", path.display())]
    File { path: PathBuf, source: zenoh::Error },
    /// The file has a mistake; the reason begins with its line.
    #[error("configuration file {}, {reason}", path.display())]
    Syntax { path: PathBuf, reason: String },
    /// The value of `--cfg ':{...}'` is not a whole configuration.
    #[error("--cfg with an empty key must give a whole configuration, and this value is not one")]
    Whole { source: zenoh::Error },
    /// The value of `--cfg` has no colon; write it as KEY:VALUE.
    #[error("--cfg {given}: not a KEY:VALUE pair; write for example --cfg 'scouting/multicast/enabled:false'")]
    SettingWithoutColon { given: String },
    /// The key of a `--cfg` is unknown, or the value has the wrong type.
    #[error("--cfg {given}: {reason}")]
    Setting { given: String, reason: String },
    /// The value of `--id` is not an identifier.
    #[error("--id {given}: give 1 to 32 lowercase hexadecimal digits, the first not 0")]
    Id { given: String, source: zenoh::Error },
    /// The value of `--listen` or `--connect`, or a configured endpoint, cannot be parsed.
    #[error("{flag} {given}: not an endpoint; write PROTOCOL/ADDRESS, for example tcp/127.0.0.1:7447 or ble/wombat-2")]
    Endpoint {
        flag: &'static str,
        given: String,
        source: zenoh::Error,
    },
    /// An `any/` endpoint is invalid.
    #[error("{endpoint}")]
    Any {
        endpoint: String,
        source: AnyLocatorError,
    },
    /// A `ble/` endpoint of a flag or the file is invalid.
    #[error("{endpoint}")]
    Ble {
        endpoint: String,
        source: LocatorError,
    },
    /// A plugin's name or path cannot be part of a configuration.
    #[error(
        "cannot set {setting}: the name or path of the plugin is not valid in a configuration"
    )]
    Plugin {
        setting: String,
        source: zenoh::Error,
    },
    /// RECT's own settings are invalid.
    #[error("plugins/rect: {reason} (docs/reference/configuration.md)")]
    Settings { reason: String },
    /// Zenoh rejected a value because it contradicts the rest of the configuration.
    #[error("cannot set {key} to {value}: it contradicts the rest of the configuration")]
    Refused { key: &'static str, value: String },
    /// `--login-as` was given without a login file.
    #[error("--login-as {user}: the configuration names no transport/auth/usrpwd/dictionary_file to take the password from")]
    NoLoginFile { user: String },
    /// The login file cannot be read. Create one with a line `user:password` that only the router can read.
    #[error("cannot read the login file {} (create one with a line `user:password`, see docs/reference/configuration.md)", path.display())]
    LoginFile { path: PathBuf, source: io::Error },
    /// The login file is empty. Add a line, or remove `dictionary_file` from the configuration to run without logins.
    #[error("login file {} is empty; write a line `user:password` into it, see docs/reference/configuration.md", path.display())]
    NoLogins { path: PathBuf },
    /// The login file has no line for this user. Add the line, or log in as another user.
    #[error("--login-as {user}: no line `{user}:password` in {}", path.display())]
    NoSuchLogin { user: String, path: PathBuf },
}
