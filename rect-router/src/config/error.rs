//! What can be wrong with flags and configuration files, in words for the user.

use std::{io, path::PathBuf};

use zenoh_link::ble::locator::LocatorError;

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
    /// RECT's own settings.
    #[error("plugins/rect: {reason} (config/README.md)")]
    Settings { reason: String },
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
