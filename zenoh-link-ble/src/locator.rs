//! Parses locators, `ble/<address or name>#<options>`, into typed values. An invalid locator is rejected with an error that
//! names the offending part.
use std::{fmt, path::PathBuf, time::Duration};

use link_lanes::{hello::MAX_NAME, lanes::scheduler::Bounds};
use zenoh_link_ble_radio::{
    address::{Address, AddressType, Psm},
    Security,
};
use zenoh_protocol::core::EndPoint;

pub use self::error::LocatorError;
use self::options::Options;

mod error;
mod options;

/// The name of the protocol in a locator.
pub const BLE_LOCATOR_PREFIX: &str = "ble";

/// The default of `mtu=`, in bytes: the largest Zenoh batch that this side accepts. With its framing, such a batch fills
/// three K-frames of 247 bytes, each of which fills a packet of 251 bytes. At 34 kB/s it occupies the radio for 22 ms; a
/// smaller MTU costs more than 2 % for headers.
pub const DEFAULT_MTU: u16 = 736;
/// The largest value of `mtu=`, in bytes.
pub const MAX_MTU: u16 = 8000;
/// The default of `max_links=`: the number of links that common controllers support.
pub const DEFAULT_MAX_LINKS: usize = 7;
/// The default of `timeout=`: how long a dial may take. Zenoh's own limit for opening a link
/// (`transport/unicast/open_timeout`) is 10 s and includes its handshake.
pub const DEFAULT_CONNECT_TIMEOUT: Duration = Duration::from_millis(8000);

/// Stands for any peer of a fleet, in the place of a name.
const ANY_PEER: &str = "*";

/// The defaults of `queue=`, `backlog=` and `droppable=`. 16 MiB hold one message of the largest size that the files in
/// `config/` accept (`max_message_size`). The memory is allocated as needed, and a robot with 1 GB can afford it.
pub const DEFAULT_BOUNDS: Bounds = Bounds {
    bytes: 16 << 20,
    backlog: Duration::from_millis(1000),
    droppable: Duration::from_millis(100),
};
/// The default of `linger=`: how long a closing side waits until the peer has read everything that was queued.
pub const DEFAULT_LINGER: Duration = Duration::from_secs(5);

/// How the batches of a link are queued. A link with a plain peer has no queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Queueing {
    /// `queue=` in bytes (65,536 to 67,108,864), `backlog=` (50 to 600,000) and `droppable=` (20 to 10,000) in
    /// milliseconds: the limits of what waits on the link. Default: [`DEFAULT_BOUNDS`].
    pub bounds: Bounds,
    /// `linger=` in milliseconds, 0 to 60,000: how long a closing side waits until the peer has read everything that
    /// was queued. Default: [`DEFAULT_LINGER`].
    pub linger: Duration,
}

impl Default for Queueing {
    fn default() -> Self {
        Self {
            bounds: DEFAULT_BOUNDS,
            linger: DEFAULT_LINGER,
        }
    }
}

/// The peer to dial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// The device with that address.
    Address(Address),
    /// The robot that advertises that name.
    Name(String),
    /// Any robot that advertises that fleet and is not linked yet.
    Fleet(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(f),
            Self::Name(name) => f.write_str(name),
            Self::Fleet(fleet) => write!(f, "any robot of fleet {fleet}"),
        }
    }
}

/// A locator to dial: `ble/<address or name>#...` or `ble/*#fleet=...`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConnectLocator {
    /// The peer to dial.
    pub target: Target,
    /// `adapter=`: name of the local adapter. Default: that of this node's listener, or else the system's default.
    pub adapter: Option<String>,
    /// `psm=`: the PSM of the peer's listener. Default: the advertised one.
    pub psm: Option<Psm>,
    /// `addr_type=`: the type of the peer's address. Default: the discovered one.
    pub address_kind: Option<AddressType>,
    /// `sec=`: the protection of the channel. Default: low.
    pub security: Security,
    /// `secret=`: path of the file with the team's secret. Default: the secret of this node's listener.
    pub secret: Option<PathBuf>,
    /// `mtu=`: the largest batch that this side accepts, in bytes; [`MIN_MTU`](link_lanes::hello::MIN_MTU) to [`MAX_MTU`].
    /// Default: [`DEFAULT_MTU`].
    pub mtu: u16,
    /// `queue=`, `backlog=`, `droppable=` and `linger=`.
    pub queueing: Queueing,
    /// `timeout=` in milliseconds, 100 to 60,000: time for discovery, connecting and the handshake together. Default:
    /// [`DEFAULT_CONNECT_TIMEOUT`].
    pub timeout: Duration,
    /// `plain=true`: the link has no hello and no framing, because the peer sends one bare batch per SDU.
    /// `plain=false`: it has both. Default: as advertised.
    pub plain: Option<bool>,
}

/// A locator to listen on: `ble/<adapter>#...`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenLocator {
    /// Name of the local adapter.
    pub adapter: String,
    /// `name=`: the name to advertise. Default: the host name.
    pub name: Option<String>,
    /// `fleet=`: the fleet to advertise. Default: none.
    pub fleet: Option<String>,
    /// `psm=`: the PSM to listen on. Default: chosen by the system.
    pub psm: Option<Psm>,
    /// `sec=`: the protection of channels. Default: low.
    pub security: Security,
    /// `secret=`: path of the file with the team's secret, which every peer must have. Default: none, and any peer is
    /// accepted.
    pub secret: Option<PathBuf>,
    /// `mtu=`: the largest batch that this side accepts, in bytes; [`MIN_MTU`](link_lanes::hello::MIN_MTU) to [`MAX_MTU`].
    /// Default: [`DEFAULT_MTU`].
    pub mtu: u16,
    /// `queue=`, `backlog=`, `droppable=` and `linger=`.
    pub queueing: Queueing,
    /// `max_links=`: the largest number of accepted links, 1 to 64. Default: [`DEFAULT_MAX_LINKS`].
    pub max_links: usize,
    /// `wait=true`: the listener waits for an adapter that is missing or switched off. Default: that is an error.
    pub wait: bool,
}

const CONNECT_OPTIONS: [&str; 13] = [
    "adapter",
    "fleet",
    "psm",
    "addr_type",
    "sec",
    "secret",
    "mtu",
    "queue",
    "backlog",
    "droppable",
    "linger",
    "timeout",
    "plain",
];
const LISTEN_OPTIONS: [&str; 12] = [
    "name",
    "fleet",
    "psm",
    "sec",
    "secret",
    "mtu",
    "queue",
    "backlog",
    "droppable",
    "linger",
    "max_links",
    "wait",
];

impl ConnectLocator {
    /// Parses an endpoint to dial.
    ///
    /// # Errors
    /// Fails if the target or an option is invalid, or if options contradict each other.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let given = endpoint.address().as_str().to_owned();
        let options = Options::parse(endpoint, "connect", &CONNECT_OPTIONS)?;
        let fleet = options.fleet()?;
        let target = match given.parse() {
            Ok(address) => Target::Address(address),
            Err(_) if given == ANY_PEER => {
                Target::Fleet(fleet.clone().ok_or(LocatorError::NoFleet)?)
            }
            Err(_) if is_adapter(&given) => return Err(LocatorError::AdapterAsTarget { given }),
            Err(_) if is_name(&given) => Target::Name(given),
            Err(_) => return Err(LocatorError::Target { given }),
        };
        if fleet.is_some() && !matches!(target, Target::Fleet(_)) {
            return Err(LocatorError::FleetWithPeer);
        }
        let (secret, plain, security) = (options.secret()?, options.plain()?, options.security()?);
        if secret.is_some() && plain == Some(true) && security != Security::High {
            return Err(LocatorError::PlainWithSecret);
        }
        Ok(Self {
            target,
            adapter: options.adapter()?,
            psm: options.psm()?,
            address_kind: options.address_kind()?,
            security,
            secret,
            mtu: options.mtu()?,
            queueing: options.queueing()?,
            timeout: options.timeout()?,
            plain,
        })
    }
}

impl ListenLocator {
    /// Parses an endpoint to listen on.
    ///
    /// # Errors
    /// Fails if the adapter or an option is invalid.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let adapter = endpoint.address().as_str().to_owned();
        if !is_adapter(&adapter) {
            return Err(LocatorError::Adapter { given: adapter });
        }
        let options = Options::parse(endpoint, "listen", &LISTEN_OPTIONS)?;
        Ok(Self {
            adapter,
            name: options.name()?,
            fleet: options.fleet()?,
            psm: options.psm()?,
            security: options.security()?,
            secret: options.secret()?,
            mtu: options.mtu()?,
            queueing: options.queueing()?,
            max_links: options.max_links()?,
            wait: options.wait()?,
        })
    }
}

impl ListenLocator {
    /// Returns the name to listen with: the given one, or the host name, or that of the adapter if the host name is not a
    /// valid robot name.
    pub fn name(&self) -> String {
        let host = || std::fs::read_to_string("/proc/sys/kernel/hostname").ok();
        let usable = |name: String| Some(name.trim().to_owned()).filter(|n| is_name(n));
        let given = self.name.clone();
        given
            .or_else(|| host().and_then(usable))
            .unwrap_or_else(|| self.adapter.clone())
    }
}

/// Returns whether the endpoint has the protocol `ble`.
pub fn is_ble(endpoint: &EndPoint) -> bool {
    endpoint.protocol().as_str() == BLE_LOCATOR_PREFIX
}

/// Returns whether `text` is a valid name of an adapter: `hci` and a number, or `sim...`.
pub fn is_adapter(text: &str) -> bool {
    let hci = text
        .strip_prefix("hci")
        .is_some_and(|n| !n.is_empty() && n.len() <= 5 && n.bytes().all(|b| b.is_ascii_digit()));
    hci || is_simulated(text)
}

/// Returns whether `text` is a valid name of a simulated adapter.
pub fn is_simulated(text: &str) -> bool {
    text.starts_with("sim") && text.len() <= 32 && text.bytes().all(is_name_byte)
}

/// Returns whether `text` is a valid name of a robot: 1 to [`MAX_NAME`] letters, digits, `-`, `_` or `.`.
pub fn is_name(text: &str) -> bool {
    (1..=MAX_NAME).contains(&text.len()) && text.bytes().all(is_name_byte)
}

fn is_name_byte(byte: u8) -> bool {
    byte.is_ascii_alphanumeric() || matches!(byte, b'-' | b'_' | b'.')
}

#[cfg(test)]
mod tests;
