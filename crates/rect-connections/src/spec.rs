//! Validates named connections: the name, the method and the address become an endpoint that can be dialled.
use std::{collections::BTreeMap, fmt, net::IpAddr};

use zenoh_config::EndPoint;
use zenoh_link_any::{
    locator::{has_radio, ConnectLocator as AnyConnectLocator},
    ANY_LOCATOR_PREFIX as ANY,
};
use zenoh_link_ble::locator::ConnectLocator;
use zenoh_link_placeholder::PLACEHOLDER_LOCATOR_PREFIX;
use zenoh_link_table::LinkKind;

/// Maximum length of a name in bytes.
pub const MAX_NAME: usize = 64;
/// Methods whose address is a host with a port.
const WITH_PORT: [&str; 5] = ["tcp", "udp", "tls", "quic", "ws"];
const BLE: &str = "ble";

/// A connection as given in a file or to the config service, before validation.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RawSpec {
    /// Name by which programs refer to the connection.
    pub name: String,
    /// `any`, `ble`, `tcp`, `udp`, or another protocol of Zenoh.
    pub method: String,
    /// Name or Bluetooth address of a robot, a host, or any other address that the method accepts.
    pub address: String,
    /// Port, for methods that have one.
    pub port: Option<u16>,
    /// PSM, for `ble` only; default the advertised one.
    pub psm: Option<u16>,
    /// Options of the method's locator, such as `mtu` for `ble`.
    pub options: BTreeMap<String, String>,
}

/// A valid connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Spec {
    /// Name by which programs refer to the connection.
    pub name: String,
    /// Protocol of the link.
    pub method: String,
    /// Endpoint of the peer, in Zenoh's syntax.
    pub endpoint: EndPoint,
}

/// The reason why a connection is invalid, with the field concerned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SpecError {
    /// Key of the invalid field; `None` if the combination of fields is invalid.
    pub field: Option<&'static str>,
    /// Description, with the values that are valid.
    pub problem: String,
}

impl SpecError {
    fn field(field: &'static str, problem: impl Into<String>) -> Self {
        Self {
            field: Some(field),
            problem: problem.into(),
        }
    }
}

impl fmt::Display for SpecError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.problem)
    }
}

impl Spec {
    /// Validates a connection as far as is possible without dialling it.
    ///
    /// # Errors
    /// The first invalid field.
    pub fn of(raw: RawSpec) -> Result<Self, SpecError> {
        check_name(&raw.name)?;
        check_method(&raw.method)?;
        let method = raw.method.as_str();
        // The robot of an `any` connection may be given by its address.
        let has_port = WITH_PORT.contains(&method) || (method == ANY && raw.port.is_some());
        if raw.psm.is_some() && !has_radio(method) {
            return Err(SpecError::field(
                "psm",
                format!("{method} has no psm; only any and ble have one"),
            ));
        }
        if raw.port.is_some() && !has_port {
            let advice = match method {
                BLE => "; ble has a psm",
                _ => "",
            };
            return Err(SpecError::field(
                "port",
                format!("{method} has no port{advice}"),
            ));
        }
        let address = match (has_port, raw.port) {
            (true, None | Some(0)) => {
                return Err(SpecError::field(
                    "port",
                    format!("{method} needs a port, 1 to 65535"),
                ))
            }
            (true, Some(port)) => format!("{}:{port}", host(&raw.address)?),
            (false, _) => plain_address(&raw.address)?.to_owned(),
        };
        let mut options = raw.options;
        if let Some(psm) = raw.psm {
            if options.insert("psm".to_owned(), psm.to_string()).is_some() {
                return Err(SpecError::field(
                    "psm",
                    "psm is given twice; remove it from options",
                ));
            }
        }
        let endpoint = endpoint(method, &address, &options)?;
        if has_radio(method) {
            check_radio(&endpoint).map_err(|problem| SpecError {
                field: None,
                problem,
            })?;
        }
        Ok(Self {
            name: raw.name,
            method: raw.method,
            endpoint,
        })
    }

    /// Returns whether the connection leads to `robot`, judging by its name. (Zenoh itself closes a link to itself by any
    /// other address.)
    pub fn is_to(&self, robot: &str) -> bool {
        has_radio(&self.method) && self.endpoint.address().as_str() == robot
    }

    /// Returns the locator of the peer without options. No two connections may have the same target.
    pub fn target(&self) -> String {
        self.endpoint.to_locator().to_string()
    }
}

/// Checks the options of a connection that uses Bluetooth.
fn check_radio(endpoint: &EndPoint) -> Result<(), String> {
    let any = AnyConnectLocator::parse(endpoint);
    let bluetooth = any.and_then(|any| any.bluetooth());
    let bluetooth = bluetooth.map_err(|error| error.to_string())?;
    ConnectLocator::parse(&bluetooth).map_err(|error| error.to_string())?;
    Ok(())
}

fn check_name(name: &str) -> Result<(), SpecError> {
    let is_allowed = |byte: u8| byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.');
    if (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(is_allowed) {
        return Ok(());
    }
    let problem = format!("a name has 1 to {MAX_NAME} letters, digits, `-`, `_` or `.`");
    Err(SpecError::field("name", problem))
}

fn check_method(method: &str) -> Result<(), SpecError> {
    let is_zenohs = !LinkKind::new_supported_links([method].into_iter()).is_empty();
    if [ANY, BLE].contains(&method) || is_zenohs && method != PLACEHOLDER_LOCATOR_PREFIX {
        return Ok(());
    }
    let problem = "a method is any, ble, tcp, udp or another of Zenoh's protocols (tls, quic, ws, unixsock-stream)";
    Err(SpecError::field("method", problem))
}

/// Returns a host's name or IP address in the syntax of a locator.
fn host(address: &str) -> Result<String, SpecError> {
    let bare = address
        .strip_prefix('[')
        .and_then(|rest| rest.strip_suffix(']'))
        .unwrap_or(address);
    match bare.parse::<IpAddr>() {
        Ok(ip) if ip.is_multicast() => {
            let problem = "this is a multicast address; a connection leads to one peer";
            Err(SpecError::field("address", problem))
        }
        Ok(IpAddr::V6(ip)) => Ok(format!("[{ip}]")),
        Ok(IpAddr::V4(ip)) => Ok(ip.to_string()),
        Err(_) if bare.contains(':') => {
            let problem = "an address is the name or IP address of a host; give the port as `port`";
            Err(SpecError::field("address", problem))
        }
        Err(_) => plain_address(bare).map(str::to_owned),
    }
}

/// Checks that no character of the address would end it in a locator.
fn plain_address(address: &str) -> Result<&str, SpecError> {
    let is_plain = |c: char| !c.is_whitespace() && !c.is_control() && !matches!(c, '?' | '#');
    if !address.is_empty() && address.len() <= 255 && address.chars().all(is_plain) {
        return Ok(address);
    }
    let problem =
        "an address has 1 to 255 bytes without spaces, `?` and `#`; give options as `options`";
    Err(SpecError::field("address", problem))
}

fn endpoint(
    method: &str,
    address: &str,
    options: &BTreeMap<String, String>,
) -> Result<EndPoint, SpecError> {
    let is_plain = |text: &str| {
        let is_special = |c: char| c.is_control() || matches!(c, '?' | '#' | ';' | '=' | '|');
        !text.is_empty() && !text.contains(is_special)
    };
    for (key, value) in options {
        if !is_plain(key) || !is_plain(value) {
            let problem = format!(
                "option {key}: keys and values must not be empty or contain any of `?#;=|`"
            );
            return Err(SpecError::field("options", problem));
        }
    }
    let options: Vec<_> = options.iter().map(|(k, v)| format!("{k}={v}")).collect();
    EndPoint::new(method, address, "", options.join(";")).map_err(|error| SpecError {
        field: None,
        problem: error.to_string(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raw(method: &str, address: &str, port: Option<u16>) -> RawSpec {
        RawSpec {
            name: "one".into(),
            method: method.into(),
            address: address.into(),
            port,
            ..RawSpec::default()
        }
    }

    fn endpoint_of(raw: RawSpec) -> String {
        Spec::of(raw).expect("valid").endpoint.to_string()
    }

    fn error_of(raw: RawSpec) -> SpecError {
        Spec::of(raw).expect_err("invalid")
    }

    #[test]
    fn builds_the_endpoint_of_each_method() {
        let tcp = |address| raw("tcp", address, Some(7447));
        assert_eq!(endpoint_of(tcp("192.168.1.5")), "tcp/192.168.1.5:7447");
        assert_eq!(endpoint_of(tcp("base.local")), "tcp/base.local:7447");
        assert_eq!(endpoint_of(tcp("fe80::1")), "tcp/[fe80::1]:7447");
        assert_eq!(endpoint_of(tcp("[fe80::1]")), "tcp/[fe80::1]:7447");
        assert_eq!(endpoint_of(raw("ble", "wombat-2", None)), "ble/wombat-2");
        assert_eq!(endpoint_of(raw("any", "wombat-2", None)), "any/wombat-2");
        let by_address = raw("any", "192.168.1.5", Some(7460));
        assert_eq!(endpoint_of(by_address), "any/192.168.1.5:7460");
        let socket = raw("unixsock-stream", "/run/rect/a.sock", None);
        assert_eq!(endpoint_of(socket), "unixsock-stream//run/rect/a.sock");
    }

    #[test]
    fn adds_options_and_psm_to_the_locator() {
        let mut ble = raw("ble", "DC:A6:32:01:02:03", None);
        ble.psm = Some(128);
        ble.options.insert("mtu".into(), "500".into());
        assert_eq!(
            endpoint_of(ble.clone()),
            "ble/DC:A6:32:01:02:03#mtu=500;psm=128"
        );
        ble.options.insert("psm".into(), "129".into());
        assert_eq!(error_of(ble).field, Some("psm"));
    }

    #[test]
    fn names_the_invalid_field() {
        let named = |name: &str| RawSpec {
            name: name.into(),
            ..raw("ble", "wombat-2", None)
        };
        for (field, raw) in [
            ("name", named("")),
            ("name", named("a b")),
            ("name", named(&"x".repeat(MAX_NAME + 1))),
            ("method", raw("tpc", "h", Some(1))),
            ("method", raw("placeholder", "0.0", None)),
            ("method", raw("", "h", None)),
            ("port", raw("tcp", "h", None)),
            ("port", raw("tcp", "h", Some(0))),
            ("port", raw("ble", "wombat-2", Some(1))),
            ("address", raw("tcp", "", Some(1))),
            ("address", raw("tcp", "h:1", Some(1))),
            ("address", raw("udp", "224.0.0.224", Some(1))),
            ("address", raw("udp", "ff02::1", Some(1))),
            ("address", raw("tcp", "a#b", Some(1))),
        ] {
            let error = error_of(raw.clone());
            assert_eq!(error.field, Some(field), "{raw:?}: {error}");
        }
        let adapter = error_of(raw("ble", "hci0", None));
        assert!(adapter.problem.contains("adapter"), "{adapter}");
        let mut without_port = raw("any", "wombat-2", None);
        (without_port.options).insert("address".into(), "192.168.1.5".into());
        assert!(error_of(without_port).problem.contains("its port"));
        let mut option = raw("ble", "wombat-2", None);
        option.options.insert("speed".into(), "1".into());
        assert!(error_of(option).problem.contains("speed"));
    }
}
