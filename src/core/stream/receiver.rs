//! Owns the receiving end of a stream: which frames are new, how old they are, what was skipped, where to listen, and what
//! to tell the sender.
use std::time::{Duration, Instant};

use super::{feedback::Feedback, notice::Notice, offset::Offset, Group};
use crate::core::{
    attachment::{Attachment, Sent},
    name::Name,
};

/// Without an answer for so long, the sender is some other program: its frames are on the stream's own key.
const STRANGE_AFTER: Duration = Duration::from_millis(1500);
/// When nothing comes, that is said this often.
const IDLE: Duration = Duration::from_secs(2);
/// How often the sender's clock is asked for: at first a few times, for a quick answer among them.
const ASK_AGAIN: Duration = Duration::from_secs(1);
const ASK_MORE: Duration = Duration::from_millis(400);
const ASK_LATER: Duration = Duration::from_secs(15);
const FIRST_QUESTIONS: u32 = 4;
/// A frame of another source that is so little older is of before a change of groups.
const OVERTAKEN_MS: i16 = -2000;
/// No frame takes less, as far as these clocks can tell.
const SHORTEST: Duration = Duration::from_millis(1);
/// Smaller frames take what any message takes: they tell nothing of the pace.
const LEAST_PACED_BYTES: usize = 500;
const MOST_AGES: usize = 1024;

/// A frame that came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Its number.
    pub number: u32,
    /// How long ago it was sent; until the sender has told its time, how much longer it took than the fastest of the
    /// last minute. `None`: another program's frame, which does not tell.
    pub age: Option<Duration>,
    /// So many between the last one and this one have not come.
    pub skipped: u32,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    source: u16,
    number: u32,
    sent: Option<u16>,
    came: Instant,
}

/// What came since the last feedback.
#[derive(Debug)]
struct Span {
    since: Instant,
    frames: u32,
    bytes: u32,
    skipped: u32,
    ages_ms: Vec<u32>,
    /// Frames whose time on the way is known: their bytes, and how long the way was busy with them.
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

/// One program's end of one stream.
#[derive(Debug)]
pub struct Receiver {
    robot: Name,
    id: u16,
    born: Instant,
    group: Option<Group>,
    offset: Offset,
    answers: u32,
    ask_at: Instant,
    last: Option<Last>,
    span: Span,
    feedback_every: Option<Duration>,
    has_said_hello: bool,
}

impl Receiver {
    /// Of a program of `robot`, which draws `id` when it starts.
    pub fn new(robot: Name, id: u16, now: Instant) -> Self {
        Self {
            robot,
            id,
            born: now,
            group: None,
            offset: Offset::new(now),
            answers: 0,
            ask_at: now,
            last: None,
            span: Span::new(now),
            feedback_every: Some(Duration::from_millis(500)),
            has_said_hello: false,
        }
    }

    /// A frame came. `None`: it is older than what has been there already.
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
        }) = attachment
        else {
            return Some(self.on_strange_frame(bytes, now));
        };
        let sent = match sent {
            Sent::Low(low) => Some(low),
            Sent::At(at_ms) => Some(at_ms as u16),
            Sent::Unknown => None,
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
        let age = sent.map(|low| self.offset.on_frame(low, now));
        let span = &mut self.span;
        let known = age.and_then(|age| Some((age.age, age.least?)));
        if let Some((age, least)) = known.filter(|_| bytes >= LEAST_PACED_BYTES) {
            // A frame that waited for the one before it had the way only after that.
            let alone = self.last.map_or(age, |last| {
                age.min(now.saturating_duration_since(last.came) + least)
            });
            span.busy += alone.saturating_sub(least).max(SHORTEST);
            span.paced_bytes += bytes as f64;
        }
        if let Some(age) = age.filter(|_| span.ages_ms.len() < MOST_AGES) {
            span.ages_ms
                .push(u32::try_from(age.age.as_millis()).unwrap_or(u32::MAX));
        }
        span.skipped = span.skipped.saturating_add(skipped);
        self.count(bytes);
        self.last = Some(Last {
            source,
            number,
            sent,
            came: now,
        });
        Some(Seen {
            number,
            age: age.map(|age| age.age),
            skipped,
        })
    }

    /// The sender, asked at `asked`, has answered.
    pub fn on_answer(&mut self, notice: &Notice, asked: Instant, now: Instant) {
        self.offset.on_answer(asked, notice.time_ms as u16, now);
        self.answers += 1;
        self.ask_at = now
            + if self.answers < FIRST_QUESTIONS {
                ASK_MORE
            } else {
                ASK_LATER
            };
        if self.group.is_none() {
            self.group = Some(notice.join);
        }
        self.on_notice(notice);
    }

    /// The sender says something to all.
    pub fn on_notice(&mut self, notice: &Notice) {
        if let Some(group) = notice.group_of(self.robot.as_str()) {
            // What it hears there tells when it has moved.
            self.has_said_hello &= self.group == Some(group);
            self.group = Some(group);
        }
        let every = Duration::from_millis(u64::from(notice.feedback_ms.clamp(200, 10_000)));
        self.feedback_every = (notice.feedback_ms > 0).then_some(every);
    }

    /// Where to listen now; `None`: not known yet.
    pub fn poll_group(&mut self, now: Instant) -> Option<Group> {
        if self.group.is_none() && now.saturating_duration_since(self.born) >= STRANGE_AFTER {
            self.group = Some(Group::Main);
        }
        self.group
    }

    /// Whether to ask the sender now.
    pub fn poll_question(&mut self, now: Instant) -> bool {
        if now < self.ask_at {
            return false;
        }
        let is_young = now.saturating_duration_since(self.born) < 4 * ASK_AGAIN;
        self.ask_at = now + if is_young { ASK_AGAIN } else { 5 * ASK_AGAIN };
        true
    }

    /// What to tell the sender now, if anything. A sender that answers no question is told nothing.
    pub fn poll_feedback(&mut self, now: Instant) -> Option<Feedback> {
        let every = self.feedback_every?;
        let group = self.group.filter(|_| self.answers > 0)?;
        let passed = now.saturating_duration_since(self.span.since);
        let wait = if self.span.frames > 0 {
            every
        } else {
            IDLE.max(every)
        };
        if self.has_said_hello && passed < wait {
            return None;
        }
        self.has_said_hello = true;
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
            age_ms: most_of(span.ages_ms),
            pace_bytes_per_s: pace.map(|pace| pace as u32),
        })
    }

    /// When to poll again, unless the sender says something before that.
    pub fn poll_at(&self, now: Instant) -> Instant {
        let group = (self.group.is_none()).then(|| self.born + STRANGE_AFTER);
        let feedback = self
            .feedback_every
            .filter(|_| self.group.is_some() && self.answers > 0);
        let feedback = feedback.map(|every| {
            let from = if self.span.frames > 0 {
                self.span.since
            } else {
                // What comes meanwhile is told that much later at most.
                now.min(self.span.since + IDLE.max(every) - every)
            };
            from + every
        });
        let first = [group, feedback].into_iter().flatten().min();
        first.map_or(self.ask_at, |first| first.min(self.ask_at))
    }

    /// What a small message takes there and back, where the sender has answered.
    pub fn round_trip(&self) -> Option<Duration> {
        self.offset.round_trip()
    }

    fn on_strange_frame(&mut self, bytes: usize, now: Instant) -> Seen {
        self.count(bytes);
        let number = self.last.map_or(0, |last| last.number.wrapping_add(1));
        self.last = Some(Last {
            source: 0,
            number,
            sent: None,
            came: now,
        });
        Seen {
            number,
            age: None,
            skipped: 0,
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

/// What nine of ten are not above.
fn most_of(mut values: Vec<u32>) -> u32 {
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
        })
    }

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    #[test]
    fn only_newer_frames_are_new_and_what_is_left_out_is_counted() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let mut see = |source, number, at_ms| {
            let seen = receiver.on_frame(frame(source, number, at_ms), 100, start + ms(at_ms));
            seen.map(|seen| (seen.number, seen.skipped))
        };
        assert_eq!(
            see(1, u32::MAX - 1, 0),
            Some((u32::MAX - 1, 0)),
            "what was before is not missed"
        );
        assert_eq!(see(1, 2, 100), Some((2, 3)), "past the highest");
        assert_eq!(see(1, 2, 100), None, "again");
        assert_eq!(see(1, 1, 110), None, "late");
        assert_eq!(see(2, 50, 200), Some((50, 0)), "another source");
        assert_eq!(see(1, 3, 150), None, "sent before that one");
        assert_eq!(see(1, 9, 300), Some((9, 0)), "and back");
    }

    #[test]
    fn frames_of_other_programs_are_seen_too_and_nothing_is_said() {
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
            receiver.poll_group(start + STRANGE_AFTER),
            Some(Group::Main)
        );
    }

    #[test]
    fn the_pace_is_the_links_whether_frames_wait_for_each_other_or_not() {
        // 30 kB/s, 20 ms: a frame of 3 kB takes 120 ms, sent every 200 or every 90 ms.
        for every_ms in [200, 90] {
            let start = Instant::now();
            let mut receiver = receiver(start);
            let notice = Notice {
                time_ms: 20,
                feedback_ms: 500,
                ..Notice::default()
            };
            receiver.on_answer(&notice, start, start + ms(40));
            let mut free_ms = 0;
            for n in 0..5u64 {
                let sent_ms = 100 + n * every_ms;
                free_ms = free_ms.max(sent_ms) + 100;
                receiver.on_frame(frame(1, n as u32, sent_ms), 3000, start + ms(free_ms + 20));
            }
            let said = receiver
                .poll_feedback(start + ms(free_ms + 500))
                .expect("something");
            let pace = said.pace_bytes_per_s.expect("known");
            assert!((27_000..33_000).contains(&pace), "every {every_ms}: {pace}");
            assert_eq!((said.frames, said.bytes, said.skipped), (5, 15_000, 0));
        }
    }

    #[test]
    fn frames_of_a_few_bytes_tell_no_pace() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let notice = Notice {
            feedback_ms: 500,
            ..Notice::default()
        };
        receiver.on_answer(&notice, start, start);
        for n in 0..5u64 {
            let came = start + ms(n * 100 + 40);
            receiver.on_frame(frame(1, n as u32, n * 100), 20, came);
        }
        let said = receiver.poll_feedback(start + ms(1000)).expect("something");
        assert_eq!(
            (said.frames, said.age_ms, said.pace_bytes_per_s),
            (5, 40, None)
        );
    }

    #[test]
    fn polled_only_when_it_wants_to_be_it_is_prompt() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        let (mut polls, mut poll_at, mut questions) = (0, start, Vec::new());
        let (mut untold_ms, mut told_ms) = (None, 0);
        for at_ms in 0..20_000 {
            let now = start + ms(at_ms);
            if at_ms == 250 {
                let notice = Notice {
                    feedback_ms: 500,
                    ..Notice::default()
                };
                receiver.on_answer(&notice, start, now);
                poll_at = now;
            }
            // Frames for a while, and none for a while.
            if at_ms % 100 == 0 && (1000..4000).contains(&(at_ms % 10_000)) {
                receiver.on_frame(frame(1, at_ms as u32, at_ms), 2000, now);
                untold_ms = untold_ms.or(Some(at_ms));
            }
            if now < poll_at {
                continue;
            }
            polls += 1;
            if receiver.poll_question(now) {
                questions.push(at_ms);
            }
            receiver.poll_group(now);
            if receiver.poll_feedback(now).is_some() {
                let waited_ms = untold_ms.take().map_or(0, |since| at_ms - since);
                assert!(waited_ms <= 500, "told {waited_ms} ms later");
                assert!(
                    at_ms - told_ms <= 2000,
                    "nothing said from {told_ms} to {at_ms}"
                );
                told_ms = at_ms;
            }
            poll_at = receiver.poll_at(now);
            assert!(poll_at > now, "it would never rest");
        }
        assert_eq!(
            (untold_ms, questions),
            (
                None,
                vec![0, 650, 1650, 2650, 3650, 4650, 9650, 14650, 19650]
            )
        );
        assert!(polls <= 50, "{polls} in 20 s");
    }

    #[test]
    fn it_goes_where_it_is_told_and_says_so_at_once() {
        let start = Instant::now();
        let mut receiver = receiver(start);
        assert!(receiver.poll_question(start) && !receiver.poll_question(start));
        let notice = Notice {
            feedback_ms: 500,
            join: Group::Slow,
            ..Notice::default()
        };
        receiver.on_answer(&notice, start, start + ms(10));
        assert_eq!(receiver.poll_group(start + ms(10)), Some(Group::Slow));
        let hello = receiver.poll_feedback(start + ms(10)).expect("hello");
        assert_eq!(
            (hello.group, hello.receiver, hello.frames),
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
            "not named, so it stays"
        );
    }
}
