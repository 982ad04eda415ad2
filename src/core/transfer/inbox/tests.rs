//! Tests of the inbox.
use super::*;
use crate::core::transfer::offer::sample;

/// An inbox, and the time there.
struct Bench {
    inbox: Inbox,
    now: Instant,
}

fn name(text: &str) -> Name {
    Name::new(text).expect("a name")
}

impl Bench {
    fn new(pattern: &str) -> Self {
        Self::with_places(pattern, 4)
    }

    fn with_places(pattern: &str, max_running: usize) -> Self {
        let wanted = Wanted {
            pattern: Pattern::new(pattern).expect("a pattern"),
            max_bytes: 1000,
            max_running,
        };
        let (inbox, now) = (Inbox::new(name("wombat-2"), wanted), Instant::now());
        Self { inbox, now }
    }

    fn offer(&mut self, offer: &Offer) -> Decision {
        self.inbox.on_offer(self.now, &offer.encode())
    }

    fn questions(&mut self) -> Vec<Question> {
        let mut questions = Vec::new();
        while let Step::Ask(question) = self.inbox.poll(self.now) {
            questions.push(question);
        }
        questions
    }

    /// Offers, and confirms as its sender does.
    fn confirmed(&mut self, offer: &Offer) -> Option<Confirmed> {
        let answer = self.offer(offer);
        assert_eq!(answer, Decision::Answer(Answer::Running { held_bytes: 0 }));
        let question = self.questions().pop().expect("its sender is asked");
        self.inbox.on_confirmed(&question, &offer.encode())
    }

    fn take(&mut self, offer: &Offer) -> TransferId {
        match self.confirmed(offer) {
            Some(Confirmed::Take(id, taken)) if *taken == *offer => id,
            other => panic!("{other:?}"),
        }
    }
}

fn of(from: &str, call: u64) -> Offer {
    let from = name(from);
    Offer {
        from,
        call,
        size_bytes: call,
        ..sample(1)
    }
}

#[test]
fn an_offer_is_not_taken_before_its_sender_confirms_it() {
    for size in [0, 10] {
        let mut bench = Bench::new("*/**");
        let offer = sample(size);
        bench.offer(&offer);
        let question = bench.questions().pop().expect("its sender is asked");
        assert_eq!(
            (question.id, &question.from),
            (offer.id(&name("wombat-2")), &offer.from)
        );
        assert!(bench.inbox.running.is_empty(), "nothing has begun");
        let wrong = [
            Vec::new(),
            b"yes".to_vec(),
            of("wombat-1", 3).encode(),
            Offer {
                from: name("wombat-3"),
                ..offer.clone()
            }
            .encode(),
        ];
        for reply in wrong {
            assert_eq!(bench.inbox.on_confirmed(&question, &reply), None);
        }
        let reply = offer.encode();
        let taken = bench.inbox.on_confirmed(&question, &reply);
        assert_eq!(taken, Some(Confirmed::Take(question.id, Box::new(offer))));
    }
}

#[test]
fn a_sender_that_is_silent_is_asked_again_for_ten_seconds() {
    let mut bench = Bench::new("*/**");
    let start = bench.now;
    bench.offer(&sample(10));
    let mut asked = 0;
    loop {
        for question in bench.questions() {
            asked += 1;
            bench.inbox.on_silence(bench.now, &question);
        }
        match bench.inbox.poll(bench.now) {
            Step::Wait(Some(until)) => bench.now = until,
            Step::Wait(None) => break,
            Step::Ask(_) => {}
        }
    }
    assert!(asked > 3, "{asked}");
    assert!(bench.now - start <= CONFIRM);
    assert!(bench.inbox.unconfirmed.is_empty());
    bench.offer(&sample(10));
    assert_eq!(
        bench.questions().len(),
        1,
        "offered again it is asked again"
    );
}

#[test]
fn a_question_that_was_lost_is_repeated() {
    let mut bench = Bench::new("*/**");
    bench.offer(&sample(10));
    assert_eq!(bench.questions().len(), 1);
    for _ in 0..2 {
        match bench.inbox.poll(bench.now) {
            Step::Wait(Some(until)) => bench.now = until,
            step => panic!("{step:?}"),
        }
    }
    assert_eq!(bench.questions().len(), 1);
}

#[test]
fn offers_that_nobody_confirms_take_no_place() {
    let mut bench = Bench::new("*/**");
    for forged in 1..=1000 {
        bench.offer(&of("wombat-3", forged));
        for question in bench.questions() {
            bench.inbox.on_silence(bench.now, &question);
        }
        assert!(bench.inbox.unconfirmed.len() <= MAX_UNCONFIRMED_OF_ONE);
    }
    bench.take(&sample(10));
    bench.take(&of("wombat-3", 9));
}

#[test]
fn unconfirmed_offers_are_limited_by_robot_and_in_all() {
    let mut bench = Bench::new("*/**");
    let busy = Decision::Answer(Answer::Busy);
    // All of them are being asked, and none has answered.
    for robot in 0..MAX_UNCONFIRMED / MAX_UNCONFIRMED_OF_ONE {
        let robot = format!("robot-{robot}");
        for call in 1..=MAX_UNCONFIRMED_OF_ONE as u64 {
            assert_ne!(bench.offer(&of(&robot, call)), busy);
        }
        bench.questions();
        assert_eq!(bench.offer(&of(&robot, 99)), busy);
    }
    assert_eq!(bench.offer(&of("another", 1)), busy);
    bench.now += ASK * 2;
    bench.inbox.poll(bench.now);
    assert_ne!(bench.offer(&of("another", 1)), busy, "those were silent");
}

#[test]
fn only_what_is_wanted_is_taken() {
    let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
    for pattern in ["*/**", "wombat-1/map/*", "wombat-1/map/kitchen"] {
        Bench::new(pattern).take(&sample(10));
    }
    for pattern in ["wombat-3/**", "*/map", "*/log/*"] {
        let decision = Bench::new(pattern).offer(&sample(10));
        assert_eq!(decision, refused(Refusal::NotWanted), "{pattern}");
    }
    let too_large = refused(Refusal::TooLarge { limit_bytes: 1000 });
    for size in [1001, u64::MAX] {
        assert_eq!(Bench::new("*/**").offer(&sample(size)), too_large);
    }
    let mut bench = Bench::new("*/**");
    let nonsense = bench.inbox.on_offer(bench.now, b"nonsense");
    assert!(matches!(
        nonsense,
        Decision::Answer(Answer::Refused(Refusal::NotUnderstood(_)))
    ));
    assert!(bench.questions().is_empty(), "nobody is asked");
}

#[test]
fn the_same_offered_twice_is_one_transfer() {
    let mut bench = Bench::new("*/**");
    let id = bench.take(&sample(10));
    bench.inbox.on_held(id, 4);
    let known = Decision::Known(id, Answer::Running { held_bytes: 4 });
    assert_eq!(bench.offer(&sample(10)), known);
    assert!(bench.questions().is_empty(), "its sender has confirmed it");
    let restarted = Offer {
        call: 8,
        ..sample(10)
    };
    assert_eq!(bench.offer(&restarted), known, "its sender was restarted");
    let question = bench.questions().pop().expect("its sender is asked");
    let confirmed = bench.inbox.on_confirmed(&question, &restarted.encode());
    assert_eq!(confirmed, Some(Confirmed::Known(id)));
    bench.inbox.on_ended(id, &Ok(()));
    let done = Decision::Answer(Answer::Done);
    assert_eq!(bench.offer(&restarted), done);
    let again = Offer {
        call: 9,
        ..sample(10)
    };
    assert_eq!(
        bench.take(&again),
        id,
        "sent once more by the program's wish"
    );
}

#[test]
fn an_offer_in_its_senders_name_changes_nothing_of_a_transfer_that_runs() {
    let mut bench = Bench::new("*/**");
    let id = bench.take(&sample(10));
    let forged = Offer {
        call: 666,
        ..sample(10)
    };
    bench.offer(&forged);
    for question in bench.questions() {
        // The sender replies with its own offer.
        bench.inbox.on_confirmed(&question, &sample(10).encode());
    }
    bench.inbox.on_ended(id, &Ok(()));
    let done = Decision::Answer(Answer::Done);
    assert_eq!(bench.offer(&sample(10)), done, "it learns that it is over");
    bench.offer(&forged);
    let question = bench.questions().pop().expect("its sender is asked");
    let reply = sample(10).encode();
    assert_eq!(
        bench.inbox.on_confirmed(&question, &reply),
        None,
        "not again"
    );
}

#[test]
fn too_many_at_once_wait() {
    let mut bench = Bench::with_places("*/**", 2);
    let busy = Decision::Answer(Answer::Busy);
    let first = bench.take(&of("wombat-1", 1));
    assert_eq!(bench.offer(&of("wombat-1", 2)), busy, "half is for others");
    bench.take(&of("wombat-3", 1));
    assert_eq!(bench.offer(&of("wombat-4", 1)), busy);
    bench.inbox.on_ended(first, &Err(Fault::Stopped));
    bench.take(&of("wombat-4", 1));
}

#[test]
fn of_offers_that_are_confirmed_at_once_no_more_than_have_a_place_begin() {
    let mut bench = Bench::with_places("*/**", 2);
    let offers = ["a", "b", "c"].map(|robot| of(robot, 1));
    for offer in &offers {
        bench.offer(offer);
    }
    let mut taken = 0;
    for question in bench.questions() {
        let offer = offers.iter().find(|offer| offer.from == question.from);
        let reply = offer.expect("asked for").encode();
        taken += usize::from(bench.inbox.on_confirmed(&question, &reply).is_some());
    }
    assert_eq!((taken, bench.inbox.running.len()), (2, 2));
}

#[test]
fn one_program_that_takes_one_at_a_time_takes_it_of_anybody() {
    let mut bench = Bench::with_places("*/**", 1);
    let id = bench.take(&sample(1));
    bench.inbox.on_ended(id, &Ok(()));
    bench.take(&sample(2));
}

#[test]
fn what_failed_stays_failed_and_what_was_interrupted_may_go_on() {
    let mut bench = Bench::new("*/**");
    let full = Fault::NotKept("disk full".into());
    let id = bench.take(&sample(1));
    bench.inbox.on_ended(id, &Err(full.clone()));
    let answer = bench.offer(&sample(1));
    assert_eq!(answer, Decision::Answer(Answer::Failed(full)));
    for fault in [Fault::Silence(600), Fault::Stopped] {
        let id = bench.take(&sample(2));
        bench.inbox.on_ended(id, &Err(fault));
    }
    bench.take(&sample(2));
}

#[test]
fn it_remembers_so_many_and_no_more() {
    let mut bench = Bench::new("*/**");
    for call in 0..ENDED as u64 + 10 {
        let id = bench.take(&Offer { call, ..sample(1) });
        bench.inbox.on_ended(id, &Ok(()));
    }
    assert_eq!(bench.inbox.ended.len(), ENDED);
    bench
        .inbox
        .on_ended(sample(5).id(&name("wombat-2")), &Ok(()));
    assert_eq!(bench.inbox.ended.len(), ENDED, "one that it does not know");
}
