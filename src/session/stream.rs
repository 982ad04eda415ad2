//! Connects streams to Zenoh: [`Stream`] sends, [`Watch`] receives. Their logic is in [`crate::core::stream`].
mod receiver;
mod sender;

pub use crate::core::stream::frame::Frame;
pub use receiver::Watch;
pub use sender::Stream;
