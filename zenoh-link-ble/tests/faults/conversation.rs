//! A fixed conversation over a link: batches of many sizes on four lanes both ways, then a close. Each side writes down
//! what it got, so that what was delivered can be compared with what was sent, however the conversation ended.
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
/// The batches of a lane, in bytes: alone in a packet, in one packet exactly, in several, the largest.
const SIZES: [usize; 5] = [5, DEFAULT_MTU as usize, 237, 20, 600];

/// The batches that one side got on each lane.
pub type Got = Vec<Vec<Vec<u8>>>;

/// How a conversation ended.
pub struct Outcome {
    /// What each side got, if there was a link: `near`'s, then `far`'s.
    pub got: [Got; 2],
    /// Why each side's link ended: every reason that a reader or writer was told.
    pub reasons: Vec<String>,
    /// Whether all was said, and the close went through.
    pub is_whole: bool,
}

/// The `n`th batch of a lane from one side: nobody else's.
fn batch(from: u8, lane: usize, n: usize) -> Vec<u8> {
    let mut batch = vec![from, lane as u8, n as u8];
    batch.resize(SIZES[n], from ^ (lane * 16 + n) as u8);
    batch
}

/// All that a side sends on each lane.
pub fn sent(from: u8) -> Got {
    let lane = |lane| (0..SIZES.len()).map(|n| batch(from, lane, n)).collect();
    (0..LANES.len()).map(lane).collect()
}

type Side = (Got, Vec<String>, bool);

/// Dials, talks and closes.
pub async fn held(pair: &Pair) -> Outcome {
    let dialling = async {
        // A dial that a fault meets is given up by Zenoh's own limit at the latest; here sooner, as time is short.
        match pair.near.dials("ble/far#timeout=5000").await {
            Ok(near) => talk(&near, 0, true).await,
            Err(error) => (Vec::new(), vec![error.to_string()], false),
        }
    };
    let answering = async {
        // Longer than a dial may take: what comes in after it belongs to the dial.
        match timeout(Duration::from_secs(6), pair.far.incoming()).await {
            Ok(far) => talk(&far, 1, false).await,
            Err(_) => (Vec::new(), Vec::new(), false),
        }
    };
    outcome(tokio::join!(dialling, answering))
}

/// The same on a link that is there.
pub async fn held_on(near: &LinkUnicast, far: &LinkUnicast) -> Outcome {
    outcome(tokio::join!(talk(near, 0, true), talk(far, 1, false)))
}

fn outcome((near, far): (Side, Side)) -> Outcome {
    let ((near_got, mut reasons, near_whole), (far_got, far_reasons, far_whole)) = (near, far);
    reasons.extend(far_reasons);
    Outcome {
        got: [near_got, far_got],
        reasons,
        is_whole: near_whole && far_whole,
    }
}

/// One side of it: says everything and reads until the end, or until it has all when it is the one to close.
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
    let wanted = if closes { SIZES.len() } else { usize::MAX };
    let reading = join_all(LANES.iter().map(async |priority| {
        let mut got = Vec::new();
        let mut buffer = [0; 1000];
        while got.len() < wanted {
            match link.read(&mut buffer, Some(*priority)).await {
                Ok(size) => got.push(buffer[..size].to_vec()),
                Err(error) => return (got, Some(error.to_string())),
            }
        }
        (got, None)
    }));
    let (written, read) = tokio::join!(writing, reading);
    let (got, read_errors): (Got, Vec<_>) = read.into_iter().unzip();
    let mut errors: Vec<_> = written.into_iter().chain(read_errors).flatten().collect();
    link.close().await.expect("closing never fails");
    let is_whole = got == sent(1 - from) && (errors.is_empty() || !closes);
    errors.dedup();
    (got, errors, is_whole)
}
