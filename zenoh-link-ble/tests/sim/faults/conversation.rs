//! Runs a fixed conversation over a link: batches of many sizes on four lanes in both directions, then a close. Each
//! side records the received batches, so that they can be compared with the sent ones however the conversation ended.
use futures::future::join_all;
use tokio::time::{timeout, Duration};
use zenoh_link_ble::locator::DEFAULT_MTU;
use zenoh_link_commons::LinkUnicast;
use zenoh_protocol::core::Priority;

use crate::shared::pair::Pair;

const LANES: [Priority; 4] = [
    Priority::Control,
    Priority::InteractiveHigh,
    Priority::Data,
    Priority::Background,
];
/// Sizes of the batches of a lane, in bytes: a small part of a packet, the maximum, almost a whole packet, another
/// small part, several packets.
const SIZES: [usize; 5] = [5, DEFAULT_MTU as usize, 237, 20, 600];

/// Batches received by one side, by lane.
pub type Received = Vec<Vec<Vec<u8>>>;

/// Result of a conversation.
pub struct Outcome {
    /// Batches received by each side if there was a link: those of `near`, then those of `far`.
    pub received: [Received; 2],
    /// Reasons for the end of the links, as returned to every reader and writer.
    pub reasons: Vec<String>,
    /// Whether everything was exchanged and the link was closed in order.
    pub is_whole: bool,
}

/// Returns the `n`th batch of a lane from one side. All batches differ.
fn batch(from: u8, lane: usize, n: usize) -> Vec<u8> {
    let mut batch = vec![from, lane as u8, n as u8];
    batch.resize(SIZES[n], from ^ (lane * 16 + n) as u8);
    batch
}

/// Returns the batches that a side sends on each lane.
pub fn sent(from: u8) -> Received {
    let lane = |lane| (0..SIZES.len()).map(|n| batch(from, lane, n)).collect();
    (0..LANES.len()).map(lane).collect()
}

type Side = (Received, Vec<String>, bool);

/// Dials, exchanges all batches and closes.
pub async fn converse(pair: &Pair) -> Outcome {
    let dialling = async {
        // Shorter than the default of Zenoh, to save time when a fault prevents the dial.
        match pair.near.dial("ble/far#timeout=5000").await {
            Ok(near) => talk(&near, 0, true).await,
            Err(error) => (Vec::new(), vec![error.to_string()], false),
        }
    };
    let answering = async {
        // Longer than the timeout of the dial: a link that arrives later belongs to the next dial.
        match timeout(Duration::from_secs(6), pair.far.incoming()).await {
            Ok(far) => talk(&far, 1, false).await,
            Err(_) => (Vec::new(), Vec::new(), false),
        }
    };
    outcome(tokio::join!(dialling, answering))
}

/// Runs the conversation on an existing link.
pub async fn converse_on(near: &LinkUnicast, far: &LinkUnicast) -> Outcome {
    outcome(tokio::join!(talk(near, 0, true), talk(far, 1, false)))
}

fn outcome((near, far): (Side, Side)) -> Outcome {
    let ((near_got, mut reasons, near_whole), (far_got, far_reasons, far_whole)) = (near, far);
    reasons.extend(far_reasons);
    Outcome {
        received: [near_got, far_got],
        reasons,
        is_whole: near_whole && far_whole,
    }
}

/// Runs one side: sends all batches and reads until the link ends, or until everything has arrived if it is the side
/// that closes.
async fn talk(link: &LinkUnicast, from: u8, closes: bool) -> Side {
    let writing = join_all(LANES.iter().enumerate().map(async |(lane, priority)| {
        for n in 0..SIZES.len() {
            let batch = batch(from, lane, n);
            if let Err(error) = link.write_all(&batch, Some(*priority)).await {
                return Some(error.to_string());
            }
        }
        None
    }));
    let expected = if closes { SIZES.len() } else { usize::MAX };
    let reading = join_all(LANES.iter().map(async |priority| {
        let mut received = Vec::new();
        let mut buffer = [0; 1000];
        while received.len() < expected {
            match link.read(&mut buffer, Some(*priority)).await {
                Ok(size) => received.push(buffer[..size].to_vec()),
                Err(error) => return (received, Some(error.to_string())),
            }
        }
        (received, None)
    }));
    let (written, read) = tokio::join!(writing, reading);
    let (received, read_errors): (Received, Vec<_>) = read.into_iter().unzip();
    let mut errors: Vec<_> = written.into_iter().chain(read_errors).flatten().collect();
    link.close().await.expect("closing never fails");
    let is_whole = received == sent(1 - from) && (errors.is_empty() || !closes);
    errors.dedup();
    (received, errors, is_whole)
}
