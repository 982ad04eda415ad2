//! The side of a measurement that replies: it returns requests, and counts, acknowledges and sends loads.
use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use rect::{Json, Name, Payload, Robot, Service, Subscriber, ToPayload};
use serde::{de::DeserializeOwned, Deserialize, Serialize};
use tokio::{sync::watch, task::JoinHandle};

use super::{
    load::{self, ACKNOWLEDGED_BYTES, ACKNOWLEDGEMENT, LOAD},
    not_served,
};
use crate::Failure;

/// The service that returns its request.
pub const ECHO: &str = "rect-bench/echo";
const COUNT: &str = "rect-bench/count";
const SEND: &str = "rect-bench/send";
/// How long the routers may take to learn of the services.
const ESTABLISHED: Duration = Duration::from_secs(5);
/// Timeout of a request.
pub const TIMEOUT: Duration = Duration::from_secs(10);
/// The longest load that another robot may request.
const MAX_LOAD: Duration = Duration::from_secs(60);

/// The load that a robot has received.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct ReceivedLoad {
    pub messages: u64,
    pub bytes: u64,
    /// Time since the last message arrived, in seconds.
    pub last_ago_s: f64,
}

/// A load that another robot requests.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
struct RequestedLoad {
    bytes: usize,
    seconds: f64,
}

/// Replies until it is dropped.
pub struct Partner {
    received: Arc<watch::Sender<(ReceivedLoad, Instant)>>,
    _services: [Service; 3],
    counting: JoinHandle<Result<(), rect::Error>>,
}

impl Partner {
    /// Begins to reply, and waits until the other robots know it.
    pub async fn serve(robot: &Robot) -> Result<Self, Failure> {
        let received = Arc::new(watch::Sender::new((
            ReceivedLoad::default(),
            Instant::now(),
        )));
        let load = robot.subscribe(format!("*/{LOAD}").as_str()).await?;
        let counting = tokio::spawn(count_load(robot.clone(), load, received.clone()));
        let echo = robot.serve(ECHO, |request| async move {
            Ok::<_, String>(request.payload.clone())
        });
        let counts = received.clone();
        let count = robot.serve(COUNT, move |_| {
            let counts = counts.clone();
            async move { Ok::<_, String>(Json(so_far(&counts))) }
        });
        let sending = robot.clone();
        let send = robot.serve(SEND, move |request| {
            let (robot, to) = (sending.clone(), request.sender.clone());
            let requested = request.payload.value::<RequestedLoad>();
            async move {
                let RequestedLoad { bytes, seconds } = requested.map_err(|e| e.to_string())?;
                let to = to.ok_or("the load is sent to the robot that requests it")?;
                let duration = Duration::try_from_secs_f64(seconds).map_err(|e| e.to_string())?;
                let sent = load::send(&robot, &to, bytes, duration.min(MAX_LOAD)).await;
                sent.map(Json).map_err(|error| error.to_string())
            }
        });
        let services = [echo.await?, count.await?, send.await?];
        // A router that does not answer in time does not prevent a measurement with another one.
        match robot.wait_until_established(ESTABLISHED).await {
            Ok(()) | Err(rect::Error::TimedOut { .. }) => {}
            Err(error) => return Err(error.into()),
        }
        Ok(Self {
            received,
            _services: services,
            counting,
        })
    }

    /// Returns the load that this robot has received so far.
    pub fn received(&self) -> ReceivedLoad {
        so_far(&self.received)
    }

    /// Replies until the session ends.
    pub async fn run(mut self) -> Result<(), Failure> {
        Ok((&mut self.counting).await??)
    }
}

impl Drop for Partner {
    fn drop(&mut self) {
        self.counting.abort();
    }
}

fn so_far(received: &watch::Sender<(ReceivedLoad, Instant)>) -> ReceivedLoad {
    let (load, last) = *received.borrow();
    ReceivedLoad {
        last_ago_s: last.elapsed().as_secs_f64(),
        ..load
    }
}

/// Counts the load, and acknowledges it to the robot that sends.
async fn count_load(
    robot: Robot,
    load: Subscriber,
    received: Arc<watch::Sender<(ReceivedLoad, Instant)>>,
) -> Result<(), rect::Error> {
    let mut unacknowledged = 0;
    while let Some(message) = load.next().await {
        let bytes = message.payload.bytes.len();
        received.send_modify(|(received, last)| {
            received.messages += 1;
            received.bytes += bytes as u64;
            *last = Instant::now();
        });
        unacknowledged += bytes;
        while unacknowledged >= ACKNOWLEDGED_BYTES {
            unacknowledged -= ACKNOWLEDGED_BYTES;
            load::send_or_lose(&robot, &message.sender, ACKNOWLEDGEMENT, "").await?;
        }
    }
    Ok(())
}

/// Requests the load that the other robot has received so far.
pub async fn count(robot: &Robot, other: &Name) -> Result<ReceivedLoad, Failure> {
    request(robot, other, COUNT, "", TIMEOUT).await
}

/// Lets the other robot send a load to this one, and returns the number of its messages.
pub async fn request_load(
    robot: &Robot,
    other: &Name,
    bytes: usize,
    duration: Duration,
) -> Result<u64, Failure> {
    let seconds = duration.as_secs_f64();
    let requested = Json(RequestedLoad { bytes, seconds });
    request(robot, other, SEND, requested, duration + TIMEOUT).await
}

async fn request<T: DeserializeOwned>(
    robot: &Robot,
    other: &Name,
    service: &str,
    value: impl ToPayload,
    timeout: Duration,
) -> Result<T, Failure> {
    let reply = robot
        .with_timeout(timeout)
        .request::<Payload>(other, service, value)
        .await;
    let reply = reply.map_err(|error| not_served(other, &error))?;
    Ok(reply.payload.value()?)
}
