//! Owns the simulated air: Bluetooth LE as far as links notice it, without any Bluetooth.
//!
//! The model (`air`, and under it `connection`, `packet`, `channel`, `phy`, `condition`) is told the time and does no I/O. It
//! works inside one process ([`SimAir`], in virtual time under tokio's paused clock), and between processes over a
//! Unix socket that `rect air` serves ([`AirServer`], [`radio`]). [`SimRadio`] is the same adapter on either.
//!
//! Not modelled: pairing and encryption (every security level is granted), advertising and scanning as a load on the
//! air, drifting clocks, and channel hopping other than as chance.
mod adapter;
mod air;
mod attachment;
mod channel;
mod channel_handle;
mod condition;
mod connection;
mod dice;
mod guards;
mod local;
mod message;
mod options;
mod packet;
mod phy;
mod radio;
mod remote;
mod server;
mod socket;
mod wire;

pub use self::{
    adapter::{address_of, check_name, AdapterNameError, AdapterStats},
    air::{AdapterStatus, AirStatus, AttachError, LinkStatus, NoSuchAdapter},
    condition::{Condition, ConditionError},
    local::SimAir,
    options::{AirOptions, AirOptionsError, RECEIVE_BUFFER_BYTES},
    phy::{LlPayload, LlPayloadError, Phy, PhyError},
    radio::SimRadio,
    remote::{control, radio, radio_at, ControlError},
    server::{AirServer, ServeError},
    socket::{socket_path, SocketError, SOCKET_VARIABLE},
    wire::Control,
};
