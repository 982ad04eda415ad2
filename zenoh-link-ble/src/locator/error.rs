//! Defines what can be wrong with a locator, with messages for the user who wrote it.
use link_lanes::hello::MAX_NAME;

/// Why a locator is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LocatorError {
    /// The part before `#` is neither an address nor a name.
    #[error("`{given}` is neither a bluetooth address (DC:A6:32:01:02:03) nor a robot's name (1 to {MAX_NAME} letters, digits, `-`, `_` or `.`)")]
    Target {
        /// The part as given.
        given: String,
    },
    /// An adapter was given instead of a peer.
    #[error("`{given}` is an adapter, which can be listened on; to connect, give the peer's name or address, and the adapter as #adapter={given}")]
    AdapterAsTarget {
        /// The name of the adapter.
        given: String,
    },
    /// The locator is `ble/*` and has no `fleet=`.
    #[error("`ble/*` stands for any robot of a fleet: give the fleet as #fleet=")]
    NoFleet,
    /// The locator has `fleet=` together with a name or an address.
    #[error("fleet= can be used only with `ble/*`, which stands for any robot of the fleet; leave it out for a peer that is given by name or address")]
    FleetWithPeer,
    /// The locator has `plain=true` together with a `secret=` that would never be proved.
    #[error("plain=true and secret= exclude each other: a plain peer has no handshake in which to prove a secret; leave one of the two out (with sec=high, the passkey is derived from the secret, and both may be given)")]
    PlainWithSecret,
    /// The part before `#` is not an adapter.
    #[error("`{given}` is not an adapter to listen on: give one such as `hci0` (see `bluetoothctl list`), or `sim-...` for the simulated air, and the robot's name as #name=")]
    Adapter {
        /// The part as given.
        given: String,
    },
    /// The option does not exist.
    #[error("unknown option `{key}` of a ble {side} locator; known are {known}")]
    UnknownOption {
        /// The key of the option.
        key: String,
        /// `connect` or `listen`.
        side: &'static str,
        /// The keys of all options of such a locator.
        known: String,
    },
    /// The value of an option is invalid.
    #[error("option {key}={value}: {expected}")]
    Value {
        /// The key of the option.
        key: &'static str,
        /// The value as given.
        value: String,
        /// A description of the valid values.
        expected: &'static str,
    },
}
