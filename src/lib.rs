//! RECT, the Robot Extensible Communication Toolkit: robots that exchange messages, streams and files over TCP, UDP and
//! Bluetooth Low Energy, on Zenoh.
//!
//! Two storeys. [`core`] decides: names, keys, encodings, codecs, and the state machines of what takes more than one
//! message; it is given the time and the bytes, and does no I/O. Above it are the sessions on zenoh (feature `session`).
pub mod core;
