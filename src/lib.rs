//! RECT, the Robot Extensible Communication Toolkit: robots exchange messages, streams and files over TCP, UDP and
//! Bluetooth Low Energy, on top of Zenoh.
//!
//! ```no_run
//! # #[cfg(feature = "session")]
//! # async fn example() -> Result<(), rect::Error> {
//! let robot = rect::connect("wombat-1").await?;
//! robot.publish("arm/angle", "12.5").await?;
//! # Ok(())
//! # }
//! ```
//!
//! The library has two layers. [`core`] makes all decisions: about names, keys, encodings and codecs, and in drivers
//! about sessions, streams and transfers. It is given the time and the bytes, and does no I/O except for the files of
//! dictionaries. The sessions with Zenoh (feature `session`) perform the actions of the drivers. [`storage`] reads and
//! writes the files of transfers.
pub mod core;
pub mod storage;

#[cfg(feature = "session")]
pub mod blocking;
#[cfg(feature = "session")]
mod error;
#[cfg(feature = "recording")]
pub mod recording;
#[cfg(feature = "session")]
mod session;
#[cfg(feature = "terminal")]
pub mod terminal;

#[cfg(feature = "session")]
pub use error::Error;
#[cfg(feature = "session")]
pub use session::*;

pub use crate::core::{
    message::{
        counters::Counters,
        encoding::Encoding,
        payload::{Cbor, Json, Payload, ToPayload},
        queue::WhenFull,
        urgency::Urgency,
        Message,
    },
    name::{
        topic::{Pattern, Topic},
        Name,
    },
    registry::{
        connection::{
            Connection, ConnectionState, Event, Link, LinkPath, LinkPathState, PathSwitch,
            SwitchReason,
        },
        named_connection::NamedConnection,
    },
    stream::sender::Options as StreamOptions,
};
