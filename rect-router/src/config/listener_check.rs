//! Finds listeners of a configuration that cannot start on this computer, for `rect-router check`.
//!
//! Nothing is started: a port that is in use at the moment, by another program or by this router, is not reported.
use std::{
    fmt,
    net::{IpAddr, TcpListener, ToSocketAddrs},
    path::Path,
};

use nix::unistd::{access, AccessFlags};
use zenoh::Config;
use zenoh_config::EndPoint;

use super::listens_on;

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
            _ => None,
        };
        found.extend(reason.map(|reason| ListenerProblem {
            listener: endpoint.to_string(),
            reason,
        }));
    }
    found
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
