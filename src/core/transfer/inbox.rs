//! Owns the choice of offers: which are taken, and what the others are answered.
use std::collections::{BTreeMap, VecDeque};

use zenoh_keyexpr::keyexpr;

use super::{
    answer::{Answer, Fault, Refusal},
    offer::{Offer, TransferId},
};
use crate::core::{name::Name, topic::Pattern};

/// How many that ended are remembered, so that an offer that is repeated is answered as before.
const ENDED: usize = 256;

/// What a program takes. Nothing is taken without one.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Of whom, and about what.
    pub pattern: Pattern,
    /// The largest, in bytes.
    pub max_bytes: u64,
    /// How many at once; others wait until one has ended.
    pub max_running: usize,
}

/// The offers to one program's wish.
#[derive(Debug)]
pub struct Inbox {
    me: Name,
    wanted: Wanted,
    running: BTreeMap<TransferId, Running>,
    ended: VecDeque<(TransferId, u64, Answer)>,
}

#[derive(Debug)]
struct Running {
    offer: Offer,
    held_bytes: u64,
}

/// What to do with an offer.
#[derive(Clone, Debug, PartialEq)]
pub enum Decision {
    /// Take it: begin to receive, and answer that it runs. Then [`Inbox::on_held`] and [`Inbox::on_ended`].
    Take(TransferId, Box<Offer>),
    /// It is running: tell its receiver that it was offered again, and answer this.
    Known(TransferId, Answer),
    /// Answer this.
    Answer(Answer),
}

impl Inbox {
    /// Of this robot.
    pub fn new(me: Name, wanted: Wanted) -> Self {
        Self {
            me,
            wanted,
            running: BTreeMap::new(),
            ended: VecDeque::new(),
        }
    }

    /// Someone offers.
    pub fn on_offer(&mut self, bytes: &[u8]) -> Decision {
        let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
        let offer = match Offer::decode(bytes) {
            Ok(offer) => offer,
            Err(error) => return refused(Refusal::NotUnderstood(error.to_string())),
        };
        let id = offer.id(&self.me);
        if let Some(running) = self.running.get_mut(&id) {
            if !running.offer.is_same(&offer) {
                return refused(Refusal::NotUnderstood("another transfer has its id".into()));
            }
            // After a restart of the sender it is another call that waits for the end.
            running.offer.call = offer.call;
            return Decision::Known(
                id,
                Answer::Running {
                    held_bytes: running.held_bytes,
                },
            );
        }
        let is_it =
            |(ended, call, _): &&(TransferId, u64, Answer)| *ended == id && *call == offer.call;
        if let Some((_, _, answer)) = self.ended.iter().find(is_it) {
            return Decision::Answer(answer.clone());
        }
        if !self.wants(&offer) {
            return refused(Refusal::NotWanted);
        }
        let limit_bytes = self.wanted.max_bytes;
        if offer.size_bytes > limit_bytes {
            return refused(Refusal::TooLarge { limit_bytes });
        }
        if self.running.len() >= self.wanted.max_running {
            return Decision::Answer(Answer::Busy);
        }
        let running = Running {
            offer: offer.clone(),
            held_bytes: 0,
        };
        self.running.insert(id, running);
        Decision::Take(id, Box::new(offer))
    }

    fn wants(&self, offer: &Offer) -> bool {
        let pattern = &self.wanted.pattern;
        let of_whom = pattern.robot().is_none_or(|robot| *robot == offer.from);
        let both = (
            keyexpr::new(pattern.topic()),
            keyexpr::new(offer.topic.as_str()),
        );
        of_whom && matches!(both, (Ok(wanted), Ok(topic)) if wanted.intersects(topic))
    }

    /// So much of it is there.
    pub fn on_held(&mut self, id: TransferId, held_bytes: u64) {
        if let Some(running) = self.running.get_mut(&id) {
            running.held_bytes = held_bytes;
        }
    }

    /// It is over. What ended because nothing came any more, or by the program's wish, may be offered again.
    pub fn on_ended(&mut self, id: TransferId, how: &Result<(), Fault>) {
        let Some(running) = self.running.remove(&id) else {
            return;
        };
        let answer = match how {
            Ok(()) => Answer::Done,
            Err(Fault::Silence(_) | Fault::Stopped) => return,
            Err(fault) => Answer::Failed(fault.clone()),
        };
        if self.ended.len() == ENDED {
            self.ended.pop_front();
        }
        self.ended.push_back((id, running.offer.call, answer));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::transfer::offer::sample;

    fn inbox(pattern: &str) -> Inbox {
        let wanted = Wanted {
            pattern: Pattern::new(pattern).expect("a pattern"),
            max_bytes: 1000,
            max_running: 2,
        };
        Inbox::new(Name::new("wombat-2").expect("a name"), wanted)
    }

    fn take(inbox: &mut Inbox, offer: &Offer) -> TransferId {
        match inbox.on_offer(&offer.encode()) {
            Decision::Take(id, taken) if *taken == *offer => id,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn only_what_is_wanted_is_taken() {
        let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
        for pattern in ["*/**", "wombat-1/map/*", "wombat-1/map/kitchen"] {
            take(&mut inbox(pattern), &sample(10));
        }
        for pattern in ["wombat-3/**", "*/map", "*/log/*"] {
            let decision = inbox(pattern).on_offer(&sample(10).encode());
            assert_eq!(decision, refused(Refusal::NotWanted), "{pattern}");
        }
        let too_large = refused(Refusal::TooLarge { limit_bytes: 1000 });
        assert_eq!(inbox("*/**").on_offer(&sample(1001).encode()), too_large);
        assert_eq!(
            inbox("*/**").on_offer(&sample(u64::MAX).encode()),
            too_large
        );
        let nonsense = inbox("*/**").on_offer(b"nonsense");
        assert!(matches!(
            nonsense,
            Decision::Answer(Answer::Refused(Refusal::NotUnderstood(_)))
        ));
    }

    #[test]
    fn the_same_offered_twice_is_one_transfer() {
        let mut inbox = inbox("*/**");
        let id = take(&mut inbox, &sample(10));
        inbox.on_held(id, 4);
        let known = Decision::Known(id, Answer::Running { held_bytes: 4 });
        assert_eq!(inbox.on_offer(&sample(10).encode()), known);
        let restarted = Offer {
            call: 8,
            ..sample(10)
        };
        assert_eq!(
            inbox.on_offer(&restarted.encode()),
            known,
            "its sender was restarted"
        );
        inbox.on_ended(id, &Ok(()));
        assert_eq!(
            inbox.on_offer(&restarted.encode()),
            Decision::Answer(Answer::Done)
        );
        let again = Offer {
            call: 9,
            ..sample(10)
        };
        assert_eq!(
            take(&mut inbox, &again),
            id,
            "sent once more by the program's wish"
        );
    }

    #[test]
    fn too_many_at_once_wait() {
        let mut inbox = inbox("*/**");
        let first = take(&mut inbox, &sample(1));
        take(&mut inbox, &sample(2));
        let third = sample(3).encode();
        assert_eq!(inbox.on_offer(&third), Decision::Answer(Answer::Busy));
        inbox.on_ended(first, &Err(Fault::Stopped));
        assert!(matches!(inbox.on_offer(&third), Decision::Take(..)));
    }

    #[test]
    fn what_failed_stays_failed_and_what_was_interrupted_may_go_on() {
        let mut inbox = inbox("*/**");
        let full = Fault::NotKept("disk full".into());
        let id = take(&mut inbox, &sample(1));
        inbox.on_ended(id, &Err(full.clone()));
        let answer = inbox.on_offer(&sample(1).encode());
        assert_eq!(answer, Decision::Answer(Answer::Failed(full)));
        for fault in [Fault::Silence(600), Fault::Stopped] {
            let id = take(&mut inbox, &sample(2));
            inbox.on_ended(id, &Err(fault));
        }
        take(&mut inbox, &sample(2));
    }

    #[test]
    fn it_remembers_so_many_and_no_more() {
        let mut inbox = inbox("*/**");
        for call in 0..ENDED as u64 + 10 {
            let id = take(&mut inbox, &Offer { call, ..sample(1) });
            inbox.on_ended(id, &Ok(()));
        }
        assert_eq!(inbox.ended.len(), ENDED);
        inbox.on_ended(sample(5).id(&inbox.me.clone()), &Ok(()));
        assert_eq!(inbox.ended.len(), ENDED, "one that it does not know");
    }
}
