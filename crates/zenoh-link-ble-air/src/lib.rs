//! Simulates Bluetooth LE, as far as links can observe it, without Bluetooth hardware.
//!
//! The model (`air`, which uses `connection`, `packet`, `channel`, `phy` and `condition`) receives the time as a
//! parameter and does no I/O. It runs within one process ([`SimAir`], in virtual time if tokio's clock is paused), or
//! between processes over a Unix socket that `rect air` serves ([`AirServer`], [`radio`]). [`SimRadio`] is the adapter
//! in both cases.
//!
//! Not modelled: pairing and encryption (every security level is granted), scan requests and responses (scanners know the
//! name at once), and channel hopping other than as a loss probability. A connection event takes precedence over an
//! advertisement.
#![cfg_attr(not(test), warn(clippy::unwrap_used, clippy::expect_used))]
mod adapter;
mod air;
mod arbitration;
mod attachment;
mod channel;
mod channel_flow;
mod channel_handle;
mod clock;
mod condition;
mod connection;
mod guards;
mod id;
mod local;
mod message;
mod options;
mod packet;
mod phy;
mod radio;
mod remote;
mod rng;
mod server;
mod socket;
mod wire;

pub use self::{
    adapter::{address_of, check_name, AdapterNameError, AdapterStats},
    air::{AdapterStatus, AirStatus, AttachError, LinkStatus, NoSuchAdapter},
    arbitration::Arbitration,
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
