//! Checks whether the router still works: it asks itself a question through its own session, which passes through Zenoh's tables
//! as those of programs do. A router that does not answer cannot recover, because a part of it has panicked or waits forever.
//!
//! A computer that is overloaded, was suspended or was stopped must not look like that. So a check has no time limit of its own: it
//! fails each time that the router looks and has no answer, and a router that was stopped looks once.

use std::{
    io,
    sync::{
        atomic::{AtomicU64, Ordering},
        mpsc::{self, SyncSender},
        Arc,
    },
    thread,
    time::Duration,
};

use zenoh::{query::Reply, Session, Wait};

/// How often the router looks for the answer, and asks again.
pub const EVERY: Duration = Duration::from_secs(10);
/// Number of looks without an answer after which the router has failed.
pub const MAX_UNANSWERED: u32 = 3;
/// How long Zenoh waits for the answer to a question: longer than the check does.
const QUERY_TIMEOUT: Duration = Duration::from_secs(60);

/// The result of a look.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// The router has answered, and is asked again.
    Answered,
    /// It has not answered yet.
    Unanswered,
    /// It has not answered for too long.
    Failed,
}

/// Counts the looks without an answer.
#[derive(Debug, Default)]
struct Unanswered {
    count: u32,
}

impl Unanswered {
    fn on_look(&mut self, is_answered: bool) -> Look {
        if is_answered {
            self.count = 0;
            return Look::Answered;
        }
        self.count += 1;
        match self.count >= MAX_UNANSWERED {
            true => Look::Failed,
            false => Look::Unanswered,
        }
    }
}

/// The check of a running router.
pub struct SelfCheck {
    ask: SyncSender<()>,
    /// Number of answers after which the last question is answered, and number of answers.
    asked: u64,
    answered: Arc<AtomicU64>,
    unanswered: Unanswered,
}

impl SelfCheck {
    /// Starts to check the router of that session.
    ///
    /// # Errors
    /// The system's error if the thread that asks cannot be started.
    pub fn start(session: &Session) -> io::Result<Self> {
        let (session, key) = (session.clone(), crate::status::key(session, "ble"));
        Self::asking(move || ask(&session, &key))
    }

    /// Starts a check that asks with `ask`, which returns whether there was an answer.
    fn asking(ask: impl Fn() -> bool + Send + 'static) -> io::Result<Self> {
        let (to_thread, questions) = mpsc::sync_channel(1);
        let answered = Arc::<AtomicU64>::default();
        let of_thread = Arc::clone(&answered);
        thread::Builder::new()
            .name("self-check".to_owned())
            .spawn(move || {
                for () in questions {
                    if ask() {
                        of_thread.fetch_add(1, Ordering::Release);
                    }
                }
            })?;
        Ok(Self {
            ask: to_thread,
            asked: 0,
            answered,
            unanswered: Unanswered::default(),
        })
    }

    /// Looks for the answer to the last question, and asks again.
    pub fn look(&mut self) -> Look {
        let answered = self.answered.load(Ordering::Acquire);
        let is_answered = answered >= self.asked;
        if is_answered {
            self.asked = answered + 1;
        }
        // The thread may still wait for an answer, or may have panicked: then there is none.
        let _ = self.ask.try_send(());
        self.unanswered.on_look(is_answered)
    }
}

/// Asks the router, and returns whether it has answered.
fn ask(session: &Session, key: &str) -> bool {
    let replies = session.get(key).timeout(QUERY_TIMEOUT).wait();
    let Ok(replies) = replies else {
        return false;
    };
    // The channel ends when the router's tables have answered, too.
    let is_answer = |any, reply: Reply| any | reply.result().is_ok();
    replies.into_iter().fold(false, is_answer)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicBool;

    use super::*;
    use Look::{Answered, Failed, Unanswered as NotYet};

    #[test]
    fn router_has_failed_after_three_looks_in_a_row_without_an_answer() {
        let mut unanswered = Unanswered::default();
        let looks = [true, false, false, true, false, false, false]
            .map(|is_answered| unanswered.on_look(is_answered));
        let expected = [Answered, NotYet, NotYet, Answered, NotYet, NotYet, Failed];
        assert_eq!(looks, expected);
    }

    /// Looks until the answer is there, as often as it takes the other thread.
    fn until_answered(check: &mut SelfCheck) {
        while check.answered.load(Ordering::Acquire) < check.asked {
            thread::yield_now();
        }
    }

    #[test]
    fn router_that_was_stopped_for_long_has_not_failed() {
        let mut check = SelfCheck::asking(|| true).expect("a thread");
        for _ in 0..100 {
            // However much time passes here, the router looks once.
            assert_eq!(check.look(), Answered);
            until_answered(&mut check);
        }
    }

    #[test]
    fn router_that_hangs_or_panics_has_failed() {
        static HANGS: AtomicBool = AtomicBool::new(true);
        let hanging = SelfCheck::asking(|| {
            while HANGS.load(Ordering::Acquire) {
                thread::park_timeout(Duration::from_millis(10));
            }
            true
        });
        let panicking = SelfCheck::asking(|| panic!("a poisoned lock"));
        let silent = SelfCheck::asking(|| false);
        for check in [hanging, panicking, silent] {
            let mut check = check.expect("a thread");
            assert_eq!(check.look(), Answered, "nothing was asked before");
            let looks = [(); 3].map(|()| check.look());
            assert_eq!(looks, [NotYet, NotYet, Failed]);
        }
        HANGS.store(false, Ordering::Release);
    }
}
