//! Contains the protocol logic, without I/O except for the files of dictionaries. Every language uses this
//! implementation.
pub mod array;
pub mod attachment;
pub mod codec;
pub mod connection;
pub mod counters;
pub mod dictionary;
pub mod display;
pub mod encoding;
pub mod endpoint;
pub mod gaps;
pub mod humanize;
pub mod key;
pub mod login;
pub mod message;
pub mod name;
pub mod named_connection;
pub mod payload;
pub mod picture;
pub mod queue;
pub mod request;
pub mod router;
pub mod stream;
pub mod topic;
pub mod topics;
pub mod transfer;
pub mod urgency;
