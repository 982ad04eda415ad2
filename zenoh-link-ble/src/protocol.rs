//! The wire format and the state of a link's lanes, without I/O.
//!
//! `PROTOCOL.md` is the specification. This module is public only for the tests and the fuzz targets of this
//! repository: it may change in any release.
pub mod goodbye;
pub mod hello;
pub mod key_agreement;
pub mod lanes;
pub mod seal;
pub mod sealed_message;
pub mod secret;
