//! Makes the decisions of a session: how a program joins its router, which robots are reachable, and how messages are
//! published, requested and decoded. A [`Driver`](crate::driver::Driver) decides about an operation of several calls.
pub mod declarations;
pub mod decoder;
pub mod endpoint;
pub mod inquiry;
pub mod login;
pub mod name_check;
pub mod names;
pub mod peers;
pub mod publication;
pub mod recipients;
pub mod request_ids;
pub mod requester_end;
pub mod router;
pub mod served;
pub mod service;
pub mod settings;
pub mod threads;
