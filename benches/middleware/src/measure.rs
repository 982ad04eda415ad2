//! Runs the jobs of the bench, and counts.
use std::time::{Duration, Instant};

use bytes::Bytes;
use clap::ValueEnum;
use serde_json::{json, Value};
use tokio::time::{sleep, timeout, MissedTickBehavior};

use super::{
    arrivals::{Counted, COUNT, RESET},
    counting::CountingProxy,
    peer::{About, Meeting, Outcome, Peer},
};

#[derive(Clone, Copy, Debug, ValueEnum)]
pub enum Job {
    /// Round-trip times of a message and its echo, in microseconds.
    Publish,
    /// Times from requests until their replies, in microseconds.
    Request,
    /// Messages per second in one direction, as fast as possible without loss.
    Flood,
    /// Bytes on the TCP connection of the measuring program, in both directions: per message, and per request with its reply.
    Bytes,
}

/// The size of the messages, and the duration of the measurement.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    pub bytes: usize,
    pub span: Duration,
}

/// How long the two programs may take to discover each other.
const TIMEOUT: Duration = Duration::from_secs(15);
/// The time until measurements count, so that caches, allocators and windows have reached their sizes.
const WARM_UP: Duration = Duration::from_millis(300);
/// How long a message in flight may take.
const SETTLED: Duration = Duration::from_millis(200);
/// The pause between messages, long enough that no two share a packet.
const PACE: Duration = Duration::from_millis(5);
const PACED: u32 = 200;

pub async fn run<P: Peer>(job: Job, meeting: Meeting, load: Load) -> Outcome<Value> {
    match job {
        Job::Publish => {
            let mut peer = joined::<P>(meeting).await?;
            let mut times = Times::default();
            wait_for_echo(&mut peer, load.bytes).await?;
            while times.go_on(load.span) {
                let number = times.count;
                let sent = Instant::now();
                echoed(&mut peer, numbered(load.bytes, number)).await?;
                times.on_time(sent.elapsed());
            }
            Ok(times.figures())
        }
        Job::Request => {
            let mut peer = joined::<P>(meeting).await?;
            let mut times = Times::default();
            while times.go_on(load.span) {
                let payload = numbered(load.bytes, times.count);
                let sent = Instant::now();
                let answer = peer.request(payload.clone()).await?;
                times.on_time(sent.elapsed());
                if answer != payload {
                    return Err("the reply belongs to another request".into());
                }
            }
            Ok(times.figures())
        }
        Job::Flood => flood(&mut joined::<P>(meeting).await?, load).await,
        Job::Bytes => bytes::<P>(meeting, load.bytes).await,
    }
}

/// Joins, and waits until requests are answered.
async fn joined<P: Peer>(meeting: Meeting) -> Outcome<P> {
    let mut peer = P::join(meeting).await?;
    let asked = Instant::now();
    loop {
        let answered = timeout(SETTLED, peer.request(Bytes::from_static(RESET))).await;
        match answered {
            Ok(Ok(_)) => return Ok(peer),
            _ if asked.elapsed() < TIMEOUT => sleep(Duration::from_millis(20)).await,
            Ok(Err(error)) => return Err(error),
            Err(_) => return Err("requests are not answered".into()),
        }
    }
}

async fn wait_for_echo<P: Peer>(peer: &mut P, bytes: usize) -> Outcome<()> {
    let asked = Instant::now();
    while asked.elapsed() < TIMEOUT {
        let payload = numbered(bytes, u64::MAX);
        if let Ok(echoed) = timeout(SETTLED, echoed(peer, payload)).await {
            return echoed;
        }
    }
    Err("messages are not echoed".into())
}

/// Publishes a message and waits for its echo. Ignores the echoes of earlier messages.
async fn echoed<P: Peer>(peer: &mut P, payload: Bytes) -> Outcome<()> {
    peer.publish(About::Echo, payload.clone()).await?;
    while peer.next_echo().await? != payload {}
    Ok(())
}

async fn flood<P: Peer>(peer: &mut P, load: Load) -> Outcome<Value> {
    wait_for_count(peer, load.bytes).await?;
    let started = Instant::now();
    let mut sent = 0;
    while started.elapsed() < load.span {
        peer.publish(About::Flood, numbered(load.bytes, sent))
            .await?;
        sent += 1;
    }
    let mut counted = count(peer).await?;
    let mut grew = Instant::now();
    while counted.count < sent && grew.elapsed() < Duration::from_secs(2) {
        sleep(Duration::from_millis(5)).await;
        let now = count(peer).await?;
        if now.count > counted.count {
            grew = Instant::now();
        }
        counted = now;
    }
    let per_s = counted.count.saturating_sub(1) as f64 / counted.span.as_secs_f64();
    Ok(json!({"messages_per_s": per_s, "sent": sent, "lost": sent.saturating_sub(counted.count)}))
}

/// Waits until messages are counted, then resets the count.
async fn wait_for_count<P: Peer>(peer: &mut P, bytes: usize) -> Outcome<()> {
    let asked = Instant::now();
    while count(peer).await?.count == 0 {
        if asked.elapsed() > TIMEOUT {
            return Err("messages are not counted".into());
        }
        peer.publish(About::Flood, numbered(bytes, 0)).await?;
        sleep(Duration::from_millis(20)).await;
    }
    sleep(SETTLED).await;
    peer.request(Bytes::from_static(RESET)).await?;
    Ok(())
}

async fn count<P: Peer>(peer: &mut P) -> Outcome<Counted> {
    let answer = timeout(TIMEOUT, peer.request(Bytes::from_static(COUNT))).await??;
    Ok(serde_json::from_slice(&answer)?)
}

async fn bytes<P: Peer>(meeting: Meeting, bytes: usize) -> Outcome<Value> {
    let proxy = CountingProxy::before(meeting.address).await?;
    let address = proxy.address;
    let mut peer = joined::<P>(Meeting { address, ..meeting }).await?;
    wait_for_count(&mut peer, bytes).await?;
    let mut pace = tokio::time::interval(PACE);
    pace.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut passed = Vec::new();
    sleep(SETTLED).await;
    passed.push(proxy.bytes());
    for number in 0..PACED {
        pace.tick().await;
        peer.publish(About::Flood, numbered(bytes, number.into()))
            .await?;
    }
    sleep(SETTLED).await;
    passed.push(proxy.bytes());
    for number in 0..PACED {
        pace.tick().await;
        peer.request(numbered(bytes, number.into())).await?;
    }
    sleep(SETTLED).await;
    passed.push(proxy.bytes());
    let each = |n: usize| (passed[n + 1] - passed[n]) as f64 / f64::from(PACED);
    Ok(json!({"bytes_per_message": each(0), "bytes_per_request": each(1)}))
}

/// Creates payloads that differ by their number.
fn numbered(bytes: usize, number: u64) -> Bytes {
    let mut payload = vec![0; bytes.max(8)];
    payload[..8].copy_from_slice(&number.to_le_bytes());
    payload.into()
}

/// The measured times, after the warm-up.
#[derive(Default)]
struct Times {
    started: Option<Instant>,
    count: u64,
    us: Vec<f64>,
}

impl Times {
    fn go_on(&mut self, span: Duration) -> bool {
        self.started.get_or_insert_with(Instant::now).elapsed() < WARM_UP + span
    }

    fn on_time(&mut self, time: Duration) {
        self.count += 1;
        if self.started.is_some_and(|at| at.elapsed() > WARM_UP) {
            let us = time.as_secs_f64() * 1e6;
            self.us.push((us * 10.0).round() / 10.0);
        }
    }

    fn figures(&self) -> Value {
        json!({"times_us": self.us})
    }
}
