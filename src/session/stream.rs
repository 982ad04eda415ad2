//! Owns streams as a program has them: [`Stream`] sends, [`Watch`] receives. What they do, [`crate::core::stream`] says.
mod receiver;
mod sender;

pub use receiver::{Frame, Watch};
pub use sender::Stream;
