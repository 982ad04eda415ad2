//! Owns what a middleware has to be able to do to be compared.
use std::{error::Error, future::Future, net::SocketAddr, sync::Arc};

use bytes::Bytes;

use super::tally::Tally;

pub type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

/// Where the two programs meet.
#[derive(Clone, Copy, Debug)]
pub struct Meeting {
    /// Of the one who serves, or of the router or broker.
    pub address: SocketAddr,
    /// It is a router; without, the one who serves listens there. MQTT always has a broker, gRPC never.
    pub router: bool,
}

/// What becomes of a message at the one who serves.
#[derive(Clone, Copy, Debug)]
pub enum About {
    /// It is published back.
    Echo,
    /// It is counted.
    Flood,
}

/// The side that measures; and how the other side serves it.
pub trait Peer: Sized + Send + Sync + 'static {
    /// Serves as long as the program runs: publishes back, counts, and answers requests as the tally says.
    fn serve(meeting: Meeting, tally: Arc<Tally>) -> impl Future<Output = Outcome<()>> + Send;

    /// Joins, to measure.
    fn join(meeting: Meeting) -> impl Future<Output = Outcome<Self>> + Send;

    /// Publishes; waits where there is no room.
    fn publish(&self, about: About, payload: Bytes) -> impl Future<Output = Outcome<()>> + Send;

    /// The next message that was published back.
    fn next_echo(&mut self) -> impl Future<Output = Outcome<Bytes>> + Send;

    /// Asks, and waits for the answer.
    fn request(&mut self, payload: Bytes) -> impl Future<Output = Outcome<Bytes>> + Send;
}
