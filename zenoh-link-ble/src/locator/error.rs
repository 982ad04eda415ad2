//! Owns what can be wrong with a locator, in words for who wrote it.
use crate::hello::MAX_NAME;

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
    /// `ble/*` without `fleet=`.
    #[error("`ble/*` is anyone of a fleet: give the fleet as #fleet=")]
    NoFleet,
    /// `fleet=` with a peer of its own.
    #[error("fleet= goes with `ble/*`, which is anyone of it; a peer is known by its name or address alone")]
    FleetOfOne,
    /// `plain=true` with a `secret=` that nothing would prove.
    #[error("plain=true and secret= exclude each other: a plain peer has no handshake to prove a secret in; leave one of the two out (with sec=high the secret makes the passkey, and both may be given)")]
    PlainWithSecret,
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
