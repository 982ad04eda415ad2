//! Checks the files that options of connections name, such as certificates. Another robot may have written these options, so they
//! must neither block the router nor reveal which files exist.
use std::{
    fs,
    path::{Component, Path, PathBuf},
};

use rect_core::{storage::regular_file, text::humanize};
use zenoh_config::EndPoint;
use zenoh_link_ble::secret_file;

/// The folder of the configuration that `rect-router init` writes.
const CONFIGURATION: &str = "/etc/rect";
/// The option of `any` and `ble` that names a file.
const SECRET: &str = "secret";
/// The end of the names of all options of Zenoh's links that name a file, such as `root_ca_certificate_file`.
const FILE_SUFFIX: &str = "_file";
/// Maximum size of a certificate or key in bytes. The certificates of all public authorities take a fifth of it.
const MAX_BYTES: u64 = 1 << 20;
/// The beginning of each part of a certificate or key in PEM.
const PEM: &str = "-----BEGIN ";
/// Methods whose address is the path of a file.
const WITH_PATH: [&str; 3] = ["unixsock-stream", "unixpipe", "serial"];

/// The reason why no link was opened, if it depends on the files of this computer.
#[derive(Debug, thiserror::Error)]
#[error("{what}; the log of this robot's router has the reason")]
pub struct LocalError {
    /// The same text whether or not the file exists.
    what: String,
    cause: String,
}

impl LocalError {
    /// Returns the error with its reason. It is for the log alone.
    pub fn with_reason(&self) -> String {
        format!("{}: {}", self.what, self.cause)
    }
}

/// Returns the folders in which options may name files: `/etc/rect`, the folder of the connections file, and those of the settings.
pub fn folders(connections: &Path, more: &[PathBuf]) -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from(CONFIGURATION)];
    let file = std::path::absolute(connections).unwrap_or_default();
    if let Some(folder) = file.parent() {
        folders.push(folder.to_owned());
        // The folder without symbolic links and `..`.
        folders.extend(fs::canonicalize(folder).ok());
    }
    folders.extend_from_slice(more);
    folders.sort();
    folders.dedup();
    folders
}

/// Checks an option without access to the file that it may name.
///
/// # Errors
/// Fails if the file is in none of the folders.
pub fn check_path(option: &str, value: &str, folders: &[PathBuf]) -> Result<(), String> {
    if !names_file(option) {
        return Ok(());
    }
    let path = Path::new(value);
    let mut parts = path.components();
    let is_plain = parts.all(|part| matches!(part, Component::RootDir | Component::Normal(_)));
    if is_plain && folders.iter().any(|folder| path.starts_with(folder)) {
        return Ok(());
    }
    let folders: Vec<_> = folders
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    Err(format!(
        "option {option}: the file must be given by its absolute path, and be in {} or a folder of plugins/rect/option_folders",
        folders.join(", ")
    ))
}

/// Checks that the files of an endpoint's options can be used.
///
/// # Errors
/// Fails if one of them is missing, is not a regular file, is too large, or contains something else.
pub fn check(endpoint: &EndPoint) -> Result<(), LocalError> {
    let config = endpoint.config();
    for (option, path) in config.iter().filter(|(option, _)| names_file(option)) {
        let path = Path::new(path);
        let checked = match option {
            SECRET => secret_file::read(path)
                .map(drop)
                .map_err(|error| humanize::with_causes(&error)),
            _ => check_pem(path),
        };
        checked.map_err(|cause| LocalError {
            what: format!("the file of the option {option} cannot be used"),
            cause: format!("{}: {cause}", path.display()),
        })?;
    }
    Ok(())
}

/// Returns the error of a dial for everybody. If the address is a path, it does not contain the reason.
pub fn public_error(endpoint: &EndPoint, error: zenoh_result::Error) -> zenoh_result::Error {
    if !WITH_PATH.contains(&endpoint.protocol().as_str()) {
        return error;
    }
    LocalError {
        what: format!("cannot connect to {}", endpoint.address()),
        cause: error.to_string(),
    }
    .into()
}

/// Returns the reason of a failure after the dial for everybody. If the address is a path, it is that of a failed dial, which does not show
/// whether something accepts connections there.
pub fn public_reason(endpoint: &EndPoint, reason: &str) -> String {
    match WITH_PATH.contains(&endpoint.protocol().as_str()) {
        true => public_error(endpoint, reason.to_owned().into()).to_string(),
        false => reason.to_owned(),
    }
}

fn names_file(option: &str) -> bool {
    option == SECRET || option.ends_with(FILE_SUFFIX)
}

fn check_pem(path: &Path) -> Result<(), String> {
    let text = regular_file::read_to_string(path, MAX_BYTES).map_err(|error| error.to_string())?;
    match text.contains(PEM) {
        true => Ok(()),
        false => Err("it contains neither a certificate nor a key in PEM".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use nix::{sys::stat::Mode, unistd::mkfifo};

    use super::*;

    #[test]
    fn options_name_files_in_the_permitted_folders_only() {
        let folders = folders(
            Path::new("/srv/robot/connections.json"),
            &["/srv/tls".into()],
        );
        let is_accepted = |option, path| check_path(option, path, &folders).is_ok();
        for path in ["/etc/rect/users", "/srv/robot/team.pem", "/srv/tls/a/b.pem"] {
            assert!(is_accepted("secret", path), "{path}");
            assert!(is_accepted("connect_private_key_file", path), "{path}");
        }
        for path in [
            "/dev/zero",
            "/etc/rectangle",
            "/etc/shadow",
            "/etc/rect/../shadow",
            "/srv/tls/../../dev/zero",
            "team.pem",
            "./team.pem",
            "",
        ] {
            for option in ["secret", "root_ca_certificate_file", "new_file"] {
                let error = check_path(option, path, &folders).expect_err(path);
                assert!(error.contains(option), "{error}");
            }
        }
        assert!(is_accepted("mtu", "500"));
    }

    #[test]
    fn each_file_that_cannot_be_used_has_the_same_error() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = |name: &str| folder.path().join(name);
        mkfifo(&path("pipe"), Mode::S_IRWXU).expect("a pipe");
        std::os::unix::fs::symlink("/dev/zero", path("zero")).expect("a link");
        fs::write(path("other"), "something else").expect("written");
        fs::write(path("large"), vec![b'x'; 2 << 20]).expect("written");
        fs::write(path("team.pem"), "-----BEGIN CERTIFICATE-----").expect("written");
        fs::write(path("users"), "fleet:0123456789abcdef").expect("written");
        let checked = |option: &str, name: &str| {
            let endpoint = format!("tls/10.0.0.1:7447#{option}={}", path(name).display());
            check(&endpoint.parse().expect("an endpoint"))
        };
        for option in ["secret", "root_ca_certificate_file"] {
            let expected = format!(
                "the file of the option {option} cannot be used; the log of this robot's router has the reason"
            );
            for name in ["missing", "pipe", "zero", "other", "large", "."] {
                let error = checked(option, name).expect_err(name);
                assert_eq!(error.to_string(), expected, "{name}");
                assert!(error.cause.contains(name), "{}", error.cause);
            }
        }
        assert!(checked("root_ca_certificate_file", "team.pem").is_ok());
        assert!(checked("secret", "users").is_ok());
    }

    #[test]
    fn errors_of_addresses_that_are_paths_do_not_show_whether_a_file_exists() {
        let shown = |endpoint: &str, reason: &str| {
            let endpoint = endpoint.parse().expect("an endpoint");
            public_error(&endpoint, reason.into()).to_string()
        };
        let socket = "unixsock-stream//run/other.sock";
        assert_eq!(shown(socket, "no such file"), shown(socket, "refused"));
        // Something listens, and does not answer.
        let later = public_reason(&socket.parse().expect("an endpoint"), "no answer");
        assert_eq!(later, shown(socket, "refused"));
        assert_eq!(shown("tcp/10.0.0.1:7447", "refused"), "refused");
    }
}
