//! Tests of the sender.
use super::*;

fn sender(patience: Option<Duration>) -> (Sender, Instant) {
    let now = Instant::now();
    (Sender::new(now, 1000, patience, 42), now)
}

fn range(offset: u64, held_bytes: u64) -> Request {
    Request::Range {
        offset,
        length: 100,
        held_bytes,
    }
}

/// When it offers next.
fn offers_at(sender: &mut Sender, now: Instant) -> Instant {
    match sender.poll(now) {
        Step::Wait(until) => until,
        step => panic!("{step:?}"),
    }
}

#[test]
fn it_offers_less_and_less_often_where_nobody_answers() {
    let (mut sender, mut now) = sender(None);
    let mut pauses = Vec::new();
    for _ in 0..20 {
        assert!(matches!(sender.poll(now), Step::Offer(_)));
        sender.on_answers(now, &[]);
        let next = offers_at(&mut sender, now);
        pauses.push(next - now);
        now = next;
    }
    assert!(pauses[0] < FIRST_PAUSE * 2, "{pauses:?}");
    assert!(
        pauses
            .iter()
            .all(|&pause| pause <= LAST_PAUSE.mul_f64(1.25)),
        "{pauses:?}"
    );
    assert!(
        pauses[19] >= LAST_PAUSE && pauses[19] != pauses[18],
        "they vary: {pauses:?}"
    );
}

#[test]
fn it_does_not_ask_while_the_receiver_works() {
    let (mut sender, mut now) = sender(None);
    sender.poll(now);
    sender.on_answers(now, &[Answer::Running { held_bytes: 0 }]);
    for n in 0..10 {
        now += Duration::from_secs(1);
        assert_eq!(
            sender.on_request(now, &range(n * 100, n * 100)),
            Ok(Response::Piece(n * 100..n * 100 + 100))
        );
        assert_eq!(offers_at(&mut sender, now), now + QUIET);
    }
    assert_eq!(sender.progress().held_bytes, 900);
    now += QUIET;
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "quiet for too long"
    );
}

#[test]
fn told_that_it_ended_it_asks_how_at_once() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    assert!(sender.on_request(now, &Request::Ended).is_ok());
    sender.on_answers(now, &[Answer::Running { held_bytes: 0 }]);
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "told while an offer was out"
    );
    sender.on_answers(now, &[Answer::Running { held_bytes: 900 }]);
    assert!(sender.on_request(now, &Request::Ended).is_ok());
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "told while it waited"
    );
    sender.on_answers(now, &[Answer::Done]);
    assert_eq!(sender.poll(now), Step::Over(Outcome::Done));
    assert_eq!(sender.progress().fraction(), 1.0);
    assert!(
        sender.on_request(now, &range(0, 0)).is_ok(),
        "a late one is answered"
    );
    sender.on_fault(Fault::Checksum);
    assert_eq!(sender.poll(now), Step::Over(Outcome::Done), "over is over");
}

#[test]
fn of_several_answers_the_one_that_works_on_it_counts() {
    let running = Answer::Running { held_bytes: 1 };
    let failed = || Answer::Failed(Fault::Checksum);
    let not_wanted = || Answer::Refused(Refusal::NotWanted);
    let too_large = || Answer::Refused(Refusal::TooLarge { limit_bytes: 1 });
    let cases = [
        (vec![], None),
        (vec![Answer::Done, running], None),
        (vec![not_wanted(), Answer::Busy], None),
        (
            vec![not_wanted(), Answer::Done, failed()],
            Some(Outcome::Done),
        ),
        (
            vec![not_wanted(), failed()],
            Some(Outcome::Failed(Fault::Checksum)),
        ),
        (
            vec![not_wanted(), too_large()],
            Some(Outcome::Refused(Refusal::TooLarge { limit_bytes: 1 })),
        ),
        (
            vec![not_wanted()],
            Some(Outcome::Refused(Refusal::NotWanted)),
        ),
    ];
    for (answers, expected) in cases {
        assert_eq!(settled(&answers), expected, "{answers:?}");
    }
}

#[test]
fn it_waits_as_long_as_it_is_told_to() {
    let patience = Duration::from_secs(30);
    let (mut sender, start) = sender(Some(patience));
    let mut now = start;
    let outcome = loop {
        match sender.poll(now) {
            Step::Offer(_) => sender.on_answers(now, &[]),
            Step::Wait(until) => now = until,
            Step::Over(outcome) => break outcome,
        }
    };
    assert!(matches!(outcome, Outcome::Unanswered(silent) if silent > patience));
    assert!(now < start + patience + LAST_PAUSE * 2);
}

#[test]
fn an_offer_that_is_never_answered_is_given_up() {
    let (mut sender, now) = sender(None);
    assert!(matches!(sender.poll(now), Step::Offer(_)));
    let until = offers_at(&mut sender, now);
    assert_eq!(until, now + ANSWER);
    assert!(
        offers_at(&mut sender, until) > until,
        "as if nobody had answered"
    );
    sender.on_answers(until, &[Answer::Done]);
    assert!(
        !matches!(sender.poll(until), Step::Over(_)),
        "an answer to no offer"
    );
}

#[test]
fn what_is_not_there_can_not_be_asked_for() {
    let (mut sender, now) = sender(None);
    assert!(matches!(
        sender.on_request(now, &range(950, 0)),
        Err(Fault::Protocol(_))
    ));
    assert!(sender.on_request(now, &range(900, u64::MAX)).is_ok());
    assert_eq!(sender.progress().held_bytes, 1000, "no more than there is");
}

#[test]
fn confirms_its_offer_until_it_is_over() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    let confirm = Request::Confirm;
    assert_eq!(sender.on_request(now, &confirm), Ok(Response::Offer));
    sender.on_answers(now, &[Answer::Done]);
    assert_eq!(sender.on_request(now, &confirm), Err(Fault::Stopped));
}

#[test]
fn a_receivers_end_is_held_until_a_later_offer_is_answered() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    // The first offer may have been answered before the transfer ended.
    let held = sender.on_request(now, &Request::Ended);
    assert_eq!(held, Ok(Response::AfterOffer(2)));
    sender.on_answers(now, &[Answer::Running { held_bytes: 0 }]);
    assert!(matches!(sender.poll(now), Step::Offer(_)), "the second");
    sender.on_answers(now, &[Answer::Running { held_bytes: 0 }]);
    let held = sender.on_request(now, &Request::Ended);
    assert_eq!(held, Ok(Response::AfterOffer(3)));
}
