//! Implements the receiver of a stream: decides which frames are new, how old they are, what was skipped, which group
//! to subscribe to, and what to report to the sender.
use std::time::{Duration, Instant};

use super::{
    feedback::Feedback, notice::Notice, offset::Offset, options::FEEDBACK_INTERVAL, Group,
};
use crate::{
    message::attachment::{Attachment, Sent},
    name::Name,
};

/// If the sender does not reply within this time, it is assumed not to use RECT, and to publish its frames on the key
/// of the main group.
const FOREIGN_AFTER: Duration = Duration::from_millis(1500);
/// The feedback interval while no frames arrive.
const IDLE: Duration = Duration::from_secs(2);
/// The pause before an unanswered query to the sender is repeated. For a receiver older than 4 s, it is five times as
/// long.
const QUERY_RETRY: Duration = Duration::from_secs(1);
/// The pause after each of the first replies. Several queries make it likely that one of the replies is fast.
const FIRST_QUERY_INTERVAL: Duration = Duration::from_millis(400);
const FIRST_QUERIES: u32 = 4;
/// The pause after each later reply.
const QUERY_INTERVAL: Duration = Duration::from_secs(15);
/// A frame of another source is dropped if it was sent at most this long before the newest frame: it belongs to the
/// group that the receiver has left.
const OVERTAKEN_MS: i16 = -2000;
/// The pause before the sender is asked for a key frame again.
const ASK_FOR_KEY: Duration = Duration::from_millis(500);
/// The shortest time in transit that the clocks can resolve.
const SHORTEST: Duration = Duration::from_millis(1);
/// The minimum size of frames that the pace is measured with. Smaller frames take as long as any message.
const MIN_PACED_BYTES: usize = 500;
/// The maximum number of frames per report whose age is used.
const MAX_AGES: usize = 1024;

/// A frame that the program receives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Sequence number of the frame.
    pub number: u32,
    /// Age of the frame. Until the offset of the clocks is known, its delay relative to the fastest frame of the last
    /// minute. `None` for a frame of a program that does not use RECT.
    pub age: Option<Duration>,
    /// Number of frames between the previous one and this one that did not arrive.
    pub skipped: u32,
    /// Whether the numbers begin again: the sender was restarted, or the receiver belongs to another group.
    pub is_restarted: bool,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    source: u16,
    number: u32,
    sent: Option<u16>,
    arrived_at: Instant,
}

/// The frames since the last feedback.
#[derive(Debug)]
struct Span {
    since: Instant,
    frames: u32,
    bytes: u32,
    skipped: u32,
    ages_ms: Vec<u32>,
    /// Frames whose time in transit is known: their bytes, and how long they occupied the link.
    paced_bytes: f64,
    busy: Duration,
}

impl Span {
    fn new(since: Instant) -> Self {
        Self {
            since,
            frames: 0,
            bytes: 0,
            skipped: 0,
            ages_ms: Vec::new(),
            paced_bytes: 0.0,
            busy: Duration::ZERO,
        }
    }
}

/// The receiver of one stream in one program.
#[derive(Debug)]
pub struct Receiver {
    robot: Name,
    id: u16,
    created_at: Instant,
    group: Option<Group>,
    offset: Offset,
    replies: u32,
    query_at: Instant,
    last: Option<Last>,
    /// The bytes of the last frame with which the pace was measured, and how long it occupied the link.
    last_paced: Option<(usize, Duration)>,
    span: Span,
    feedback_interval: Option<Duration>,
    has_reported: bool,
    has_reported_a_frame: bool,
    accepts_video: bool,
    /// When the sender was last asked for a key frame, while the video needs one.
    key_asked_at: Option<Instant>,
    needs_key: bool,
    /// Whether the newest frame was one of a video.
    sees_video: bool,
}

impl Receiver {
    /// Creates the receiver of a program of `robot`. `id` is a random number; 0 counts as 1.
    pub fn new(robot: Name, id: u16, now: Instant) -> Self {
        Self {
            robot,
            id: id.max(1),
            created_at: now,
            group: None,
            offset: Offset::new(now),
            replies: 0,
            query_at: now,
            last: None,
            last_paced: None,
            span: Span::new(now),
            feedback_interval: Some(Duration::from_millis(500)),
            has_reported: false,
            has_reported_a_frame: false,
            accepts_video: false,
            key_asked_at: None,
            needs_key: false,
            sees_video: false,
        }
    }

    /// Sets whether video is decoded here, and whether it needs a key frame. If frames of a video arrive, the sender is asked
    /// for one at once.
    pub fn set_video(&mut self, accepts_video: bool, needs_key: bool, sees_video: bool) {
        self.accepts_video = accepts_video;
        self.needs_key = needs_key;
        self.sees_video = sees_video;
        if !needs_key {
            self.key_asked_at = None;
        }
    }

    /// Returns when the sender is to be asked for a key frame.
    fn ask_for_key_at(&self, now: Instant) -> Option<Instant> {
        let at = self
            .key_asked_at
            .map_or(now, |asked_at| asked_at + ASK_FOR_KEY);
        (self.needs_key && self.sees_video).then_some(at)
    }

    /// Handles a frame. Returns `None` if it is older than a frame that has already arrived.
    pub fn on_frame(
        &mut self,
        attachment: Option<Attachment>,
        bytes: usize,
        now: Instant,
    ) -> Option<Seen> {
        let Some(Attachment {
            source,
            sequence: number,
            sent,
            ..
        }) = attachment
        else {
            return Some(self.on_foreign_frame(bytes, now));
        };
        let sent = match sent {
            Sent::Low(low) => Some(low),
            Sent::At(at_ms) => Some(at_ms as u16),
            Sent::Unknown | Sent::Replayed(_) => None,
        };
        let skipped = match self.last {
            Some(last) if last.source == source => {
                let ahead = number.wrapping_sub(last.number);
                if ahead == 0 || ahead > u32::MAX / 2 {
                    return None;
                }
                ahead - 1
            }
            Some(last) => {
                let newer_ms = sent
                    .zip(last.sent)
                    .map(|(new, old)| new.wrapping_sub(old) as i16);
                if newer_ms.is_some_and(|newer_ms| (OVERTAKEN_MS..=0).contains(&newer_ms)) {
                    return None;
                }
                0
            }
            None => 0,
        };
        let is_restarted = self.last.is_some_and(|last| last.source != source);
        let age = sent.map(|low| self.offset.on_frame(low, now));
        let span = &mut self.span;
        let measured = age.and_then(|age| Some((age.age, age.min_delay?)));
        if let Some((age, min_delay)) = measured.filter(|_| bytes >= MIN_PACED_BYTES) {
            // A frame that queued behind the previous one occupied the link only after that one had arrived.
            let alone = self.last.map_or(age, |last| {
                age.min(now.saturating_duration_since(last.arrived_at) + min_delay)
            });
            let busy = alone.saturating_sub(min_delay).max(SHORTEST);
            // The frames that waited during a pause of the link arrive at once after the first one, which may be in the last report.
            if let Some((bytes, busy)) =
                (self.last_paced).filter(|_| alone < age && span.busy.is_zero())
            {
                span.busy += busy;
                span.paced_bytes += bytes as f64;
            }
            span.busy += busy;
            span.paced_bytes += bytes as f64;
            self.last_paced = Some((bytes, busy));
        }
        if let Some(age) = age.filter(|_| span.ages_ms.len() < MAX_AGES) {
            span.ages_ms
                .push(u32::try_from(age.age.as_millis()).unwrap_or(u32::MAX));
        }
        span.skipped = span.skipped.saturating_add(skipped);
        self.count(bytes);
        self.last = Some(Last {
            source,
            number,
            sent,
            arrived_at: now,
        });
        Some(Seen {
            number,
            age: age.map(|age| age.age),
            skipped,
            is_restarted,
        })
    }

    /// Handles the sender's reply to a query that was sent at `asked_at`.
    pub fn on_reply(&mut self, notice: &Notice, asked_at: Instant, now: Instant) {
        self.offset.on_reply(asked_at, notice.time_ms as u16, now);
        self.replies += 1;
        self.query_at = now
            + if self.replies < FIRST_QUERIES {
                FIRST_QUERY_INTERVAL
            } else {
                QUERY_INTERVAL
            };
        if self.group.is_none() {
            self.group = Some(notice.join);
        }
        self.on_notice(notice);
    }

    /// Handles a notice that the sender has published.
    pub fn on_notice(&mut self, notice: &Notice) {
        if let Some(group) = notice.group_of(self.robot.as_str()) {
            // The first feedback from the new group confirms the move.
            self.has_reported &= self.group == Some(group);
            self.group = Some(group);
        }
        let interval = Duration::from_millis(notice.feedback_ms.into());
        let interval = interval.clamp(*FEEDBACK_INTERVAL.start(), *FEEDBACK_INTERVAL.end());
        self.feedback_interval = (notice.feedback_ms > 0).then_some(interval);
    }

    /// Returns the group to subscribe to. `None` if it is not known yet.
    pub fn poll_group(&mut self, now: Instant) -> Option<Group> {
        if self.group.is_none() && now.saturating_duration_since(self.created_at) >= FOREIGN_AFTER {
            self.group = Some(Group::Main);
        }
        self.group
    }

    /// Returns whether to query the sender now.
    pub fn poll_query(&mut self, now: Instant) -> bool {
        if now < self.query_at {
            return false;
        }
        let is_young = now.saturating_duration_since(self.created_at) < 4 * QUERY_RETRY;
        self.query_at = now
            + if is_young {
                QUERY_RETRY
            } else {
                5 * QUERY_RETRY
            };
        true
    }

    /// Returns the feedback to send now, if there is any. No feedback is sent to a sender that does not reply to
    /// queries.
    pub fn poll_feedback(&mut self, now: Instant) -> Option<Feedback> {
        let interval = self.feedback_interval?;
        let group = self.group.filter(|_| self.replies > 0)?;
        let passed = now.saturating_duration_since(self.span.since);
        let wait = if self.span.frames > 0 {
            interval
        } else {
            IDLE.max(interval)
        };
        let asks_for_key = self.ask_for_key_at(now).is_some_and(|at| at <= now);
        let is_due = !self.has_reported || passed >= wait || self.has_first_frame();
        if !is_due && !asks_for_key {
            return None;
        }
        self.has_reported = true;
        self.has_reported_a_frame |= self.span.frames > 0;
        self.key_asked_at = self.needs_key.then_some(now);
        let span = std::mem::replace(&mut self.span, Span::new(now));
        let pace = (span.busy > Duration::ZERO).then(|| span.paced_bytes / span.busy.as_secs_f64());
        Some(Feedback {
            group,
            receiver: self.id,
            source: self.last.map_or(0, |last| last.source),
            last: self.last.map_or(0, |last| last.number),
            span_ms: u32::try_from(passed.as_millis()).unwrap_or(u32::MAX),
            frames: span.frames,
            bytes: span.bytes,
            skipped: span.skipped,
            age_ms: percentile_90(span.ages_ms),
            pace_bytes_per_s: pace.map(|pace| pace as u32),
            accepts_video: self.accepts_video,
            needs_key: self.needs_key && (self.sees_video || self.last.is_none()),
        })
    }

    /// Returns whether the first frame has arrived and is to be reported at once: the sender waits for it.
    fn has_first_frame(&self) -> bool {
        self.span.frames > 0 && !self.has_reported_a_frame
    }

    /// Returns the time at which to poll next, unless the sender replies or publishes a notice before that.
    pub fn poll_at(&self, now: Instant) -> Instant {
        let group = (self.group.is_none()).then(|| self.created_at + FOREIGN_AFTER);
        let feedback = self
            .feedback_interval
            .filter(|_| self.group.is_some() && self.replies > 0);
        let feedback = feedback.map(|interval| {
            let from = if self.span.frames > 0 {
                self.span.since
            } else {
                // Frames that arrive meanwhile are reported at most one interval later.
                now.min(self.span.since + IDLE.max(interval) - interval)
            };
            let first_frame = self.has_first_frame().then_some(now);
            let at = [first_frame, self.ask_for_key_at(now)];
            at.into_iter().flatten().fold(from + interval, Instant::min)
        });
        let first = [group, feedback].into_iter().flatten().min();
        first.map_or(self.query_at, |first| first.min(self.query_at))
    }

    /// Returns the round trip of a small message, if the sender has replied.
    pub fn round_trip(&self) -> Option<Duration> {
        self.offset.round_trip()
    }

    fn on_foreign_frame(&mut self, bytes: usize, now: Instant) -> Seen {
        self.count(bytes);
        let number = self.last.map_or(0, |last| last.number.wrapping_add(1));
        self.last = Some(Last {
            source: 0,
            number,
            sent: None,
            arrived_at: now,
        });
        Seen {
            number,
            age: None,
            skipped: 0,
            is_restarted: false,
        }
    }

    fn count(&mut self, bytes: usize) {
        let span = &mut self.span;
        span.frames = span.frames.saturating_add(1);
        span.bytes = span
            .bytes
            .saturating_add(u32::try_from(bytes).unwrap_or(u32::MAX));
    }
}

/// Returns the 90th percentile.
fn percentile_90(mut values: Vec<u32>) -> u32 {
    values.sort_unstable();
    let at = (values.len() * 9).div_ceil(10).saturating_sub(1);
    values.get(at).copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROBOT: &str = "wombat-2";

    fn receiver(now: Instant) -> Receiver {
        Receiver::new(Name::new(ROBOT).expect("a name"), 7, now)
    }

    fn frame(source: u16, number: u32, sent_ms: u64) -> Option<Attachment> {
        Some(Attachment {
            source,
            sequence: number,
            sent: Sent::Low(sent_ms as u16),
            lifetime_ms: None,
        })
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn accepts_newer_frames_and_counts_skipped_ones() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let mut see = |source, number, at_ms| {
            let seen = receiver.on_frame(frame(source, number, at_ms), 100, start + ms(at_ms));
            seen.map(|seen| (seen.number, seen.skipped))
        };
        assert_eq!(
            see(1, u32::MAX - 1, 0),
            Some((u32::MAX - 1, 0)),
            "frames before the first one are not missed"
        );
        assert_eq!(see(1, 2, 100), Some((2, 3)), "wrapped around");
        assert_eq!(see(1, 2, 100), None, "duplicate");
        assert_eq!(see(1, 1, 110), None, "late");
        assert_eq!(see(2, 50, 200), Some((50, 0)), "another source");
        assert_eq!(see(1, 3, 150), None, "sent before that one");
        assert_eq!(see(1, 9, 300), Some((9, 0)), "the first source again");
    }

    #[test]
    fn accepts_frames_of_other_programs_without_sending_feedback() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        for n in 0..50u64 {
            let now = start + ms(n * 100);
            let seen = receiver.on_frame(None, 100, now).expect("seen");
            assert_eq!((seen.number, seen.age, seen.skipped), (n as u32, None, 0));
            assert_eq!(receiver.poll_feedback(now), None);
        }
        assert_eq!(receiver.poll_group(start + ms(100)), None);
        assert_eq!(
            receiver.poll_group(start + FOREIGN_AFTER),
            Some(Group::Main)
        );
    }

    #[test]
    fn measures_the_links_pace_with_and_without_queueing() {
        // 30 kB/s and a delay of 20 ms: a frame of 3 kB takes 120 ms. One is sent every 200 ms or every 90 ms.
        for every_ms in [200, 90] {
            let start = Instant::now();
            let mut receiver = receiver(start);
            let notice = Notice {
                time_ms: 20,
                feedback_ms: 500,
                ..Notice::default()
            };
            receiver.on_reply(&notice, start, start + ms(40));
            let mut free_ms = 0;
            for n in 0..5u64 {
                let sent_ms = 100 + n * every_ms;
                free_ms = free_ms.max(sent_ms) + 100;
                receiver.on_frame(frame(1, n as u32, sent_ms), 3000, start + ms(free_ms + 20));
            }
            let feedback = receiver
                .poll_feedback(start + ms(free_ms + 500))
                .expect("feedback");
            let pace = feedback.pace_bytes_per_s.expect("known");
            assert!(
                (27_000..33_000).contains(&pace),
                "every {every_ms} ms: {pace}"
            );
            assert_eq!(
                (feedback.frames, feedback.bytes, feedback.skipped),
                (5, 15_000, 0)
            );
        }
    }

    /// A link that carries 30 kB/s and stands still now and then. The frames that waited arrive at once afterwards.
    #[test]
    fn pace_includes_the_pauses_of_the_link() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let notice = Notice {
            time_ms: 20,
            feedback_ms: 500,
            ..Notice::default()
        };
        receiver.on_reply(&notice, start, start + ms(40));
        let mut paces = Vec::new();
        for n in 0..200u64 {
            let sent_ms = 100 + n * 100;
            // Each second second, nothing arrives for 700 ms.
            let carried_ms = sent_ms + 100;
            let is_held = carried_ms % 2000 < 700;
            let at_ms = match is_held {
                true => carried_ms - carried_ms % 2000 + 700 + n % 10,
                false => carried_ms,
            };
            let now = start + ms(at_ms + 20);
            receiver.on_frame(frame(1, n as u32, sent_ms), 3000, now);
            let feedback = receiver.poll_feedback(now);
            paces.extend(feedback.and_then(|feedback| feedback.pace_bytes_per_s));
        }
        assert!(paces.len() > 20);
        let highest = paces.iter().max().expect("some");
        assert!(*highest < 40_000, "{highest} in {paces:?}");
    }

    #[test]
    fn measures_no_pace_from_small_frames() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let notice = Notice {
            feedback_ms: 500,
            ..Notice::default()
        };
        receiver.on_reply(&notice, start, start);
        for n in 0..5u64 {
            let arrived_at = start + ms(n * 100 + 40);
            receiver.on_frame(frame(1, n as u32, n * 100), 20, arrived_at);
        }
        let feedback = receiver.poll_feedback(start + ms(1000)).expect("feedback");
        assert_eq!(
            (feedback.frames, feedback.age_ms, feedback.pace_bytes_per_s),
            (5, 40, None)
        );
    }

    #[test]
    fn sends_feedback_in_time_if_polled_only_when_due() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let (mut polls, mut poll_at, mut queries) = (0, start, Vec::new());
        let (mut unreported_ms, mut reported_ms) = (None, 0);
        for at_ms in 0..20_000 {
            let now = start + ms(at_ms);
            if at_ms == 250 {
                let notice = Notice {
                    feedback_ms: 500,
                    ..Notice::default()
                };
                receiver.on_reply(&notice, start, now);
                poll_at = now;
            }
            // Frames arrive for some time, and then none.
            if at_ms % 100 == 0 && (1000..4000).contains(&(at_ms % 10_000)) {
                receiver.on_frame(frame(1, at_ms as u32, at_ms), 2000, now);
                unreported_ms = unreported_ms.or(Some(at_ms));
            }
            if now < poll_at {
                continue;
            }
            polls += 1;
            if receiver.poll_query(now) {
                queries.push(at_ms);
            }
            receiver.poll_group(now);
            if receiver.poll_feedback(now).is_some() {
                let waited_ms = unreported_ms.take().map_or(0, |since| at_ms - since);
                assert!(waited_ms <= 500, "reported {waited_ms} ms later");
                assert!(
                    at_ms - reported_ms <= 2000,
                    "no feedback from {reported_ms} to {at_ms}"
                );
                reported_ms = at_ms;
            }
            poll_at = receiver.poll_at(now);
            assert!(poll_at > now, "polls without a pause");
        }
        assert_eq!(
            (unreported_ms, queries),
            (
                None,
                vec![0, 650, 1650, 2650, 3650, 4650, 9650, 14650, 19650]
            )
        );
        assert!(polls <= 50, "{polls} in 20 s");
    }

    #[test]
    fn confirms_a_change_of_group_immediately() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        assert!(receiver.poll_query(start) && !receiver.poll_query(start));
        let notice = Notice {
            feedback_ms: 500,
            join: Group::Slow,
            ..Notice::default()
        };
        receiver.on_reply(&notice, start, start + ms(10));
        assert_eq!(receiver.poll_group(start + ms(10)), Some(Group::Slow));
        let first = receiver
            .poll_feedback(start + ms(10))
            .expect("first feedback");
        assert_eq!(
            (first.group, first.receiver, first.frames),
            (Group::Slow, 7, 0)
        );
        assert_eq!(receiver.poll_feedback(start + ms(20)), None);
        receiver.on_notice(&Notice {
            main: vec![ROBOT.into()],
            ..notice.clone()
        });
        assert_eq!(receiver.poll_group(start), Some(Group::Main));
        let moved = receiver.poll_feedback(start + ms(30)).expect("moved");
        assert_eq!(moved.group, Group::Main);
        receiver.on_notice(&Notice {
            slow: vec!["another".into()],
            ..notice
        });
        assert_eq!(
            receiver.poll_group(start),
            Some(Group::Main),
            "not named: unchanged"
        );
    }
}
