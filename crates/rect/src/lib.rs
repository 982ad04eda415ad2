//! RECT, the Robot Extensible Communication Toolkit: robots exchange messages, streams and files over TCP, UDP and
//! Bluetooth Low Energy, on top of Zenoh.
//!
//! ```no_run
//! # async fn example() -> Result<(), rect::Error> {
//! let robot = rect::connect("wombat-1").await?;
//! robot.publish("arm/angle", "12.5").await?;
//! # Ok(())
//! # }
//! ```
//!
//! The crate `rect-core` makes all decisions, without I/O: about names, keys, encodings and codecs, and in drivers about
//! sessions, streams and transfers. This crate performs the actions of the drivers on Zenoh. The async API is at the root,
//! and [`blocking`] contains the same without async.
//!
//! | feature | contents |
//! |---|---|
//! | `video` | video in streams: H.264, which needs a C++ compiler |
//! | `recording` | recordings in MCAP and Matroska files (`rect::recording`), with `video` |
pub mod blocking;
mod error;
mod session;

pub use error::Error;
pub use session::*;

pub use rect_core::{
    action::state::{GoalState, KnownGoal, Phase},
    alert::{query::RobotAlert, Alert},
    catalogue::{Program, ServiceEntry},
    codec,
    codec::{
        array::Array,
        dictionary::{Dictionary, DictionaryError},
        picture::{Format, Picture},
        Codec, CodecError,
    },
    log::{
        level::{Level, LevelError},
        line::Line as LogLine,
        page::Kept as KeptLine,
        reader::Item as LogItem,
    },
    message::{
        counters::Counters,
        encoding::{Encoding, EncodingKind},
        gaps::SenderCounts,
        mismatch::Mismatch,
        payload::{Cbor, FromPayload, Json, Payload, PayloadError, ToPayload, ValueOf},
        queue::WhenFull,
        retained::Retained,
        urgency::Urgency,
        Message,
    },
    name::{
        topic::{Pattern, RobotTopic, Topic, TopicError},
        Name, NameError,
    },
    parameters::{Change, Changed, Parameter, Value as ParameterValue},
    registry::{
        connection::{
            Connection, ConnectionState, Event, Link, LinkPath, LinkPathState, PathSwitch, PeerId,
            SwitchReason, Traffic,
        },
        named_connection::NamedConnection,
    },
    session::{login::LoginRefused, router::WrongRobot},
    stop::{Confirmation, Stop},
    storage::Content,
    stream::{
        options::OptionError,
        picture::LossyFormat,
        sender::Options as StreamOptions,
        status::{Status as StreamStatus, VideoStatus},
    },
    transfer::{Fault, Offer, OfferError, Progress, Refusal},
};
pub use rect_derive::Parameters;
#[cfg(feature = "recording")]
pub use rect_recording as recording;
/// A value of any type, for programs that do not know which one arrives: what JSON can express.
pub use serde_json::Value;
