//! Reads and checks the login file: which users may connect, and as which user this router logs in when it dials.

use std::{
    fmt, fs, io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use rect_core::session::login;
use rect_core::storage::regular_file;
use zenoh::Config;

use super::ConfigError;

/// Maximum size of a login file in bytes; enough for about ten thousand users.
const MAX_BYTES: u64 = 1 << 20;
/// Permission bits of users who neither own the file nor belong to its group.
const OTHERS_READ: u32 = 0o004;
const OTHERS_WRITE: u32 = 0o002;

/// The login file with its text.
pub(super) struct Logins {
    path: PathBuf,
    text: String,
}

/// Reads the login file that the configuration names; `None` if it names none.
///
/// # Errors
/// Fails if the file cannot be read or is empty.
pub(super) fn logins(config: &Config) -> Result<Option<Logins>, ConfigError> {
    let Some(path) = login_file(config) else {
        return Ok(None);
    };
    let text = read_login_file(&path).map_err(|source| ConfigError::LoginFile {
        path: path.clone(),
        source,
    })?;
    // Zenoh treats an empty file like a missing login and would accept everyone.
    if text.trim().is_empty() {
        return Err(ConfigError::NoLogins { path });
    }
    Ok(Some(Logins { path, text }))
}

/// Reads a login file.
///
/// # Errors
/// Fails if the path is not a regular file, if the file cannot be read, or if it is larger than 1 MiB.
pub fn read_login_file(path: &Path) -> io::Result<String> {
    regular_file::read_to_string(path, MAX_BYTES)
}

fn login_file(config: &Config) -> Option<PathBuf> {
    let path = config.transport.auth.usrpwd.dictionary_file().as_ref()?;
    Some(PathBuf::from(path))
}

/// A login file that every user of this computer can read or write, not only its owner and its group.
#[derive(Debug, PartialEq, Eq)]
pub struct ExposedLogins {
    path: PathBuf,
    may: &'static str,
}

impl ExposedLogins {
    /// Examines the permissions of a login file. Returns `None` if it is private or cannot be examined.
    pub fn find(path: &Path) -> Option<Self> {
        let mode = fs::metadata(path).ok()?.permissions().mode();
        let may = match (mode & OTHERS_READ != 0, mode & OTHERS_WRITE != 0) {
            (false, false) => return None,
            (true, false) => "read",
            (false, true) => "write",
            (true, true) => "read and write",
        };
        Some(Self {
            path: path.to_owned(),
            may,
        })
    }

    /// Returns the command that makes the file private.
    pub fn remedy(&self) -> String {
        format!("chmod o-rw {}", self.path.display())
    }
}

impl fmt::Display for ExposedLogins {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "every user of this computer can {} the login file {path}",
            self.may,
            path = self.path.display()
        )
    }
}

/// Returns the configuration's login file if every user can read or write it.
pub fn exposed_login_file(config: &Config) -> Option<ExposedLogins> {
    ExposedLogins::find(&login_file(config)?)
}

/// Makes this router log in as `user` when it dials, with the password from the login file.
///
/// # Errors
/// Fails if there is no login file, or if it has no line for `user`.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_a_login_file_that_every_user_can_read_or_write() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("users");
        fs::write(&path, "fleet:secret\n").expect("written");
        for (mode, found) in [
            (0o600, None),
            (0o660, None),
            (0o644, Some("can read the")),
            (0o642, Some("can write the")),
            (0o666, Some("can read and write the")),
        ] {
            fs::set_permissions(&path, fs::Permissions::from_mode(mode)).expect("set");
            let exposed = ExposedLogins::find(&path).map(|exposed| exposed.to_string());
            match (found, exposed) {
                (None, None) => {}
                (Some(found), Some(exposed)) => assert!(exposed.contains(found), "{exposed}"),
                (_, exposed) => panic!("{mode:o}: {exposed:?}"),
            }
        }
        assert_eq!(ExposedLogins::find(&folder.path().join("nowhere")), None);
    }
}
