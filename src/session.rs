//! The upper storey: sessions on zenoh. They move what the [core](crate::core) says, and decide nothing.
mod decoder;
mod inbox;
mod lanes;
mod opening;
mod options;
mod publication;
mod registry;
mod request;
mod robot;
mod service;
mod state;
mod stream;
mod subscriber;
mod transfer;

pub use options::Options;
pub use request::{Replies, Reply};
pub use robot::{connect, Robot};
pub use service::{Request, Requests, Service};
pub use state::Events;
pub use stream::{Frame, Stream, Watch};
pub(crate) use subscriber::called;
pub use subscriber::{Receiving, Subscriber, Subscription};
pub use transfer::{
    Incoming, Keep, ReceiveTransfers, Received, Transfer, TransferSource, Transfers,
};
