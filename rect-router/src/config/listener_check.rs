//! Finds listeners of a configuration that cannot start on this computer, for `rect-router check`.
//!
//! Nothing is started: a port that is in use at the moment, by another program or by this router, is not reported.
use std::{
    fmt,
    net::{IpAddr, TcpListener, ToSocketAddrs},
    path::Path,
};

use nix::unistd::{access, AccessFlags};
use rect_core::text::humanize;
use zenoh::Config;
use zenoh_config::EndPoint;
use zenoh_link_ble::{locator::is_simulated, secret_file};

use super::{has_radio, listens_on};

/// Maximum length of the path of a socket file in bytes, a limit of Linux. The `.lock` file beside it does not count.
pub const MAX_SOCKET_PATH: usize = 107;

/// A listener that cannot start, with the reason.
#[derive(Debug, PartialEq, Eq)]
pub struct ListenerProblem {
    listener: String,
    reason: String,
}

impl fmt::Display for ListenerProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.listener, self.reason)
    }
}

/// Returns the listeners of `config` that cannot start on this computer. `is_created_at_start` returns whether a folder
/// will be created before the router starts, as systemd does for a service.
pub fn listener_problems(
    config: &Config,
    is_created_at_start: impl Fn(&Path) -> bool,
) -> Vec<ListenerProblem> {
    let mut found = Vec::new();
    for endpoint in listens_on(config) {
        let reason = match endpoint.protocol().as_str() {
            "unixsock-stream" => socket_file(endpoint.address().as_str(), &is_created_at_start),
            "tcp" | "tls" | "ws" | "quic" | "udp" => address(&endpoint),
            _ if has_radio(&endpoint) => secret(&endpoint),
            _ => None,
        };
        found.extend(reason.map(|reason| ListenerProblem {
            listener: endpoint.to_string(),
            reason,
        }));
    }
    found
}

/// Returns what is missing on this computer for listeners with Bluetooth, without which the router starts nevertheless.
pub fn missing_adapters(config: &Config, root: &Path) -> Vec<ListenerProblem> {
    let adapters = zenoh_link_ble_bluez::adapters(root);
    let there_are = match adapters.as_slice() {
        [] => "this computer has none".to_owned(),
        adapters => format!("this computer has {}", adapters.join(", ")),
    };
    let mut found = Vec::new();
    for endpoint in listens_on(config).into_iter().filter(has_radio) {
        let adapter = endpoint.address().as_str();
        if !is_simulated(adapter) && !adapters.iter().any(|one| one == adapter) {
            found.push(ListenerProblem {
                listener: format!("{}/{adapter}", endpoint.protocol()),
                reason: format!("there is no Bluetooth adapter {adapter}; {there_are}"),
            });
        }
    }
    found
}

/// Returns why the file that `secret=` names cannot be used.
fn secret(endpoint: &EndPoint) -> Option<String> {
    let config = endpoint.config();
    let path = Path::new(config.get("secret")?);
    let error = secret_file::read(path).err()?;
    Some(humanize::with_causes(&error))
}

fn socket_file(path: &str, is_created_at_start: impl Fn(&Path) -> bool) -> Option<String> {
    if path.len() > MAX_SOCKET_PATH {
        return Some(format!(
            "the path has {} bytes, but the path of a socket file may have at most {MAX_SOCKET_PATH}; use a folder with a \
             shorter path",
            path.len()
        ));
    }
    let path = Path::new(path);
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if is_created_at_start(folder) {
        return None;
    }
    if !folder.is_dir() {
        return Some(format!(
            "the folder {} does not exist; create it, or use a path in another folder",
            folder.display()
        ));
    }
    // Zenoh creates the socket and a lock file beside it.
    let writable = access(folder, AccessFlags::W_OK | AccessFlags::X_OK);
    let refused = writable.err()?;
    Some(format!(
        "this user cannot write to the folder {} ({}); change its owner to the user that runs the router",
        folder.display(),
        refused.desc()
    ))
}

/// Returns a problem if this computer does not have the address to listen on.
fn address(endpoint: &EndPoint) -> Option<String> {
    let address = endpoint.address();
    let resolved = match address.as_str().to_socket_addrs() {
        Ok(resolved) => resolved,
        Err(error) => return Some(format!("the address cannot be used: {error}")),
    };
    // Port 0 means any free port.
    let is_here = |ip: IpAddr| TcpListener::bind((ip, 0)).is_ok();
    let is_elsewhere = !resolved.map(|address| address.ip()).any(is_here);
    is_elsewhere.then(|| "this computer does not have that address; use one of its own".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(endpoint: &str) -> Vec<String> {
        let text = format!("{{ mode: 'router', listen: {{ endpoints: ['{endpoint}'] }} }}");
        let config = Config::from_json5(&text).expect("valid");
        let found = listener_problems(&config, |folder| folder == Path::new("/made/by/systemd"));
        found.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn reports_a_socket_file_with_a_missing_folder_or_a_long_path() {
        let folder = tempfile::tempdir().expect("a folder");
        let existing = format!("unixsock-stream/{}/socket", folder.path().display());
        assert_eq!(found(&existing), Vec::<String>::new());
        let missing = found(&format!(
            "unixsock-stream/{}/no/socket",
            folder.path().display()
        ));
        assert!(missing[0].contains("does not exist"), "{missing:?}");
        assert!(found("unixsock-stream//made/by/systemd/socket").is_empty());
        let long = found(&format!("unixsock-stream//tmp/{}", "x".repeat(120)));
        assert!(long[0].contains("125 bytes"), "{long:?}");
    }

    #[test]
    fn reports_an_adapter_that_this_computer_does_not_have() {
        let root = tempfile::tempdir().expect("a folder");
        let found = |endpoint: &str| {
            let text = format!("{{ mode: 'router', listen: {{ endpoints: ['{endpoint}'] }} }}");
            let config = Config::from_json5(&text).expect("valid");
            let found = missing_adapters(&config, root.path());
            found.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let none = found("ble/hci0#name=wombat-1");
        assert_eq!(
            none,
            ["ble/hci0: there is no Bluetooth adapter hci0; this computer has none"]
        );
        std::fs::create_dir_all(root.path().join("sys/class/bluetooth/hci0")).expect("a folder");
        assert!(found("any/hci0#name=wombat-1;secret=/x").is_empty());
        assert!(found("ble/sim-1#name=wombat-1").is_empty() && found("tcp/127.0.0.1:0").is_empty());
        let other = found("any/hci7#name=wombat-1;secret=/x");
        assert_eq!(
            other,
            ["any/hci7: there is no Bluetooth adapter hci7; this computer has hci0"]
        );
    }

    #[test]
    fn reports_a_secret_that_is_easy_to_guess() {
        let folder = tempfile::tempdir().expect("a folder");
        let users = folder.path().join("users");
        let endpoint = format!("ble/sim-1#name=wombat-1;secret={}", users.display());
        assert!(found(&endpoint)[0].contains("cannot read"));
        std::fs::write(&users, "fleet:1234\n").expect("written");
        let short = found(&endpoint);
        assert!(
            short[0].contains("has 4 bytes after the user's name"),
            "{short:?}"
        );
        std::fs::write(&users, "fleet:0123456789abcdef\n").expect("written");
        assert_eq!(found(&endpoint), Vec::<String>::new());
    }

    #[test]
    fn reports_an_address_of_another_computer() {
        assert_eq!(found("tcp/127.0.0.1:0"), Vec::<String>::new());
        // 192.0.2.0/24 is for documentation only (RFC 5737).
        let elsewhere = found("tcp/192.0.2.1:7447");
        assert!(
            elsewhere[0].contains("does not have that address"),
            "{elsewhere:?}"
        );
    }
}
