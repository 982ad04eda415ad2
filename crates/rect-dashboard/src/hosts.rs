//! Knows the names by which browsers may address a server on this computer. A page of another site can make its own name point to this
//! computer, and would then be allowed to read the answers.
use std::net::{IpAddr, SocketAddr};

/// The names of this computer.
#[derive(Clone, Debug)]
pub struct Hosts {
    /// Lower case, without a port.
    names: Vec<String>,
}

impl Hosts {
    /// Returns the names of this computer, and `more`.
    pub fn new(more: &[String]) -> Self {
        let mut names = vec!["localhost".to_owned()];
        let own = rustix::system::uname();
        if let Ok(own) = own.nodename().to_str() {
            names.extend([own.to_lowercase(), format!("{}.local", own.to_lowercase())]);
        }
        names.extend(more.iter().map(|name| name.to_lowercase()));
        Self { names }
    }

    /// Returns whether the value of a `Host` header is one of them, or an address: no site can have an address as its name.
    pub fn accepts(&self, host: &str) -> bool {
        let name = name_of(host).to_lowercase();
        name.parse::<IpAddr>().is_ok() || self.names.contains(&name)
    }
}

/// Returns the name or address in `host:port`.
pub fn name_of(host: &str) -> &str {
    if let Ok(address) = host.parse::<SocketAddr>() {
        // An IPv6 address has brackets.
        let end = host.len() - address.port().to_string().len() - 1;
        return host[..end].trim_matches(['[', ']']);
    }
    let host = host
        .strip_prefix('[')
        .and_then(|host| host.strip_suffix(']'))
        .unwrap_or(host);
    match host.rsplit_once(':') {
        Some((name, port)) if !name.contains(':') && port.parse::<u16>().is_ok() => name,
        _ => host,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_own_names_and_addresses_are_accepted() {
        let hosts = Hosts::new(&["robots.example.org".to_owned()]);
        for host in [
            "localhost:8080",
            "127.0.0.1:8080",
            "[::1]:8080",
            "[::1]",
            "10.0.0.2",
            "Robots.Example.org",
        ] {
            assert!(hosts.accepts(host), "{host}");
        }
        for host in [
            "evil.example",
            "evil.example:8080",
            "localhost.evil.example",
            "127.0.0.1.evil.example",
            "",
        ] {
            assert!(!hosts.accepts(host), "{host}");
        }
    }
}
