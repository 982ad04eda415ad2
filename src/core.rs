//! Contains the protocol logic, without I/O except for the files of dictionaries. Every language uses this
//! implementation.
pub mod cause;
pub mod clock;
pub mod codec;
pub mod driver;
pub mod message;
pub mod name;
pub mod registry;
pub mod session;
pub mod stream;
pub mod text;
pub mod transfer;
pub mod video;
