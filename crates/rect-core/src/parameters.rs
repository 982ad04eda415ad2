//! Parameters: values of a program that people tune while it runs, such as a gain or a speed limit.
//!
//! A program declares a [`group`] of them, with default, range and unit ([`declaration`]). The declaration stands in the catalogue. The
//! values are a retained message on the topic `parameters/<group>`, so that they are read, recorded and plotted as any state. They are
//! changed by a request ([`order`]) to an internal key of the robot, which access control grants separately, and kept in a [`file`] that
//! people can read.
pub mod declaration;
pub mod file;
pub mod group;
pub mod order;
#[cfg(test)]
mod tests;
pub mod value;
mod values;

pub use declaration::{Declaration, DeclarationError, Parameter};
pub use group::{Change, Changed, Group};
pub use value::Value;
pub use values::Values;

pub use crate::name::parameter::{is_name, wrong_name, MAX_NAME};

/// The part of a topic that precedes the name of a group.
pub const TOPIC: &str = "parameters";
/// The maximum number of parameters in a group.
pub const MAX_PARAMETERS: usize = 256;
/// The maximum length of a description, in characters. Longer ones of services are cut.
pub const MAX_ABOUT: usize = 200;
/// The maximum length of a text, in bytes.
pub const MAX_TEXT: usize = 4 << 10;
/// The maximum number of elements of a list of numbers.
pub const MAX_NUMBERS: usize = 256;
/// The maximum size of all values of a group, in bytes.
pub const MAX_BYTES: usize = 32 << 10;

/// Returns the topic of the values of a group.
pub fn topic(group: &str) -> String {
    format!("{TOPIC}/{group}")
}

/// Returns the error that a text cannot name a group.
pub fn wrong_group(group: &str) -> String {
    wrong_name(group, "the name of a group")
}
