//! Tests of the sender.
use super::*;

fn sender(timeout: Option<Duration>) -> (Sender, Instant) {
    let now = Instant::now();
    (Sender::new(now, 1000, timeout, 42), now)
}

fn range(offset: u64, received_bytes: u64) -> Request {
    Request::Range {
        offset,
        length: 100,
        received_bytes,
    }
}

/// Returns when it repeats the offer.
fn offers_at(sender: &mut Sender, now: Instant) -> Instant {
    match sender.poll(now) {
        Step::Wait(until) => until,
        step => panic!("{step:?}"),
    }
}

#[test]
fn the_pause_between_unanswered_offers_grows() {
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
        "pauses vary: {pauses:?}"
    );
}

#[test]
fn does_not_repeat_the_offer_while_the_receiver_is_active() {
    let (mut sender, mut now) = sender(None);
    sender.poll(now);
    sender.on_answers(now, &[Answer::Running { received_bytes: 0 }]);
    for n in 0..10 {
        now += Duration::from_secs(1);
        assert_eq!(
            sender.on_request(now, &range(n * 100, n * 100)),
            Ok(Response::Piece(n * 100..n * 100 + 100))
        );
        assert_eq!(offers_at(&mut sender, now), now + QUIET);
    }
    assert_eq!(sender.progress().received_bytes, 900);
    now += QUIET;
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "quiet for too long"
    );
}

#[test]
fn asks_for_the_outcome_as_soon_as_the_receiver_has_finished() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    assert!(sender.on_request(now, &Request::Ended).is_ok());
    sender.on_answers(now, &[Answer::Running { received_bytes: 0 }]);
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "reported while an offer was in flight"
    );
    sender.on_answers(
        now,
        &[Answer::Running {
            received_bytes: 900,
        }],
    );
    assert!(sender.on_request(now, &Request::Ended).is_ok());
    assert!(
        matches!(sender.poll(now), Step::Offer(_)),
        "reported while it waited"
    );
    sender.on_answers(now, &[Answer::Done]);
    assert_eq!(sender.poll(now), Step::Finished(Outcome::Done));
    assert_eq!(sender.progress().fraction(), 1.0);
    assert!(
        sender.on_request(now, &range(0, 0)).is_ok(),
        "late requests are answered"
    );
    sender.on_fault(Fault::Checksum);
    assert_eq!(
        sender.poll(now),
        Step::Finished(Outcome::Done),
        "the outcome is final"
    );
}

#[test]
fn a_running_program_takes_precedence_over_other_answers() {
    let running = || Answer::Running { received_bytes: 1 };
    let failed = || Answer::Failed(Fault::Checksum);
    let not_accepted = || Answer::Refused(Refusal::NotAccepted);
    let too_large = || Answer::Refused(Refusal::TooLarge { limit_bytes: 1 });
    let cases = [
        (vec![], None),
        (vec![Answer::Done, running()], Some(running())),
        (vec![not_accepted(), Answer::Busy], Some(Answer::Busy)),
        (
            vec![not_accepted(), Answer::Done, Answer::NotTaken],
            Some(Answer::Done),
        ),
        (
            vec![not_accepted(), failed(), Answer::NotTaken],
            Some(Answer::NotTaken),
        ),
        (vec![not_accepted(), failed()], Some(failed())),
        (vec![not_accepted(), too_large()], Some(too_large())),
        (vec![not_accepted()], Some(not_accepted())),
    ];
    for (answers, expected) in cases {
        assert_eq!(combined(&answers), expected.as_ref(), "{answers:?}");
    }
}

/// Offers the transfer until it has ended, and returns the outcome and how long it took.
fn answered(answers: &[Answer], timeout: Duration) -> (Outcome, Duration) {
    let (mut sender, start) = sender(Some(timeout));
    let mut now = start;
    loop {
        match sender.poll(now) {
            Step::Offer(_) => sender.on_answers(now, answers),
            Step::Wait(until) => now = until,
            Step::Finished(outcome) => return (outcome, now - start),
        }
        if now > start + timeout * 100 {
            panic!("{answers:?}: no outcome");
        }
    }
}

#[test]
fn fails_after_the_timeout() {
    let timeout = Duration::from_secs(30);
    let (outcome, took) = answered(&[], timeout);
    assert!(matches!(outcome, Outcome::NoAnswer(silent) if silent > timeout));
    assert!(took < timeout + LAST_PAUSE * 2);
}

#[test]
fn fails_after_the_timeout_if_the_program_takes_no_transfers() {
    let timeout = Duration::from_secs(30);
    // Another program of that robot receives other topics.
    let others = Answer::Refused(Refusal::NotAccepted);
    for answers in [&[Answer::NotTaken][..], &[others, Answer::NotTaken]] {
        let (outcome, took) = answered(answers, timeout);
        assert!(matches!(outcome, Outcome::NotTaken(untaken) if untaken > timeout));
        assert!(took < timeout + LAST_PAUSE * 2);
    }
}

#[test]
fn an_offer_without_answers_times_out() {
    let (mut sender, now) = sender(None);
    assert!(matches!(sender.poll(now), Step::Offer(_)));
    let until = offers_at(&mut sender, now);
    assert_eq!(until, now + ANSWER);
    assert!(
        offers_at(&mut sender, until) > until,
        "like an offer without answers"
    );
    sender.on_answers(until, &[Answer::Done]);
    assert!(
        !matches!(sender.poll(until), Step::Finished(_)),
        "an answer without an offer"
    );
}

#[test]
fn rejects_requests_beyond_the_end() {
    let (mut sender, now) = sender(None);
    assert!(matches!(
        sender.on_request(now, &range(950, 0)),
        Err(Fault::Protocol(_))
    ));
    assert!(sender.on_request(now, &range(900, u64::MAX)).is_ok());
    assert_eq!(
        sender.progress().received_bytes,
        1000,
        "limited to the size"
    );
}

#[test]
fn confirms_its_offer_until_it_has_finished() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    let confirm = Request::Confirm;
    assert_eq!(sender.on_request(now, &confirm), Ok(Response::Offer));
    sender.on_answers(now, &[Answer::Done]);
    assert_eq!(sender.on_request(now, &confirm), Err(Fault::Stopped));
}

#[test]
fn holds_the_reply_to_an_end_until_a_later_offer_is_answered() {
    let (mut sender, now) = sender(None);
    sender.poll(now);
    // The first offer may have been answered before the transfer ended.
    let held = sender.on_request(now, &Request::Ended);
    assert_eq!(held, Ok(Response::AfterOffer(2)));
    sender.on_answers(now, &[Answer::Running { received_bytes: 0 }]);
    assert!(matches!(sender.poll(now), Step::Offer(_)), "the second");
    sender.on_answers(now, &[Answer::Running { received_bytes: 0 }]);
    let held = sender.on_request(now, &Request::Ended);
    assert_eq!(held, Ok(Response::AfterOffer(3)));
}
