//! Makes the decisions of a session: how a program joins its router, which robots are reachable, and how messages are
//! published, requested and decoded. What takes more than one call to Zenoh is a [`Driver`](crate::driver::Driver).
pub mod decoder;
pub mod endpoint;
pub mod inquiry;
pub mod login;
pub mod peers;
pub mod publication;
pub mod router;
pub mod service;
pub mod settings;
pub mod threads;
