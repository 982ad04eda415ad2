//! Owns the reading of `ble/<address or name>#<options>`: everything a user can write in a locator ends here as a
//! typed value, or as an error that names the part that is wrong.
use std::{fmt, time::Duration};

use zenoh_protocol::core::EndPoint;

use crate::{
    address::{Address, AddressType, Psm},
    hello::{MAX_NAME, MIN_MTU},
    radio::Security,
};

/// The protocol's name in a locator.
pub const BLE_LOCATOR_PREFIX: &str = "ble";

/// The largest Zenoh batch this side takes when `mtu=` is left out, in bytes. At 34 kB/s such a batch holds the radio
/// for 30 ms, and its seven bytes of framing and L2CAP headers are under 1 %.
pub const DEFAULT_MTU: u16 = 1000;
/// The largest `mtu=`, in bytes.
pub const MAX_MTU: u16 = 8000;
/// How many links a listener takes when `max_links=` is left out: what common controllers manage.
pub const DEFAULT_MAX_LINKS: usize = 7;
/// How long a connect may take when `timeout=` is left out. Zenoh's own limit for opening a link
/// (`transport/unicast/open_timeout`) is 10 s and includes its handshake.
pub const DEFAULT_CONNECT_TIMEOUT: Duration = Duration::from_millis(8000);

/// Whom to dial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// The device of that address.
    Address(Address),
    /// Whoever advertises that name.
    Name(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(f),
            Self::Name(name) => f.write_str(name),
        }
    }
}

/// `ble/<address or name>#...`: what to dial and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConnectLocator {
    /// Whom.
    pub target: Target,
    /// `adapter=`: the local adapter; left out, that of this node's listener, else the system's default one.
    pub adapter: Option<String>,
    /// `psm=`: left out, the advertised one.
    pub psm: Option<Psm>,
    /// `addr_type=`: left out, as discovered.
    pub address_kind: Option<AddressType>,
    /// `sec=`.
    pub security: Security,
    /// `mtu=`, in bytes.
    pub mtu: u16,
    /// `timeout=`, in milliseconds: for finding, connecting and the hello together.
    pub timeout: Duration,
    /// `plain=true`: no hello and no framing, for a peer that speaks bare one-batch-per-SDU. Left out, as advertised.
    pub plain: Option<bool>,
}

/// `ble/<adapter>#...`: where to listen and how.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenLocator {
    /// The local adapter.
    pub adapter: String,
    /// `name=`: the name to advertise; left out, the host's name.
    pub name: Option<String>,
    /// `psm=`: left out, one of the system's choice.
    pub psm: Option<Psm>,
    /// `sec=`.
    pub security: Security,
    /// `mtu=`, in bytes.
    pub mtu: u16,
    /// `max_links=`.
    pub max_links: usize,
}

/// What is wrong with a locator.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LocatorError {
    /// The part before `#` is neither an address nor a name.
    #[error("`{given}` is neither a bluetooth address (DC:A6:32:01:02:03) nor a robot's name (1 to {MAX_NAME} letters, digits, `-`, `_` or `.`)")]
    Target {
        /// As given.
        given: String,
    },
    /// An adapter was given where a peer belongs.
    #[error("`{given}` is an adapter, which can be listened on; to connect give the peer's name or address, and the adapter as #adapter={given}")]
    AdapterAsTarget {
        /// As given.
        given: String,
    },
    /// The part before `#` is no adapter.
    #[error("`{given}` is not an adapter to listen on: give one as `hci0` (see `bluetoothctl list`) or `sim-...` for the simulated air, and the robot's name as #name=")]
    Adapter {
        /// As given.
        given: String,
    },
    /// There is no such option.
    #[error("unknown option `{key}` of a ble {side} locator; known are {known}")]
    UnknownOption {
        /// Its key.
        key: String,
        /// `connect` or `listen`.
        side: &'static str,
        /// Those there are.
        known: String,
    },
    /// An option's value is wrong.
    #[error("option {key}={value}: {wanted}")]
    Value {
        /// Its key.
        key: &'static str,
        /// As given.
        value: String,
        /// What it takes.
        wanted: &'static str,
    },
}

const CONNECT_OPTIONS: [&str; 7] = [
    "adapter",
    "psm",
    "addr_type",
    "sec",
    "mtu",
    "timeout",
    "plain",
];
const LISTEN_OPTIONS: [&str; 5] = ["name", "psm", "sec", "mtu", "max_links"];

impl ConnectLocator {
    /// Reads an endpoint to connect to.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let given = endpoint.address().as_str().to_owned();
        let target = match given.parse() {
            Ok(address) => Target::Address(address),
            Err(_) if is_adapter(&given) => return Err(LocatorError::AdapterAsTarget { given }),
            Err(_) if is_name(&given) => Target::Name(given),
            Err(_) => return Err(LocatorError::Target { given }),
        };
        let options = Options::parse(endpoint, "connect", &CONNECT_OPTIONS)?;
        Ok(Self {
            target,
            adapter: options.adapter()?,
            psm: options.psm()?,
            address_kind: options.address_kind()?,
            security: options.security()?,
            mtu: options.mtu()?,
            timeout: options.timeout()?,
            plain: options.plain()?,
        })
    }
}

impl ListenLocator {
    /// Reads an endpoint to listen on.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let adapter = endpoint.address().as_str().to_owned();
        if !is_adapter(&adapter) {
            return Err(LocatorError::Adapter { given: adapter });
        }
        let options = Options::parse(endpoint, "listen", &LISTEN_OPTIONS)?;
        Ok(Self {
            adapter,
            name: options.name()?,
            psm: options.psm()?,
            security: options.security()?,
            mtu: options.mtu()?,
            max_links: options.max_links()?,
        })
    }
}

impl ListenLocator {
    /// The name to listen as: the one given, or the host's; where neither can name a robot, the adapter's.
    pub fn name(&self) -> String {
        let host = || std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
        let usable = |name: String| Some(name.trim().to_owned()).filter(|n| is_name(n));
        let given = self.name.clone();
        given
            .or_else(|| host().and_then(usable))
            .unwrap_or_else(|| self.adapter.clone())
    }
}

/// Whether the endpoint is one of this link's.
pub fn is_ble(endpoint: &EndPoint) -> bool {
    endpoint.protocol().as_str() == BLE_LOCATOR_PREFIX
}

/// Whether `text` can name an adapter: `hci` and a number, or `sim...`.
pub fn is_adapter(text: &str) -> bool {
    let hci = text
        .strip_prefix("hci")
        .is_some_and(|n| !n.is_empty() && n.len() <= 5 && n.bytes().all(|b| b.is_ascii_digit()));
    hci || is_simulated(text)
}

/// Whether `text` names a simulated adapter.
pub fn is_simulated(text: &str) -> bool {
    text.starts_with("sim") && text.len() <= 32 && text.bytes().all(is_name_byte)
}

/// Whether `text` can name a robot.
pub fn is_name(text: &str) -> bool {
    (1..=MAX_NAME).contains(&text.len()) && text.bytes().all(is_name_byte)
}

fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.')
}

/// An option's value where it is given, and what a wrong one is told.
struct Options<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Options<'a> {
    fn parse(
        endpoint: &'a EndPoint,
        side: &'static str,
        known: &[&str],
    ) -> Result<Self, LocatorError> {
        let mut options = Vec::new();
        let text = endpoint.config().as_str();
        for part in text.split(';').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            if !known.contains(&key) {
                return Err(LocatorError::UnknownOption {
                    key: key.to_owned(),
                    side,
                    known: known.join(", "),
                });
            }
            options.push((key, value));
        }
        Ok(Self(options))
    }

    fn read<T>(
        &self,
        key: &'static str,
        wanted: &'static str,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<Option<T>, LocatorError> {
        let Some((_, value)) = self.0.iter().find(|(k, _)| *k == key) else {
            return Ok(None);
        };
        read(value).map(Some).ok_or_else(|| LocatorError::Value {
            key,
            value: (*value).to_owned(),
            wanted,
        })
    }

    fn adapter(&self) -> Result<Option<String>, LocatorError> {
        self.read(
            "adapter",
            "an adapter is named hci0, hci1, ... or sim-...",
            |v| is_adapter(v).then(|| v.to_owned()),
        )
    }

    fn name(&self) -> Result<Option<String>, LocatorError> {
        self.read(
            "name",
            "a name has 1 to 29 letters, digits, `-`, `_` or `.`, and is not that of an adapter or an address",
            |v| (is_name(v) && !is_adapter(v)).then(|| v.to_owned()),
        )
    }

    fn psm(&self) -> Result<Option<Psm>, LocatorError> {
        self.read("psm", "a psm is a number from 128 to 255", |v| {
            v.parse().ok().and_then(Psm::new)
        })
    }

    fn address_kind(&self) -> Result<Option<AddressType>, LocatorError> {
        self.read("addr_type", "it is public or random", |v| match v {
            "public" => Some(AddressType::Public),
            "random" => Some(AddressType::Random),
            _ => None,
        })
    }

    fn security(&self) -> Result<Security, LocatorError> {
        let level = self.read("sec", "it is low, medium or high", |v| match v {
            "low" => Some(Security::Low),
            "medium" => Some(Security::Medium),
            "high" => Some(Security::High),
            _ => None,
        })?;
        Ok(level.unwrap_or_default())
    }

    fn mtu(&self) -> Result<u16, LocatorError> {
        let mtu = self.read(
            "mtu",
            "it is a number of bytes from 128 (what Zenoh's handshake needs) to 8000",
            |v| {
                v.parse()
                    .ok()
                    .filter(|mtu| (MIN_MTU..=MAX_MTU).contains(mtu))
            },
        )?;
        Ok(mtu.unwrap_or(DEFAULT_MTU))
    }

    fn timeout(&self) -> Result<Duration, LocatorError> {
        let timeout = self.read(
            "timeout",
            "it is a number of milliseconds from 100 to 60000",
            |v| {
                v.parse()
                    .ok()
                    .filter(|ms| (100..=60_000).contains(ms))
                    .map(Duration::from_millis)
            },
        )?;
        Ok(timeout.unwrap_or(DEFAULT_CONNECT_TIMEOUT))
    }

    fn plain(&self) -> Result<Option<bool>, LocatorError> {
        self.read("plain", "it is true or false", |v| v.parse().ok())
    }

    fn max_links(&self) -> Result<usize, LocatorError> {
        let links = self.read("max_links", "it is a number from 1 to 64", |v| {
            v.parse().ok().filter(|n| (1..=64).contains(n))
        })?;
        Ok(links.unwrap_or(DEFAULT_MAX_LINKS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn connect(text: &str) -> Result<ConnectLocator, LocatorError> {
        ConnectLocator::parse(&text.parse().expect("an endpoint"))
    }

    fn listen(text: &str) -> Result<ListenLocator, LocatorError> {
        ListenLocator::parse(&text.parse().expect("an endpoint"))
    }

    #[test]
    fn an_address_with_every_option_is_read() {
        let read = connect(
            "ble/DC:A6:32:01:02:03#adapter=hci1;psm=128;addr_type=random;sec=medium;mtu=500;timeout=3000;plain=true",
        )
        .expect("valid");
        assert_eq!(read.target.to_string(), "DC:A6:32:01:02:03");
        assert_eq!(read.adapter.as_deref(), Some("hci1"));
        assert_eq!(read.psm, Psm::new(128));
        assert_eq!(read.address_kind, Some(AddressType::Random));
        assert_eq!(read.security, Security::Medium);
        assert_eq!(read.mtu, 500);
        assert_eq!(read.timeout, Duration::from_secs(3));
        assert_eq!(read.plain, Some(true));
    }

    #[test]
    fn a_bare_name_takes_the_defaults() {
        let read = connect("ble/wombat-2").expect("valid");
        assert_eq!(read.target, Target::Name("wombat-2".to_owned()));
        assert_eq!((read.psm, read.adapter, read.plain), (None, None, None));
        assert_eq!(
            (read.mtu, read.timeout),
            (DEFAULT_MTU, DEFAULT_CONNECT_TIMEOUT)
        );
    }

    #[test]
    fn a_listener_is_an_adapter_with_a_name() {
        let read = listen("ble/hci0#name=wombat-1;max_links=3").expect("valid");
        assert_eq!(
            (read.adapter.as_str(), read.name.as_deref()),
            ("hci0", Some("wombat-1"))
        );
        assert_eq!(read.max_links, 3);
    }

    #[test]
    fn both_sides_of_each_limit() {
        for good in [
            "psm=128",
            "psm=255",
            "mtu=128",
            "mtu=8000",
            "timeout=100",
            "timeout=60000",
        ] {
            assert!(connect(&format!("ble/w#{good}")).is_ok(), "{good}");
        }
        for bad in [
            "psm=127",
            "psm=256",
            "psm=",
            "psm=x",
            "mtu=127",
            "mtu=8001",
            "timeout=99",
            "timeout=60001",
            "sec=none",
            "addr_type=le",
            "plain=1",
            "adapter=eth0",
        ] {
            let error = connect(&format!("ble/w#{bad}")).expect_err(bad);
            let key = bad.split('=').next().unwrap_or_default();
            assert!(error.to_string().contains(key), "{error}");
        }
        for bad in [
            "max_links=0",
            "max_links=65",
            "name=",
            "name=a b",
            "name=hci0",
            "name=sim-1",
        ] {
            assert!(listen(&format!("ble/hci0#{bad}")).is_err(), "{bad}");
        }
        assert!(listen(&format!("ble/hci0#name={}", "x".repeat(29))).is_ok());
        assert!(listen(&format!("ble/hci0#name={}", "x".repeat(30))).is_err());
    }

    #[test]
    fn an_unknown_option_is_named_with_the_known_ones() {
        let error = connect("ble/wombat-2#speed=fast")
            .expect_err("unknown")
            .to_string();
        assert!(
            error.contains("`speed`") && error.contains("psm"),
            "{error}"
        );
    }

    #[test]
    fn an_adapter_is_no_peer_and_a_peer_no_adapter() {
        assert!(matches!(
            connect("ble/hci0"),
            Err(LocatorError::AdapterAsTarget { .. })
        ));
        assert!(matches!(
            listen("ble/wombat-1"),
            Err(LocatorError::Adapter { .. })
        ));
        assert!(matches!(
            connect("ble/wombat 2"),
            Err(LocatorError::Target { .. })
        ));
    }
}
