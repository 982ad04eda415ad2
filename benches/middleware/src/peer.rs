//! Defines the operations that each compared middleware implements.
use std::{error::Error, future::Future, net::SocketAddr, sync::Arc};

use bytes::Bytes;

use super::arrivals::ArrivalCounter;

pub type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// The address at which the two programs meet.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// The address of the serving program, or of the router or broker.
    pub address: SocketAddr,
    /// Whether it is the address of a router or broker; otherwise the serving program listens there. MQTT always has a broker,
    /// gRPC never.
    pub router: bool,
}

/// How the serving program treats a message.
#[derive(Clone, Copy, Debug)]
pub enum About {
    /// It publishes the message back.
    Echo,
    /// It counts the message.
    Flood,
}

/// A middleware. A value of this type is the measuring side; `serve` runs the other side.
pub trait Peer: Sized + Send + Sync + 'static {
    /// Serves as long as the program runs: echoes messages, counts them with `arrivals`, and answers requests.
    fn serve(
        meeting: Meeting,
        arrivals: Arc<ArrivalCounter>,
    ) -> impl Future<Output = Outcome<()>> + Send;

    /// Joins as the measuring side.
    fn join(meeting: Meeting) -> impl Future<Output = Outcome<Self>> + Send;

    /// Publishes a message. Waits while the send queue is full.
    fn publish(&self, about: About, payload: Bytes) -> impl Future<Output = Outcome<()>> + Send;

    /// Returns the next echo.
    fn next_echo(&mut self) -> impl Future<Output = Outcome<Bytes>> + Send;

    /// Sends a request, and returns the reply.
    fn request(&mut self, payload: Bytes) -> impl Future<Output = Outcome<Bytes>> + Send;
}
