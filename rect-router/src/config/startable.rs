//! Owns what `rect-router check` finds beyond a configuration's own text: listeners for which this computer lacks something.
//! Nothing is started, so a port that another program uses at the moment is not found, and neither is this router, running.
use std::{
    fmt,
    net::{IpAddr, TcpListener, ToSocketAddrs},
    path::Path,
};

use nix::unistd::{access, AccessFlags};
use zenoh::Config;
use zenoh_config::EndPoint;

use super::listens_on;

/// The longest path of a socket file, in bytes: what the system takes, without the `.lock` file beside it.
pub const MAX_SOCKET_PATH: usize = 107;

/// A listener that would not start.
#[derive(Debug, PartialEq, Eq)]
pub struct Unstartable {
    listener: String,
    reason: String,
}

impl fmt::Display for Unstartable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.listener, self.reason)
    }
}

/// Returns the listeners that would not start here. `is_made`: whether somebody makes that folder before the router starts.
pub fn unstartable(config: &Config, is_made: impl Fn(&Path) -> bool) -> Vec<Unstartable> {
    let mut found = Vec::new();
    for endpoint in listens_on(config) {
        let reason = match endpoint.protocol().as_str() {
            "unixsock-stream" => socket_file(endpoint.address().as_str(), &is_made),
            "tcp" | "tls" | "ws" | "quic" | "udp" => address(&endpoint),
            _ => None,
        };
        found.extend(reason.map(|reason| Unstartable {
            listener: endpoint.to_string(),
            reason,
        }));
    }
    found
}

fn socket_file(path: &str, is_made: impl Fn(&Path) -> bool) -> Option<String> {
    if path.len() > MAX_SOCKET_PATH {
        return Some(format!(
            "the path has {} bytes, and a socket file's may have {MAX_SOCKET_PATH}; use a folder with a shorter one",
            path.len()
        ));
    }
    let path = Path::new(path);
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    if is_made(folder) {
        return None;
    }
    if !folder.is_dir() {
        return Some(format!(
            "the folder {} does not exist; make it, or use a path in another folder",
            folder.display()
        ));
    }
    // Zenoh makes the socket and a lock beside it.
    let writable = access(folder, AccessFlags::W_OK | AccessFlags::X_OK);
    let refused = writable.err()?;
    Some(format!(
        "the folder {} cannot be written by this user ({}); give it to the user who runs the router",
        folder.display(),
        refused.desc()
    ))
}

/// Whether this computer has the address to listen on.
fn address(endpoint: &EndPoint) -> Option<String> {
    let address = endpoint.address();
    let resolved = match address.as_str().to_socket_addrs() {
        Ok(resolved) => resolved,
        Err(error) => return Some(format!("the address cannot be used: {error}")),
    };
    // Port 0 is any that is free.
    let is_here = |ip: IpAddr| TcpListener::bind((ip, 0)).is_ok();
    let none_is = !resolved.map(|address| address.ip()).any(is_here);
    none_is.then(|| "this computer does not have that address".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(endpoint: &str) -> Vec<String> {
        let text = format!("{{ mode: 'router', listen: {{ endpoints: ['{endpoint}'] }} }}");
        let config = Config::from_json5(&text).expect("valid");
        let found = unstartable(&config, |folder| folder == Path::new("/made/by/systemd"));
        found.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn a_socket_file_needs_a_folder_and_a_short_path() {
        let folder = tempfile::tempdir().expect("a folder");
        let there = format!("unixsock-stream/{}/socket", folder.path().display());
        assert_eq!(found(&there), Vec::<String>::new());
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
    fn an_address_must_be_one_of_this_computer() {
        assert_eq!(found("tcp/127.0.0.1:0"), Vec::<String>::new());
        // 192.0.2.0/24 is for documentation only (RFC 5737).
        let elsewhere = found("tcp/192.0.2.1:7447");
        assert!(
            elsewhere[0].contains("does not have that address"),
            "{elsewhere:?}"
        );
    }
}
