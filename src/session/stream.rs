//! Connects streams to Zenoh: [`Stream`] sends, [`Watch`] receives. Their logic is in [`crate::core::stream`].
mod receiver;
mod sender;

pub use receiver::{Frame, Watch};
pub use sender::Stream;
