//! RECT, the Robot Extensible Communication Toolkit: robots that exchange messages, streams and files over TCP, UDP and
//! Bluetooth Low Energy, on Zenoh.
//!
//! Two storeys. [`core`] decides: names, keys, encodings, codecs, and the state machines of what takes more than one
//! message; it is given the time and the bytes, and does no I/O. Above it are the sessions on zenoh (feature `session`).
//! [`storage`] is beside them: the files of transfers.
pub mod core;
pub mod storage;

#[cfg(feature = "session")]
pub mod blocking;
#[cfg(feature = "session")]
mod error;
#[cfg(feature = "session")]
mod session;
#[cfg(feature = "terminal")]
pub mod terminal;

#[cfg(feature = "session")]
pub use error::Error;
#[cfg(feature = "session")]
pub use session::*;

pub use crate::core::{
    connection::{Connection, ConnectionState, Event, Link},
    counters::Counters,
    encoding::Encoding,
    message::Message,
    name::Name,
    named_connection::NamedConnection,
    payload::{Cbor, Json, Payload, ToPayload},
    queue::WhenFull,
    stream::sender::Options as StreamOptions,
    topic::{Pattern, Topic},
    urgency::Urgency,
};
