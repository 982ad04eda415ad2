//! Connects streams to Zenoh: [`Stream`] sends, [`Watch`] receives. Their logic is in [`rect_core::stream`].
mod receiver;
mod sender;

pub use receiver::Watch;
pub use rect_core::stream::frame::Frame;
pub use sender::Stream;
