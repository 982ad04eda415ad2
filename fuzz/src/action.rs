//! Reads what others send about actions: orders, states and feedback. Whatever is ordered, one goal runs at a time, none twice while it
//! is kept, and few are kept.
use std::{collections::BTreeSet, time::Instant};

use rect_core::{
    action::{
        server::{ActionServer, Outcome, Publication, Rules, Work},
        state::{Feedback, GoalState},
    },
    message::{encoding::Encoding, payload::Payload},
    name::Name,
};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let now = Instant::now();
    let mut server = ActionServer::new(None, Rules::default());
    let client = Name::new("laptop").ok();
    let (mut begun, mut running) = (BTreeSet::new(), None);
    for part in input.split(|byte| *byte == 0xFF) {
        for encoding in [Encoding::CBOR, Encoding::JSON] {
            let payload = Payload::new(part.to_vec(), encoding);
            if let Ok(state) = GoalState::read(&payload) {
                assert!(!state.reason.chars().any(|c| c.is_control() && c != '\n'));
                assert_eq!(
                    GoalState::read(&state.write()).map(|read| read.phase),
                    Ok(state.phase)
                );
            }
            if let Ok(feedback) = Feedback::read(&payload) {
                assert!(feedback
                    .progress
                    .is_none_or(|progress| (0.0..=1.0).contains(&progress)));
                let _ = feedback.write();
            }
            server.on_earlier("earlier", &payload, now, 0);
            server.on_order(1, client.as_ref(), &payload, 0);
            loop {
                match server.work(now, 0) {
                    Work::Run { id, .. } => {
                        assert_eq!(running.replace(id.clone()), None);
                        assert!(begun.insert(id));
                    }
                    Work::Wait(_) => match server.publication(now) {
                        Publication::State { id, .. } => server.on_published(&id, Ok(()), now, 0),
                        Publication::Forget { id } => {
                            begun.remove(&id);
                        }
                        Publication::Wait(_) => break,
                        _ => {}
                    },
                    Work::Cancel { id, .. } => {
                        assert_eq!(running.take().as_ref(), Some(&id));
                        server.on_end(&id, Outcome::Cancelled, 0);
                    }
                    Work::Reply { .. } => {}
                }
            }
            assert!(server.open().len() <= 8);
        }
    }
}
