//! Owns the reading of `ble/<address or name>#<options>`: everything a user can write in a locator ends here as a
//! typed value, or as an error that names the part that is wrong.
use std::{fmt, path::PathBuf, time::Duration};

use zenoh_protocol::core::EndPoint;

pub use self::error::LocatorError;
use self::options::Options;
use crate::{
    address::{Address, AddressType, Psm},
    hello::MAX_NAME,
    lanes::scheduler::Bounds,
    radio::Security,
};

mod error;
mod options;

/// The protocol's name in a locator.
pub const BLE_LOCATOR_PREFIX: &str = "ble";

/// The largest Zenoh batch this side takes when `mtu=` is left out, in bytes: with its framing it fills three K-frames of
/// 247 bytes, each of which fills a packet of 251. At 34 kB/s it holds the radio for 22 ms; a smaller one costs more than
/// 2 % in headers.
pub const DEFAULT_MTU: u16 = 736;
/// The largest `mtu=`, in bytes.
pub const MAX_MTU: u16 = 8000;
/// How many links a listener takes when `max_links=` is left out: what common controllers manage.
pub const DEFAULT_MAX_LINKS: usize = 7;
/// How long a connect may take when `timeout=` is left out. Zenoh's own limit for opening a link
/// (`transport/unicast/open_timeout`) is 10 s and includes its handshake.
pub const DEFAULT_CONNECT_TIMEOUT: Duration = Duration::from_millis(8000);

/// In the place of a peer: anyone.
const ANYONE: &str = "*";

/// The limits of what waits on a link when `queue=`, `backlog=` and `droppable=` are left out. 16 MB are one message of the largest
/// size that our configurations let in; the memory is taken as it is needed, and a robot with 1 GB has it.
pub const DEFAULT_BOUNDS: Bounds = Bounds {
    bytes: 16 << 20,
    backlog: Duration::from_millis(1000),
    droppable: Duration::from_millis(100),
};
/// How long a closing side waits for the peer to take what was sent before, when `linger=` is left out.
pub const DEFAULT_LINGER: Duration = Duration::from_secs(5);

/// How the batches of a link are queued. A plain peer has no queues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Queueing {
    /// `queue=`, in bytes, `backlog=` and `droppable=`, in milliseconds: what may wait on the link.
    pub bounds: Bounds,
    /// `linger=`, in milliseconds: how long a closing side waits until the peer has taken what was sent before.
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

/// Whom to dial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// The device of that address.
    Address(Address),
    /// Whoever advertises that name.
    Name(String),
    /// Anyone who advertises that fleet and is not linked yet.
    Fleet(String),
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Address(address) => address.fmt(f),
            Self::Name(name) => f.write_str(name),
            Self::Fleet(fleet) => write!(f, "anyone of fleet {fleet}"),
        }
    }
}

/// `ble/<address or name>#...` or `ble/*#fleet=...`: what to dial and how.
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
    /// `secret=`: the file with the team's secret; left out, that of this node's listener.
    pub secret: Option<PathBuf>,
    /// `mtu=`, in bytes.
    pub mtu: u16,
    /// `queue=`, `backlog=`, `droppable=`, `linger=`.
    pub queueing: Queueing,
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
    /// `fleet=`: the fleet to advertise; left out, none.
    pub fleet: Option<String>,
    /// `psm=`: left out, one of the system's choice.
    pub psm: Option<Psm>,
    /// `sec=`.
    pub security: Security,
    /// `secret=`: the file with the team's secret, which whoever is linked must have; left out, anyone is.
    pub secret: Option<PathBuf>,
    /// `mtu=`, in bytes.
    pub mtu: u16,
    /// `queue=`, `backlog=`, `droppable=`, `linger=`.
    pub queueing: Queueing,
    /// `max_links=`.
    pub max_links: usize,
    /// `wait=true`: an adapter that is not there, or off, is waited for; left out, it is an error.
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
    /// Reads an endpoint to connect to.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let given = endpoint.address().as_str().to_owned();
        let options = Options::parse(endpoint, "connect", &CONNECT_OPTIONS)?;
        let fleet = options.fleet()?;
        let target = match given.parse() {
            Ok(address) => Target::Address(address),
            Err(_) if given == ANYONE => Target::Fleet(fleet.clone().ok_or(LocatorError::NoFleet)?),
            Err(_) if is_adapter(&given) => return Err(LocatorError::AdapterAsTarget { given }),
            Err(_) if is_name(&given) => Target::Name(given),
            Err(_) => return Err(LocatorError::Target { given }),
        };
        if fleet.is_some() && !matches!(target, Target::Fleet(_)) {
            return Err(LocatorError::FleetOfOne);
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

#[cfg(test)]
mod tests;
