//! The connections file of RECT's router: lists the connections to dial, and may set the rule for automatic ones.
//!
//! [`file`] parses it, [`spec`] validates each connection, and [`option_files`] checks the files that its options name.
mod auto_connect;
pub mod file;
pub mod option_files;
pub mod spec;

pub use self::auto_connect::{AutoConnect, AutoConnectRule, MAX_AUTO_LINKS};
