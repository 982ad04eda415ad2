//! Tests of the admission.
use super::*;
use crate::transfer::offer::sample;

/// An admission with its time.
struct Bench {
    admission: Admission,
    now: Instant,
}

fn name(text: &str) -> Name {
    Name::new(text).expect("valid name")
}

impl Bench {
    fn new(pattern: &str) -> Self {
        Self::with_max_concurrent(pattern, 4)
    }

    fn with_max_concurrent(pattern: &str, max_concurrent: usize) -> Self {
        let rules = AdmissionRules {
            pattern: Pattern::new(pattern).expect("valid pattern"),
            max_bytes: 1000,
            max_concurrent,
        };
        let (admission, now) = (Admission::new(name("wombat-2"), rules), Instant::now());
        Self { admission, now }
    }

    fn offer(&mut self, offer: &Offer) -> Decision {
        self.admission.on_offer(self.now, &offer.encode())
    }

    fn questions(&mut self) -> Vec<Question> {
        let mut questions = Vec::new();
        while let Step::Ask(question) = self.admission.poll(self.now) {
            questions.push(question);
        }
        questions
    }

    /// Makes the offer, and confirms it as its sender would.
    fn confirmed(&mut self, offer: &Offer) -> Option<Confirmed> {
        let answer = self.offer(offer);
        assert_eq!(
            answer,
            Decision::Answer(Answer::Running { received_bytes: 0 })
        );
        let question = self.questions().pop().expect("its sender is asked");
        self.admission.on_confirmed(&question, &offer.encode())
    }

    fn accept(&mut self, offer: &Offer) -> TransferId {
        match self.confirmed(offer) {
            Some(Confirmed::Accept(id, accepted)) if *accepted == *offer => id,
            other => panic!("{other:?}"),
        }
    }
}

fn of(sender: &str, call: u64) -> Offer {
    let sender = name(sender);
    Offer {
        sender,
        call,
        size_bytes: call,
        ..sample(1)
    }
}

#[test]
fn accepts_an_offer_only_after_its_sender_confirmed_it() {
    for size in [0, 10] {
        let mut bench = Bench::new("*/**");
        let offer = sample(size);
        bench.offer(&offer);
        let question = bench.questions().pop().expect("its sender is asked");
        assert_eq!(
            (question.id, &question.sender),
            (offer.id(&name("wombat-2")), &offer.sender)
        );
        assert!(bench.admission.running.is_empty(), "nothing has begun");
        let wrong = [
            Vec::new(),
            b"yes".to_vec(),
            of("wombat-1", 3).encode(),
            Offer {
                sender: name("wombat-3"),
                ..offer.clone()
            }
            .encode(),
        ];
        for reply in wrong {
            assert_eq!(bench.admission.on_confirmed(&question, &reply), None);
        }
        let reply = offer.encode();
        let accepted = bench.admission.on_confirmed(&question, &reply);
        assert_eq!(
            accepted,
            Some(Confirmed::Accept(question.id, Box::new(offer)))
        );
    }
}

#[test]
fn repeats_the_question_for_ten_seconds() {
    let mut bench = Bench::new("*/**");
    let start = bench.now;
    bench.offer(&sample(10));
    let mut asked = 0;
    loop {
        for question in bench.questions() {
            asked += 1;
            bench.admission.on_no_reply(bench.now, &question);
        }
        match bench.admission.poll(bench.now) {
            Step::Wait(Some(until)) => bench.now = until,
            Step::Wait(None) => break,
            Step::Ask(_) => {}
        }
    }
    assert!(asked > 3, "{asked}");
    assert!(bench.now - start <= CONFIRM);
    assert!(bench.admission.unconfirmed.is_empty());
    bench.offer(&sample(10));
    assert_eq!(
        bench.questions().len(),
        1,
        "a new offer is followed by a new question"
    );
}

#[test]
fn repeats_a_lost_question() {
    let mut bench = Bench::new("*/**");
    bench.offer(&sample(10));
    assert_eq!(bench.questions().len(), 1);
    for _ in 0..2 {
        match bench.admission.poll(bench.now) {
            Step::Wait(Some(until)) => bench.now = until,
            step => panic!("{step:?}"),
        }
    }
    assert_eq!(bench.questions().len(), 1);
}

#[test]
fn unconfirmed_offers_do_not_block_others() {
    let mut bench = Bench::new("*/**");
    for forged in 1..=1000 {
        bench.offer(&of("wombat-3", forged));
        for question in bench.questions() {
            bench.admission.on_no_reply(bench.now, &question);
        }
        assert!(bench.admission.unconfirmed.len() <= MAX_UNCONFIRMED_OF_ONE);
    }
    bench.accept(&sample(10));
    bench.accept(&of("wombat-3", 9));
}

#[test]
fn unconfirmed_offers_are_limited_per_robot_and_in_total() {
    let mut bench = Bench::new("*/**");
    let busy = Decision::Answer(Answer::Busy);
    // All robots are being asked, and none has replied.
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
    bench.admission.poll(bench.now);
    assert_ne!(
        bench.offer(&of("another", 1)),
        busy,
        "the others did not reply"
    );
}

#[test]
fn accepts_only_offers_that_match_the_rules() {
    let refused = |refusal| Decision::Answer(Answer::Refused(refusal));
    for pattern in ["*/**", "wombat-1/map/*", "wombat-1/map/kitchen"] {
        Bench::new(pattern).accept(&sample(10));
    }
    for pattern in ["wombat-3/**", "*/map", "*/log/*"] {
        let decision = Bench::new(pattern).offer(&sample(10));
        assert_eq!(decision, refused(Refusal::NotAccepted), "{pattern}");
    }
    let too_large = refused(Refusal::TooLarge { limit_bytes: 1000 });
    for size in [1001, u64::MAX] {
        assert_eq!(Bench::new("*/**").offer(&sample(size)), too_large);
    }
    let mut bench = Bench::new("*/**");
    let nonsense = bench.admission.on_offer(bench.now, b"nonsense");
    assert!(matches!(
        nonsense,
        Decision::Answer(Answer::Refused(Refusal::InvalidOffer(_)))
    ));
    assert!(bench.questions().is_empty(), "no robot is asked");
}

#[test]
fn a_repeated_offer_is_the_same_transfer() {
    let mut bench = Bench::new("*/**");
    let id = bench.accept(&sample(10));
    bench.admission.on_received_bytes(id, 4);
    let known = Decision::Running(id, Answer::Running { received_bytes: 4 });
    assert_eq!(bench.offer(&sample(10)), known);
    assert!(bench.questions().is_empty(), "its sender has confirmed it");
    let restarted = Offer {
        call: 8,
        ..sample(10)
    };
    assert_eq!(bench.offer(&restarted), known, "its sender was restarted");
    let question = bench.questions().pop().expect("its sender is asked");
    let confirmed = bench.admission.on_confirmed(&question, &restarted.encode());
    assert_eq!(confirmed, Some(Confirmed::Running(id)));
    bench.admission.on_ended(id, &Ok(()));
    let done = Decision::Answer(Answer::Done);
    assert_eq!(bench.offer(&restarted), done);
    let again = Offer {
        call: 9,
        ..sample(10)
    };
    assert_eq!(bench.accept(&again), id, "sent again by the program");
}

#[test]
fn a_forged_offer_does_not_affect_a_running_transfer() {
    let mut bench = Bench::new("*/**");
    let id = bench.accept(&sample(10));
    let forged = Offer {
        call: 666,
        ..sample(10)
    };
    bench.offer(&forged);
    for question in bench.questions() {
        // The sender replies with its own offer.
        bench
            .admission
            .on_confirmed(&question, &sample(10).encode());
    }
    bench.admission.on_ended(id, &Ok(()));
    let done = Decision::Answer(Answer::Done);
    assert_eq!(
        bench.offer(&sample(10)),
        done,
        "the sender learns the outcome"
    );
    bench.offer(&forged);
    let question = bench.questions().pop().expect("its sender is asked");
    let reply = sample(10).encode();
    assert_eq!(
        bench.admission.on_confirmed(&question, &reply),
        None,
        "not accepted again"
    );
}

#[test]
fn limits_concurrent_transfers() {
    let mut bench = Bench::with_max_concurrent("*/**", 2);
    let busy = Decision::Answer(Answer::Busy);
    let first = bench.accept(&of("wombat-1", 1));
    assert_eq!(
        bench.offer(&of("wombat-1", 2)),
        busy,
        "half of them are for other senders"
    );
    bench.accept(&of("wombat-3", 1));
    assert_eq!(bench.offer(&of("wombat-4", 1)), busy);
    bench.admission.on_ended(first, &Err(Fault::Stopped));
    bench.accept(&of("wombat-4", 1));
}

#[test]
fn simultaneous_confirmations_respect_the_limit() {
    let mut bench = Bench::with_max_concurrent("*/**", 2);
    let offers = ["a", "b", "c"].map(|robot| of(robot, 1));
    for offer in &offers {
        bench.offer(offer);
    }
    let mut accepted = 0;
    for question in bench.questions() {
        let offer = offers.iter().find(|offer| offer.sender == question.sender);
        let reply = offer.expect("asked for").encode();
        accepted += usize::from(bench.admission.on_confirmed(&question, &reply).is_some());
    }
    assert_eq!((accepted, bench.admission.running.len()), (2, 2));
}

#[test]
fn a_limit_of_one_admits_any_sender() {
    let mut bench = Bench::with_max_concurrent("*/**", 1);
    let id = bench.accept(&sample(1));
    bench.admission.on_ended(id, &Ok(()));
    bench.accept(&sample(2));
}

#[test]
fn failed_transfers_stay_failed_and_interrupted_ones_continue() {
    let mut bench = Bench::new("*/**");
    let full = Fault::NotStored("disk full".into());
    let id = bench.accept(&sample(1));
    bench.admission.on_ended(id, &Err(full.clone()));
    let answer = bench.offer(&sample(1));
    assert_eq!(answer, Decision::Answer(Answer::Failed(full)));
    for fault in [Fault::TimedOut(600), Fault::Stopped] {
        let id = bench.accept(&sample(2));
        bench.admission.on_ended(id, &Err(fault));
    }
    bench.accept(&sample(2));
}

#[test]
fn memory_of_finished_transfers_is_bounded() {
    let mut bench = Bench::new("*/**");
    for call in 0..ENDED as u64 + 10 {
        let id = bench.accept(&Offer { call, ..sample(1) });
        bench.admission.on_ended(id, &Ok(()));
    }
    assert_eq!(bench.admission.ended.len(), ENDED);
    bench
        .admission
        .on_ended(sample(5).id(&name("wombat-2")), &Ok(()));
    assert_eq!(bench.admission.ended.len(), ENDED, "an unknown transfer");
}

#[test]
fn a_program_that_takes_nothing_has_no_room() {
    let mut bench = Bench::new("*/**");
    let offers = [1, 2, 3].map(|call| of("wombat-1", call));
    let first = bench.accept(&offers[0]);
    let second = bench.accept(&offers[1]);
    let answer = |bench: &mut Bench, offer| match bench.offer(offer) {
        Decision::Running(_, answer) | Decision::Answer(answer) => answer,
    };
    bench.admission.on_untaken(first);
    assert_eq!(answer(&mut bench, &offers[0]), Answer::NotTaken);
    let running = Answer::Running { received_bytes: 0 };
    assert_eq!(answer(&mut bench, &offers[1]), running);
    assert_eq!(answer(&mut bench, &offers[2]), Answer::Busy, "one arrives");
    bench.admission.on_untaken(second);
    assert_eq!(answer(&mut bench, &offers[2]), Answer::NotTaken);
    // The places of other senders are free.
    bench.accept(&of("wombat-3", 4));
    bench.admission.on_ended(first, &Ok(()));
    assert_eq!(answer(&mut bench, &offers[0]), Answer::Done);
    bench.accept(&offers[2]);
}

#[test]
fn transfers_without_progress_do_not_keep_out_others() {
    let mut bench = Bench::with_max_concurrent("*/**", 2);
    let (silent, lively) = (of("wombat-3", 1), of("wombat-4", 2));
    bench.accept(&silent);
    let id = bench.accept(&lively);
    let others = [5, 6, 7].map(|robot| of(&format!("wombat-{robot}"), robot));
    let busy = Decision::Answer(Answer::Busy);
    assert_eq!(bench.offer(&others[0]), busy);
    bench.now += SILENT / 2;
    bench.admission.on_received_bytes(id, 1);
    assert_eq!(bench.offer(&others[0]), busy);
    // One of the two has been silent for a while, and the other one has progressed since.
    bench.now += SILENT / 2;
    bench.accept(&others[0]);
    assert_eq!(bench.offer(&others[1]), busy);
    // A silent transfer continues; those that are silent are bounded, too.
    assert!(matches!(bench.offer(&silent), Decision::Running(..)));
    bench.now += SILENT;
    bench.accept(&others[1]);
    assert_eq!(bench.offer(&others[2]), busy);
}
