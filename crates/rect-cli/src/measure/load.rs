//! Sends a load to the other robot, as fast as the link carries it.
use std::{sync::Arc, time::Duration};

use rect::{Name, Payload, Robot, ToPayload, Urgency};
use tokio::{
    sync::Semaphore,
    time::{timeout, timeout_at},
};

/// The topic of the load.
pub const LOAD: &str = "rect-bench/load";
/// The topic on which the receiver acknowledges the load.
pub const ACKNOWLEDGEMENT: &str = "rect-bench/more";
/// Largest number of bytes of the load in flight: they fill any link between robots, and are transmitted within 2 s over the
/// slowest one. Without a limit, the queues hold some 20 MB.
const WINDOW_BYTES: usize = 65_536;
/// Number of bytes that one acknowledgement covers.
pub const ACKNOWLEDGED_BYTES: usize = 8192;
/// Largest size of a message of the load, in bytes.
pub const MAX_BYTES: usize = 16_000;
/// Time without an acknowledgement after which half of the window counts as lost.
const LOST_AFTER: Duration = Duration::from_secs(2);

/// Sends messages of `bytes` for `duration`, and returns their number.
pub async fn send(
    robot: &Robot,
    other: &Name,
    bytes: usize,
    duration: Duration,
) -> Result<u64, rect::Error> {
    let bytes = bytes.clamp(1, MAX_BYTES);
    let bulk = robot.with_urgency(Urgency::Bulk);
    let window = Arc::new(Semaphore::new(WINDOW_BYTES));
    let acknowledged = window.clone();
    let pattern = format!("{other}/{ACKNOWLEDGEMENT}");
    let _acknowledgements = robot
        .on_message::<Payload>(pattern.as_str(), move |_| {
            acknowledged.add_permits(ACKNOWLEDGED_BYTES);
        })
        .await?;
    let end = tokio::time::Instant::now() + duration;
    let mut sent = 0;
    // Messages that are lost over UDP are never acknowledged.
    while tokio::time::Instant::now() < end {
        let permits = timeout(LOST_AFTER, window.acquire_many(bytes as u32));
        match timeout_at(end, permits).await {
            Ok(Ok(Ok(permits))) => permits.forget(),
            Ok(Ok(Err(_closed))) => break,
            Ok(Err(_)) => {
                window.add_permits(WINDOW_BYTES / 2);
                continue;
            }
            Err(_elapsed) => break,
        }
        send_or_lose(&bulk, other, LOAD, vec![0u8; bytes]).await?;
        sent += 1;
    }
    Ok(sent)
}

/// Sends a message that is lost if the robot is not reachable now, as it would be on the way.
pub async fn send_or_lose(
    robot: &Robot,
    other: &Name,
    topic: &str,
    value: impl ToPayload,
) -> Result<(), rect::Error> {
    match robot.send(other, topic, value).await {
        Err(rect::Error::NotReachable { .. }) => Ok(()),
        sent => sent,
    }
}
