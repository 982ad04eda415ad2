//! Parses locators: `any/<robot>#...` or `any/<host>:<port>#...` to dial, and `any/<adapter>#...` to listen. All options but
//! those of this crate are those of `ble/`.
use zenoh_link_ble::BLE_LOCATOR_PREFIX;
use zenoh_protocol::core::EndPoint;

/// The name of the protocol in a locator.
pub const ANY_LOCATOR_PREFIX: &str = "any";

/// Returns whether links of that method use Bluetooth.
pub fn has_radio(method: &str) -> bool {
    [ANY_LOCATOR_PREFIX, BLE_LOCATOR_PREFIX].contains(&method)
}

/// Returns whether an endpoint is one of these links.
pub fn is_any(endpoint: &EndPoint) -> bool {
    endpoint.protocol().as_str() == ANY_LOCATOR_PREFIX
}

/// Stands for any robot of a fleet.
const ANY_ROBOT: &str = "*";

/// Why a locator is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LocatorError {
    /// The port is not a number from 1 to 65535.
    #[error("port={0}: a TCP port from 1 to 65535 is expected")]
    Port(String),
    /// The option has no meaning for this kind of locator.
    #[error("{0}= has no effect on a locator to dial: give it to the listener")]
    NotForDial(&'static str),
    /// The option has no meaning for this kind of locator.
    #[error("{0}= has no effect on a listener: give it to the locator to dial")]
    NotForListen(&'static str),
    /// The address has no port, or it has another form.
    #[error("address={0}: a host or an IP address and its port are expected, as 192.168.7.2:7460")]
    Address(String),
    /// The rest is not a valid endpoint.
    #[error("{0}")]
    Endpoint(String),
}

/// A locator to dial.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ConnectLocator {
    /// The robot; `None` if only its address is known.
    pub peer: Option<String>,
    /// `address=`: a host and the port on which the robot accepts further paths. It is dialled before Bluetooth.
    pub address: Option<String>,
    /// The endpoint of its Bluetooth path, of which the address is to be replaced if [`Self::peer`] is `None`.
    pub ble: EndPoint,
}

/// A locator to listen on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ListenLocator {
    /// The endpoint of the Bluetooth listener.
    pub ble: EndPoint,
    /// `port=`: the TCP port on which this side accepts further paths. Default: the system chooses one. It has no
    /// effect without `secret=`.
    pub port: Option<u16>,
    /// `interfaces=`: the network interfaces that are offered, separated by commas. Default: all except the loopback
    /// interface.
    pub interfaces: Option<Vec<String>>,
}

impl ConnectLocator {
    /// Parses an endpoint to dial.
    ///
    /// # Errors
    /// Fails if the endpoint has an option that belongs to a listener.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let config = endpoint.config();
        let for_listener = LISTEN_OPTIONS.iter();
        let unfit = for_listener
            .copied()
            .find(|name| config.get(name).is_some());
        if let Some(option) = unfit {
            return Err(LocatorError::NotForDial(option));
        }
        let target = endpoint.address().as_str().to_owned();
        let ble = bluetooth(endpoint, &target, &[ADDRESS])?;
        if is_host_with_port(&target) {
            return Ok(Self {
                peer: None,
                address: Some(target),
                ble,
            });
        }
        let address = config.get(ADDRESS).map(str::to_owned);
        match address.filter(|address| !is_host_with_port(address)) {
            Some(invalid) => Err(LocatorError::Address(invalid)),
            None => Ok(Self {
                peer: Some(target),
                address: config.get(ADDRESS).map(str::to_owned),
                ble,
            }),
        }
    }

    /// Returns the endpoint of the Bluetooth path. It has some name in place of that of a robot of which only the address is known.
    ///
    /// # Errors
    /// Fails if the options are not valid in a locator.
    pub fn bluetooth(&self) -> Result<EndPoint, LocatorError> {
        match &self.peer {
            Some(_) => Ok(self.ble.clone()),
            None => self.to("robot"),
        }
    }

    /// Returns the endpoint of the Bluetooth path to a peer that was dialled by this locator, which may stand for any robot of a
    /// fleet, or for the robot at an address.
    ///
    /// # Errors
    /// Fails if the name is not valid in a locator.
    pub fn to(&self, peer: &str) -> Result<EndPoint, LocatorError> {
        match self.peer.as_deref() {
            Some(ANY_ROBOT) | None => bluetooth(&self.ble, peer, &["fleet"]),
            Some(_) => Ok(self.ble.clone()),
        }
    }
}

impl ListenLocator {
    /// Parses an endpoint to listen on.
    ///
    /// # Errors
    /// Fails if an option of this crate is invalid.
    pub fn parse(endpoint: &EndPoint) -> Result<Self, LocatorError> {
        let config = endpoint.config();
        if config.get(ADDRESS).is_some() {
            return Err(LocatorError::NotForListen(ADDRESS));
        }
        let port = config.get("port").map(|text| {
            let port = text.parse().ok().filter(|port| *port > 0);
            port.ok_or_else(|| LocatorError::Port(text.to_owned()))
        });
        let names = |text: &str| text.split(',').map(str::to_owned).collect();
        Ok(Self {
            ble: bluetooth(endpoint, endpoint.address().as_str(), &LISTEN_OPTIONS)?,
            port: port.transpose()?,
            interfaces: config.get("interfaces").map(names),
        })
    }
}

/// The options of this crate for a listener, and the one to dial.
const LISTEN_OPTIONS: [&str; 2] = ["port", "interfaces"];
const ADDRESS: &str = "address";

/// Returns whether a text is a host with a port, and not the Bluetooth address or the name of a robot.
fn is_host_with_port(text: &str) -> bool {
    let Some((host, port)) = text.rsplit_once(':') else {
        return false;
    };
    let is_ipv6 = host.starts_with('[') && host.ends_with(']');
    let has_port = port.parse::<u16>().is_ok_and(|port| port > 0);
    has_port && !host.is_empty() && (is_ipv6 || !host.contains(':'))
}

/// Returns the `ble/` endpoint with another address, and without some of the options.
fn bluetooth(
    endpoint: &EndPoint,
    address: &str,
    without: &[&str],
) -> Result<EndPoint, LocatorError> {
    let config = endpoint.config();
    let kept = config.iter().filter(|(name, _)| !without.contains(name));
    let options: Vec<_> = kept
        .map(|(name, value)| format!("{name}={value}"))
        .collect();
    EndPoint::new(
        BLE_LOCATOR_PREFIX,
        address,
        endpoint.metadata().as_str(),
        options.join(";"),
    )
    .map_err(|error| LocatorError::Endpoint(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn endpoint(text: &str) -> EndPoint {
        text.parse().expect("an endpoint")
    }

    #[test]
    fn options_of_bluetooth_are_passed_on() {
        let text = "any/hci0#name=wombat-1;secret=/etc/rect/users;port=7460;interfaces=wlan0,eth0";
        let parsed = ListenLocator::parse(&endpoint(text)).expect("valid");
        assert_eq!(parsed.port, Some(7460));
        let interfaces = ["wlan0", "eth0"].map(str::to_owned).to_vec();
        assert_eq!(parsed.interfaces, Some(interfaces));
        assert_eq!(
            parsed.ble,
            endpoint("ble/hci0#name=wombat-1;secret=/etc/rect/users")
        );
        let parsed = ConnectLocator::parse(&endpoint("any/wombat-2#timeout=3000"));
        let parsed = parsed.expect("valid");
        assert_eq!(parsed.peer.as_deref(), Some("wombat-2"));
        assert_eq!(parsed.address, None);
        assert_eq!(parsed.ble, endpoint("ble/wombat-2#timeout=3000"));
        assert_eq!(parsed.to("wombat-2"), Ok(parsed.ble.clone()));
        let fleet = endpoint("any/*#fleet=rect;mtu=500");
        let parsed = ConnectLocator::parse(&fleet).expect("valid");
        assert_eq!(parsed.to("wombat-3"), Ok(endpoint("ble/wombat-3#mtu=500")));
    }

    #[test]
    fn a_robot_can_be_given_by_its_address() {
        for host in ["192.168.7.2:7460", "wombat-2.local:7460", "[fe80::1]:7460"] {
            let text = format!("any/{host}#secret=/etc/rect/users");
            let parsed = ConnectLocator::parse(&endpoint(&text)).expect("valid");
            assert_eq!(
                (parsed.peer.as_deref(), parsed.address.as_deref()),
                (None, Some(host))
            );
            let ble = endpoint("ble/wombat-2#secret=/etc/rect/users");
            assert_eq!(parsed.to("wombat-2"), Ok(ble));
            let text = format!("any/wombat-2#address={host};mtu=500");
            let parsed = ConnectLocator::parse(&endpoint(&text)).expect("valid");
            assert_eq!(
                (parsed.peer.as_deref(), parsed.address.as_deref()),
                (Some("wombat-2"), Some(host))
            );
            assert_eq!(parsed.ble, endpoint("ble/wombat-2#mtu=500"));
        }
        let bluetooth = ConnectLocator::parse(&endpoint("any/DC:A6:32:01:02:03")).expect("valid");
        assert_eq!(bluetooth.address, None);
        for invalid in [
            "192.168.7.2",
            "x:0",
            "x:70000",
            ":7460",
            "DC:A6:32:01:02:03",
        ] {
            let text = format!("any/wombat-2#address={invalid}");
            let parsed = ConnectLocator::parse(&endpoint(&text));
            assert_eq!(parsed, Err(LocatorError::Address(invalid.to_owned())));
        }
    }

    #[test]
    fn invalid_options_are_rejected() {
        for port in ["0", "65536", "x", "-1"] {
            let parsed = ListenLocator::parse(&endpoint(&format!("any/hci0#port={port}")));
            assert_eq!(parsed, Err(LocatorError::Port(port.to_owned())));
        }
        assert_eq!(
            ConnectLocator::parse(&endpoint("any/wombat-2#port=1")),
            Err(LocatorError::NotForDial("port"))
        );
        assert_eq!(
            ListenLocator::parse(&endpoint("any/hci0#address=x:1")),
            Err(LocatorError::NotForListen("address"))
        );
    }
}
