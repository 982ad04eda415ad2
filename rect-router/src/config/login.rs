//! The login file: who may connect, and what this router says of itself when it dials.

use std::{fs, path::PathBuf};

use rect::core::login;
use zenoh::Config;

use super::ConfigError;

/// The file of those who may log in, if there is one.
pub(super) struct Logins {
    path: PathBuf,
    text: String,
}

pub(super) fn logins(config: &Config) -> Result<Option<Logins>, ConfigError> {
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

pub(super) fn log_in_as(
    config: &mut Config,
    user: &str,
    logins: Option<Logins>,
) -> Result<(), ConfigError> {
    let Logins { path, text } = logins.ok_or_else(|| ConfigError::NoLoginFile {
        user: user.to_owned(),
    })?;
    let (_, password) = login::logins(&text)
        .find(|(name, _)| *name == user)
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
