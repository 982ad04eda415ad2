//! State that stays: the last value of each retained topic.
//!
//! The router of a robot keeps the values that its programs retain, and numbers them ([`keeper`]); a program without a router keeps its own.
//! Only the keeper of a robot decides about its values. Other routers have copies of those that their programs subscribe to. A program asks
//! its own router alone ([`program`]), and waits there for changes. It also receives each change as it is published, so that a subscription
//! delivers each value once, and none after a newer one ([`order`](crate::message::retained)).
//!
//! Values travel in [`page`]s: what changed since a number. A value that changes is also published as any message, with a [`live`](crate::message::retained::live)
//! attachment, for subscribers that do not use RECT and for the copies.
mod copies;
mod followers;
pub mod keeper;
pub mod latest;
pub mod page;
mod polls;
pub mod program;
pub mod retain;
mod saved;
mod store;
#[cfg(test)]
mod tests;

use std::time::Duration;

pub use crate::message::retained::{Origin, Position, MAX_VALUE};

/// The part after `@rect/` of the key at which a router answers other robots.
pub const STATE: &str = "state";
/// The part after `@rect/` of the key at which a router answers the programs of its own robot. Access control grants it separately (`@set`).
pub const OF_PROGRAMS: &str = "@set/state";
/// The part after `@rect/` with which the tokens of routers begin that keep values; the run follows. It is short, because every router
/// gets every token.
const TOKEN: &str = "s";

/// The maximum size of the values of one robot, in bytes. Each counts [`OVERHEAD`] and its topic in addition.
pub const MAX_ROBOT: usize = 256 << 10;
/// The maximum size of all values that a router has, its own and the copies.
pub const MAX_ROUTER: usize = 8 << 20;
/// The bytes that a value takes beside its payload and its topic.
pub const OVERHEAD: usize = 100;
/// The size from which a value travels as a bulk message, in bytes.
pub const BULK: usize = 4 << 10;
/// How long a router that has just started waits for the programs of its robot, which give it their values again. Until then, no value
/// that it does not know is regarded as forgotten.
const GRACE: Duration = Duration::from_secs(10);
