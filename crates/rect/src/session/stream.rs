//! Connects streams to Zenoh: [`StreamSender`] sends, [`Watcher`] receives. Their logic is in [`rect_core::stream`].
mod receiver;
mod sender;

pub use receiver::Watcher;
pub use rect_core::stream::frame::Frame;
pub use sender::StreamSender;
