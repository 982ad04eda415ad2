//! The protocol of RECT, without I/O except for the files of dictionaries and transfers. Every language uses this
//! implementation.
//!
//! [`message`] describes messages and their metadata, [`name`] who sends them and where they go, and [`codec`] makes their
//! payloads smaller. [`alert`], [`deadman`], [`log`], [`parameters`], [`registry`], [`retry`], [`session`], [`state`], [`stop`],
//! [`stream`] and [`transfer`] make the decisions of a session: plain structs and functions decide about a single call, and a
//! [`driver`] decides what takes more than one call to Zenoh. [`storage`] reads and writes the files of transfers.
pub mod action;
pub mod alert;
pub mod catalogue;
pub mod cause;
pub mod clock;
pub mod codec;
pub mod deadman;
pub mod driver;
pub mod log;
pub mod message;
pub mod name;
pub mod parameters;
pub mod registry;
pub mod retry;
pub mod session;
pub mod state;
pub mod stop;
pub mod storage;
pub mod stream;
pub mod text;
pub mod throttle;
pub mod transfer;
pub mod video;
