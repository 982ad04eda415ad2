//! Owns what a named connection is: a name, a method, whom it leads to. Whatever is wrong with one is said here.
use std::{collections::BTreeMap, fmt, net::IpAddr};

use zenoh_config::EndPoint;
use zenoh_link::{ble::locator::ConnectLocator, LinkKind};
use zenoh_link_slot::SLOT_LOCATOR_PREFIX;

/// The longest name, in bytes.
pub const MAX_NAME: usize = 64;
/// Methods whose address is a host, with a port.
const WITH_PORT: [&str; 5] = ["tcp", "udp", "tls", "quic", "ws"];
const BLE: &str = "ble";

/// One connection, as a file or the config service gives it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Written {
    /// What programs call it.
    pub name: String,
    /// `ble`, `tcp`, `udp`, or any other of Zenoh's protocols.
    pub method: String,
    /// A robot's name or Bluetooth address; a host; whatever the method takes.
    pub address: String,
    /// For methods with one.
    pub port: Option<u16>,
    /// For `ble`; left out, the advertised one.
    pub psm: Option<u16>,
    /// Of the method's locator, such as `mtu` for `ble`.
    pub options: BTreeMap<String, String>,
}

/// One that can be dialled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    /// What programs call it.
    pub name: String,
    /// The protocol.
    pub method: String,
    /// Whom, as Zenoh writes it.
    pub endpoint: EndPoint,
}

/// What is wrong with a connection, and with which of its fields.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wrong {
    /// Its key; `None`: the connection as a whole.
    pub field: Option<&'static str>,
    /// What, and what it should be.
    pub what: String,
}

impl Wrong {
    fn field(field: &'static str, what: impl Into<String>) -> Self {
        Self {
            field: Some(field),
            what: what.into(),
        }
    }
}

impl fmt::Display for Wrong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.what)
    }
}

impl Spec {
    /// Checks all that can be known before it is dialled.
    pub fn of(written: Written) -> Result<Self, Wrong> {
        check_name(&written.name)?;
        check_method(&written.method)?;
        let method = written.method.as_str();
        let has_port = WITH_PORT.contains(&method);
        if written.psm.is_some() && method != BLE {
            return Err(Wrong::field("psm", format!("{method} has no psm, ble has")));
        }
        if written.port.is_some() && !has_port {
            let advice = if method == BLE { ": ble has a psm" } else { "" };
            return Err(Wrong::field(
                "port",
                format!("{method} has no port{advice}"),
            ));
        }
        let address = match (has_port, written.port) {
            (true, None | Some(0)) => {
                return Err(Wrong::field(
                    "port",
                    format!("{method} needs a port, 1 to 65535"),
                ))
            }
            (true, Some(port)) => format!("{}:{port}", host(&written.address)?),
            (false, _) => plain_address(&written.address)?.to_owned(),
        };
        let mut options = written.options;
        if let Some(psm) = written.psm {
            if options.insert("psm".to_owned(), psm.to_string()).is_some() {
                return Err(Wrong::field(
                    "psm",
                    "psm is there twice: take it out of options",
                ));
            }
        }
        let endpoint = endpoint(method, &address, &options)?;
        if method == BLE {
            ConnectLocator::parse(&endpoint).map_err(|error| Wrong {
                field: None,
                what: error.to_string(),
            })?;
        }
        Ok(Self {
            name: written.name,
            method: written.method,
            endpoint,
        })
    }

    /// Whether it leads to the robot of that name, as far as the name tells: Zenoh ends a link to itself by any other.
    pub fn is_to(&self, robot: &str) -> bool {
        self.method == BLE && self.endpoint.address().as_str() == robot
    }

    /// Whom it leads to, without options: what two connections may not share.
    pub fn target(&self) -> String {
        self.endpoint.to_locator().to_string()
    }
}

fn check_name(name: &str) -> Result<(), Wrong> {
    let is_known = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    if (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(is_known) {
        return Ok(());
    }
    let wanted = format!("a name has 1 to {MAX_NAME} letters, digits, `-`, `_` or `.`");
    Err(Wrong::field("name", wanted))
}

fn check_method(method: &str) -> Result<(), Wrong> {
    let is_known = !LinkKind::new_supported_links([method].into_iter()).is_empty();
    if is_known && method != SLOT_LOCATOR_PREFIX {
        return Ok(());
    }
    let wanted = "a method is ble, tcp, udp or another of Zenoh's protocols (tls, quic, ws, unixsock-stream)";
    Err(Wrong::field("method", wanted))
}

/// A host's name or IP address, as it stands in a locator.
fn host(address: &str) -> Result<String, Wrong> {
    let bare = address
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'))
        .unwrap_or(address);
    match bare.parse::<IpAddr>() {
        Ok(ip) if ip.is_multicast() => {
            let what = "this address is a group's, a connection leads to one peer";
            Err(Wrong::field("address", what))
        }
        Ok(IpAddr::V6(ip)) => Ok(format!("[{ip}]")),
        Ok(IpAddr::V4(ip)) => Ok(ip.to_string()),
        Err(_) if bare.contains(':') => {
            let what = "an address is a host's name or IP address; the port has a key of its own";
            Err(Wrong::field("address", what))
        }
        Err(_) => plain_address(bare).map(str::to_owned),
    }
}

/// Nothing in it may be taken for another part of the locator.
fn plain_address(address: &str) -> Result<&str, Wrong> {
    let is_plain = |c: char| !c.is_whitespace() && !c.is_control() && !matches!(c, '?' | '#');
    if !address.is_empty() && address.len() <= 255 && address.chars().all(is_plain) {
        return Ok(address);
    }
    let what = "an address has 1 to 255 bytes without blanks, `?` and `#`; options have a key of their own";
    Err(Wrong::field("address", what))
}

fn endpoint(
    method: &str,
    address: &str,
    options: &BTreeMap<String, String>,
) -> Result<EndPoint, Wrong> {
    let is_plain = |text: &str| {
        let is_special = |c: char| c.is_control() || matches!(c, '?' | '#' | ';' | '=' | '|');
        !text.is_empty() && !text.contains(is_special)
    };
    for (key, value) in options {
        if !is_plain(key) || !is_plain(value) {
            let what = format!("option {key}: keys and values are not empty and without `?#;=|`");
            return Err(Wrong::field("options", what));
        }
    }
    let options: Vec<_> = options.iter().map(|(k, v)| format!("{k}={v}")).collect();
    EndPoint::new(method, address, "", options.join(";")).map_err(|error| Wrong {
        field: None,
        what: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(method: &str, address: &str, port: Option<u16>) -> Written {
        Written {
            name: "one".into(),
            method: method.into(),
            address: address.into(),
            port,
            ..Written::default()
        }
    }

    fn endpoint_of(written: Written) -> String {
        Spec::of(written).expect("valid").endpoint.to_string()
    }

    fn wrong(written: Written) -> Wrong {
        Spec::of(written).expect_err("wrong")
    }

    #[test]
    fn each_method_has_its_address() {
        let tcp = |address| written("tcp", address, Some(7447));
        assert_eq!(endpoint_of(tcp("192.168.1.5")), "tcp/192.168.1.5:7447");
        assert_eq!(endpoint_of(tcp("base.local")), "tcp/base.local:7447");
        assert_eq!(endpoint_of(tcp("fe80::1")), "tcp/[fe80::1]:7447");
        assert_eq!(endpoint_of(tcp("[fe80::1]")), "tcp/[fe80::1]:7447");
        assert_eq!(
            endpoint_of(written("ble", "wombat-2", None)),
            "ble/wombat-2"
        );
        let socket = written("unixsock-stream", "/run/rect/a.sock", None);
        assert_eq!(endpoint_of(socket), "unixsock-stream//run/rect/a.sock");
    }

    #[test]
    fn options_and_psm_go_into_the_locator() {
        let mut ble = written("ble", "DC:A6:32:01:02:03", None);
        ble.psm = Some(128);
        ble.options.insert("mtu".into(), "500".into());
        assert_eq!(
            endpoint_of(ble.clone()),
            "ble/DC:A6:32:01:02:03#mtu=500;psm=128"
        );
        ble.options.insert("psm".into(), "129".into());
        assert_eq!(wrong(ble).field, Some("psm"));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let named = |name: &str| Written {
            name: name.into(),
            ..written("ble", "wombat-2", None)
        };
        for (field, written) in [
            ("name", named("")),
            ("name", named("a b")),
            ("name", named(&"x".repeat(MAX_NAME + 1))),
            ("method", written("tpc", "h", Some(1))),
            ("method", written("slot", "0.0", None)),
            ("method", written("", "h", None)),
            ("port", written("tcp", "h", None)),
            ("port", written("tcp", "h", Some(0))),
            ("port", written("ble", "wombat-2", Some(1))),
            ("address", written("tcp", "", Some(1))),
            ("address", written("tcp", "h:1", Some(1))),
            ("address", written("udp", "224.0.0.224", Some(1))),
            ("address", written("udp", "ff02::1", Some(1))),
            ("address", written("tcp", "a#b", Some(1))),
        ] {
            let wrong = wrong(written.clone());
            assert_eq!(wrong.field, Some(field), "{written:?}: {wrong}");
        }
        let adapter = wrong(written("ble", "hci0", None));
        assert!(adapter.what.contains("adapter"), "{adapter}");
        let mut option = written("ble", "wombat-2", None);
        option.options.insert("speed".into(), "1".into());
        assert!(wrong(option).what.contains("speed"));
    }
}
