//! One path of a link: the frames in flight, its rate, and whether it still works.
use std::{
    collections::VecDeque,
    ops::Range,
    time::{Duration, Instant},
};

use link_lanes::lanes::{path::Path as Estimate, Lane};

use crate::rtt::Rtt;

/// How long a receiver may delay an acknowledgement, so that it covers several frames. Here, it does so by this time on
/// Bluetooth, and by less on a network, where acknowledgements cost little.
pub const ACK_DELAY: Duration = Duration::from_millis(10);
const NETWORK_ACK_DELAY: Duration = Duration::from_millis(2);
/// How long it may delay the acknowledgement of a lazy frame.
pub const LAZY_ACK_DELAY: Duration = Duration::from_secs(4);
/// Number of received bytes after which it acknowledges at once.
pub const ACK_BYTES: usize = 4096;
/// The same on a network, where each acknowledgement wakes two tasks that would have more to do otherwise.
const NETWORK_ACK_BYTES: usize = 32_768;

/// Bounds of the number of bytes in flight on a path. On a network, the lower one keeps the rate up while its round trips are much
/// longer than the shortest one.
const MIN_IN_FLIGHT_BYTES: usize = 8_192;
const NETWORK_MIN_IN_FLIGHT_BYTES: usize = 32_768;
/// See [`MIN_IN_FLIGHT_BYTES`].
pub const MAX_IN_FLIGHT_BYTES: usize = 262_144;
/// Added to twice the round trip, within which the bytes in flight should arrive: the peer's delays.
const IN_FLIGHT_MARGIN: Duration = Duration::from_millis(20);
const NETWORK_IN_FLIGHT_MARGIN: Duration = Duration::from_millis(10);
/// Number of bytes that urgent lanes may have in flight beyond that.
const URGENT_RESERVE_BYTES: usize = 4_096;
/// Number of bytes of copies that may wait for a path.
const MAX_WAITING_COPY_BYTES: u64 = 4_096;
/// The share of the rate of a Bluetooth path that copies may use.
const COPY_SHARE: f64 = 0.25;
/// Number of bytes of copies that may be sent at once.
const COPY_BURST_BYTES: f64 = 2_048.0;

/// How long a measured rate holds.
const RATE_EXPIRY: Duration = Duration::from_secs(10);

/// Time between the pings of a suspected path that answers.
const PING_INTERVAL: Duration = Duration::from_millis(60);
/// The longest time between the pings of one that does not.
const MAX_PING_INTERVAL: Duration = Duration::from_secs(2);
/// Number of answers after which a suspected path is used again.
const ANSWERS_TO_RECOVER: u32 = 4;

/// The medium of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Medium {
    /// A Bluetooth link.
    Bluetooth,
    /// A TCP connection.
    Network,
}

impl std::fmt::Display for Medium {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Bluetooth => "Bluetooth",
            Self::Network => "TCP",
        })
    }
}

impl Medium {
    /// Returns the assumed rate and round trip of a path that was not measured yet.
    fn assumed(self) -> (f64, Duration) {
        match self {
            Self::Bluetooth => (34_000.0, Duration::from_millis(60)),
            Self::Network => (1_000_000.0, Duration::from_millis(5)),
        }
    }
}

/// Whether a path is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathState {
    /// It has not answered yet.
    Untried,
    /// It is used.
    Live,
    /// Its acknowledgements are missing. It is used again once it has answered for a while.
    Suspected,
}

/// The acknowledgement covers more frames than were sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("an acknowledgement of more than was sent")]
pub struct AckError;

/// A frame in flight.
#[derive(Debug)]
pub(crate) struct Sent {
    /// The lane and the bytes of its stream; `None` for a ping.
    pub(crate) data: Option<(Lane, Range<u64>)>,
    at: Instant,
    bytes: usize,
    is_lazy: bool,
    /// Whether its bytes were handed to another path, because this one is suspected.
    is_given_up: bool,
}

/// One path of a link.
#[derive(Debug)]
pub(crate) struct Path {
    pub(crate) medium: Medium,
    /// The largest frame, in bytes.
    pub(crate) max_frame: usize,
    state: PathState,
    in_flight: VecDeque<Sent>,
    in_flight_bytes: usize,
    acked_frames: u16,
    last_ack: Instant,
    estimate: Estimate,
    /// When the rate was last measured.
    measured_at: Instant,
    rtt: Rtt,
    received_frames: u16,
    unacked_bytes: usize,
    /// When an acknowledgement is due to the peer.
    ack_at: Option<Instant>,
    /// When the next ping is due.
    ping_at: Option<Instant>,
    ping_interval: Duration,
    answers: u32,
    /// Urgent bytes that another path carries, too.
    copies: VecDeque<(Lane, Range<u64>)>,
    copy_bytes: f64,
    copy_bytes_at: Instant,
    is_close_sent: bool,
    pub(crate) sent_bytes: u64,
    pub(crate) resent_bytes: u64,
}

impl Path {
    /// Creates a path. The path on which a link is opened `is_proven`; another one has to answer first.
    pub(crate) fn new(medium: Medium, max_frame: usize, is_proven: bool, now: Instant) -> Self {
        Self {
            medium,
            max_frame,
            state: match is_proven {
                true => PathState::Live,
                false => PathState::Untried,
            },
            in_flight: VecDeque::new(),
            in_flight_bytes: 0,
            acked_frames: 0,
            last_ack: now,
            estimate: Estimate::default(),
            measured_at: now,
            rtt: Rtt::default(),
            received_frames: 0,
            unacked_bytes: 0,
            ack_at: None,
            ping_at: (!is_proven).then_some(now),
            ping_interval: PING_INTERVAL,
            answers: 0,
            copies: VecDeque::new(),
            copy_bytes: COPY_BURST_BYTES,
            copy_bytes_at: now,
            is_close_sent: false,
            sent_bytes: 0,
            resent_bytes: 0,
        }
    }

    pub(crate) fn state(&self) -> PathState {
        self.state
    }

    pub(crate) fn is_live(&self) -> bool {
        self.state == PathState::Live
    }

    /// Returns the rate, measured or assumed, in bytes per second.
    pub(crate) fn rate_bytes_per_s(&self) -> f64 {
        let (assumed, _) = self.medium.assumed();
        self.estimate.rate_bytes_per_s().unwrap_or(assumed)
    }

    /// Returns whether the rate was measured.
    pub(crate) fn is_measured(&self) -> bool {
        self.estimate.rate_bytes_per_s().is_some()
    }

    /// Returns the mean round trip, if it was measured.
    pub(crate) fn round_trip(&self) -> Option<Duration> {
        self.rtt.mean()
    }

    /// Returns the time in which the path would carry that many bytes.
    pub(crate) fn time_for(&self, bytes: usize) -> Duration {
        let (_, assumed) = self.medium.assumed();
        let round_trip = self.rtt.min().unwrap_or(assumed);
        round_trip / 2 + Duration::from_secs_f64(bytes as f64 / self.rate_bytes_per_s().max(1.0))
    }

    /// Returns whether a frame of a lane may be sent, given the bytes in flight.
    pub(crate) fn has_room(&self, is_urgent: bool) -> bool {
        let (_, assumed) = self.medium.assumed();
        let (min, margin) = match self.medium {
            Medium::Bluetooth => (MIN_IN_FLIGHT_BYTES, IN_FLIGHT_MARGIN),
            Medium::Network => (NETWORK_MIN_IN_FLIGHT_BYTES, NETWORK_IN_FLIGHT_MARGIN),
        };
        let time = self.rtt.min().unwrap_or(assumed) * 2 + margin;
        let bytes = (self.rate_bytes_per_s() * time.as_secs_f64()) as usize;
        let limit = bytes.clamp(min, MAX_IN_FLIGHT_BYTES);
        let reserve = if is_urgent { URGENT_RESERVE_BYTES } else { 0 };
        self.in_flight_bytes < limit + reserve
    }

    /// Records a frame that was sent and will be acknowledged.
    pub(crate) fn on_sent(
        &mut self,
        data: Option<(Lane, Range<u64>)>,
        bytes: usize,
        is_lazy: bool,
        now: Instant,
    ) {
        self.in_flight_bytes += bytes;
        self.sent_bytes += bytes as u64;
        self.estimate.on_sent(now);
        self.in_flight.push_back(Sent {
            data,
            at: now,
            bytes,
            is_lazy,
            is_given_up: false,
        });
    }

    /// Forgets the measured rate if it is old. A path that does not carry the bulk is not measured, and may have become faster.
    pub(crate) fn expire_rate(&mut self, now: Instant) {
        if now.saturating_duration_since(self.measured_at) > RATE_EXPIRY {
            self.estimate = Estimate::default();
            self.measured_at = now;
        }
    }

    /// Records that there is nothing to send.
    pub(crate) fn on_idle(&mut self) {
        self.estimate.on_idle();
    }

    /// Handles an acknowledgement, and returns the frames that have arrived.
    pub(crate) fn on_ack(&mut self, frames: u16, now: Instant) -> Result<Vec<Sent>, AckError> {
        let new = usize::from(frames.wrapping_sub(self.acked_frames));
        if new > self.in_flight.len() {
            return Err(AckError);
        }
        if new == 0 {
            return Ok(Vec::new());
        }
        self.acked_frames = frames;
        self.last_ack = now;
        let arrived: Vec<_> = self.in_flight.drain(..new).collect();
        let bytes: usize = arrived.iter().map(|sent| sent.bytes).sum();
        self.in_flight_bytes -= bytes;
        let last_prompt = arrived.iter().rev().find(|sent| !sent.is_lazy);
        let round_trip = last_prompt.map(|sent| now.saturating_duration_since(sent.at));
        if let (Some(round_trip), PathState::Live | PathState::Untried) = (round_trip, self.state) {
            self.rtt.add(round_trip);
        }
        if self.is_live() {
            let bytes = u32::try_from(bytes).unwrap_or(u32::MAX);
            self.estimate.on_ack(bytes, round_trip, now);
            self.measured_at = now;
        }
        self.answers += 1;
        match self.state {
            PathState::Untried => self.recover(),
            PathState::Suspected if self.answers >= ANSWERS_TO_RECOVER => self.recover(),
            PathState::Suspected => {
                self.ping_interval = PING_INTERVAL;
                self.ping_at = Some(now + PING_INTERVAL);
            }
            PathState::Live => {}
        }
        Ok(arrived)
    }

    /// Uses the path again.
    pub(crate) fn recover(&mut self) {
        self.state = PathState::Live;
        self.ping_at = None;
    }

    /// Returns whether the path has answered since it was suspected.
    pub(crate) fn has_answered(&self) -> bool {
        self.answers > 0
    }

    /// Returns when a missing acknowledgement makes the path suspect.
    pub(crate) fn suspect_at(&self) -> Option<Instant> {
        if !self.is_live() {
            return None;
        }
        Some(self.waiting_since()? + self.rtt.timeout(ACK_DELAY))
    }

    /// Returns since when an acknowledgement is missing; `None` if none is awaited.
    pub(crate) fn waiting_since(&self) -> Option<Instant> {
        let oldest = self.in_flight.iter().find(|sent| !sent.is_lazy)?;
        Some(oldest.at.max(self.last_ack))
    }

    /// Suspects the path.
    pub(crate) fn suspect(&mut self, now: Instant) {
        self.state = PathState::Suspected;
        // The rate from before does not hold afterwards.
        self.estimate = Estimate::default();
        self.answers = 0;
        self.ping_interval = PING_INTERVAL;
        self.ping_at = Some(now);
        self.copies.clear();
    }

    /// Returns what was sent and not acknowledged, unless it was returned before.
    pub(crate) fn give_up(&mut self) -> Vec<(Lane, Range<u64>)> {
        let unanswered = self.in_flight.iter_mut().filter(|sent| !sent.is_given_up);
        unanswered
            .filter_map(|sent| {
                sent.is_given_up = true;
                sent.data.clone()
            })
            .collect()
    }

    /// Returns when the next ping is due.
    pub(crate) fn ping_at(&self) -> Option<Instant> {
        self.ping_at
    }

    /// Records a ping.
    pub(crate) fn on_ping_sent(&mut self, bytes: usize, now: Instant) {
        self.on_sent(None, bytes, false, now);
        self.ping_at = Some(now + self.ping_interval);
        self.ping_interval = (self.ping_interval * 2).min(MAX_PING_INTERVAL);
    }

    /// Handles a received frame that is acknowledged.
    pub(crate) fn on_received(&mut self, bytes: usize, is_lazy: bool, now: Instant) {
        self.received_frames = self.received_frames.wrapping_add(1);
        self.unacked_bytes += bytes;
        let (max_bytes, delay) = match self.medium {
            Medium::Bluetooth => (ACK_BYTES, ACK_DELAY),
            Medium::Network => (NETWORK_ACK_BYTES, NETWORK_ACK_DELAY),
        };
        let delay = match is_lazy {
            true => LAZY_ACK_DELAY,
            false if self.unacked_bytes >= max_bytes => Duration::ZERO,
            false => delay,
        };
        self.ack_by(now + delay);
    }

    /// Makes an acknowledgement due at that time, unless one is due earlier.
    pub(crate) fn ack_by(&mut self, at: Instant) {
        self.ack_at = Some(self.ack_at.map_or(at, |earlier| earlier.min(at)));
    }

    /// Returns when the next acknowledgement is due.
    pub(crate) fn ack_at(&self) -> Option<Instant> {
        self.ack_at
    }

    /// Records that an acknowledgement was sent, and returns its number of frames.
    pub(crate) fn on_ack_sent(&mut self) -> u16 {
        self.ack_at = None;
        self.unacked_bytes = 0;
        self.received_frames
    }

    /// Adds urgent bytes that another path carries, too.
    pub(crate) fn add_copy(&mut self, lane: Lane, range: Range<u64>) {
        self.copies.push_back((lane, range));
        let mut waiting: u64 = self
            .copies
            .iter()
            .map(|(_, range)| range.end - range.start)
            .sum();
        while waiting > MAX_WAITING_COPY_BYTES {
            let Some((_, oldest)) = self.copies.pop_front() else {
                break;
            };
            waiting -= oldest.end - oldest.start;
        }
    }

    /// Returns the next copy of a lane, without those that have arrived.
    pub(crate) fn next_copy(
        &mut self,
        lane: Lane,
        has_arrived: impl Fn(&Range<u64>) -> bool,
    ) -> Option<Range<u64>> {
        self.copies
            .retain(|(of, range)| *of != lane || !has_arrived(range));
        let found = self.copies.iter().find(|(of, _)| *of == lane);
        found.map(|(_, range)| range.clone())
    }

    /// Returns whether a copy of that size may be sent now.
    pub(crate) fn may_copy(&mut self, bytes: usize, now: Instant) -> bool {
        if self.medium == Medium::Network {
            return true;
        }
        let since = now.saturating_duration_since(self.copy_bytes_at);
        let earned = since.as_secs_f64() * self.rate_bytes_per_s() * COPY_SHARE;
        self.copy_bytes = (self.copy_bytes + earned).min(COPY_BURST_BYTES);
        self.copy_bytes_at = now;
        self.copy_bytes >= bytes as f64
    }

    /// Records a copy that was sent.
    pub(crate) fn on_copy_sent(&mut self, lane: Lane, range: &Range<u64>) {
        self.copies.retain(|copy| *copy != (lane, range.clone()));
        self.copy_bytes -= (range.end - range.start) as f64;
    }

    /// Returns whether the goodbye is sent now, for the first time.
    pub(crate) fn start_close(&mut self) -> bool {
        !std::mem::replace(&mut self.is_close_sent, true)
    }

    /// Returns whether the goodbye was sent.
    pub(crate) fn is_close_sent(&self) -> bool {
        self.is_close_sent
    }
}

#[cfg(test)]
mod states;
