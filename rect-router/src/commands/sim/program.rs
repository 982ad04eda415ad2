//! Owns the program of a simulated robot: it publishes the angle of an arm and serves the state of a battery.
use std::{
    sync::mpsc::{self, RecvTimeoutError, Sender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rect::core::{
    attachment::{Attachment, Sent},
    name::Name,
};
use serde_json::json;
use zenoh::{bytes::Encoding, query::Query, Session, Wait};

use super::Failure;
use crate::registry::now_s;

/// How often the angle is published.
const EVERY: Duration = Duration::from_secs(1);
/// How long to wait for the liveliness tokens of the other robots.
const TOKENS_TIMEOUT: Duration = Duration::from_secs(2);

/// A running program. It ends when it is dropped.
pub struct Program {
    session: Session,
    fleet: Name,
    publishing: Option<(Sender<()>, JoinHandle<()>)>,
}

impl Program {
    /// Starts the program of a robot. One that is not `active` publishes and serves nothing.
    pub fn start(
        session: Session,
        fleet: &Name,
        robot: &str,
        active: bool,
    ) -> Result<Self, Failure> {
        let publishing = active
            .then(|| publish(&session, fleet, robot))
            .transpose()?;
        if active {
            serve(&session, fleet, robot)?;
        }
        Ok(Self {
            session,
            fleet: fleet.clone(),
            publishing,
        })
    }

    /// Returns whether that many other robots are present.
    pub fn has_peers(&self, count: usize) -> bool {
        let tokens = self
            .session
            .liveliness()
            .get(format!("{}/*/@rect/alive/*", self.fleet));
        let tokens = tokens.timeout(TOKENS_TIMEOUT).wait();
        let there = tokens
            .into_iter()
            .flatten()
            .filter(|reply| reply.result().is_ok());
        there.count() > count
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        if let Some((stop, thread)) = self.publishing.take() {
            drop(stop);
            let _ = thread.join();
        }
        let _ = self.session.close().wait();
    }
}

/// Publishes until the sender is dropped.
fn publish(
    session: &Session,
    fleet: &Name,
    robot: &str,
) -> Result<(Sender<()>, JoinHandle<()>), Failure> {
    let publisher = session
        .declare_publisher(format!("{fleet}/{robot}/arm/angle"))
        .wait()?;
    let (stop, stopped) = mpsc::channel::<()>();
    let start = Instant::now();
    let source = u16::try_from(std::process::id() & 0xffff).unwrap_or_default();
    let work = move || {
        for sequence in 0.. {
            if stopped.recv_timeout(EVERY) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            // Up and down once in ten seconds.
            let degrees =
                45.0 * (start.elapsed().as_secs_f64() * std::f64::consts::TAU / 10.0).sin();
            let attachment = Attachment {
                source,
                sequence,
                sent: Sent::At((now_s() * 1000.0) as u64),
            };
            let put = publisher.put(json!({ "degrees": degrees.round() as i64 }).to_string());
            let put = put
                .encoding(Encoding::APPLICATION_JSON)
                .attachment(attachment.encode());
            if put.wait().is_err() {
                return;
            }
        }
    };
    let thread = thread::Builder::new()
        .name(format!("{robot} arm"))
        .spawn(work)?;
    Ok((stop, thread))
}

fn serve(session: &Session, fleet: &Name, robot: &str) -> Result<(), Failure> {
    let key = format!("{fleet}/{robot}/battery");
    let key_of_answer = key.clone();
    let answer = move |query: Query| {
        let battery = json!({ "volts": 12.4, "percent": 83 }).to_string();
        let reply = query
            .reply(&key_of_answer, battery)
            .encoding(Encoding::APPLICATION_JSON);
        // The one who asked may be gone.
        let _ = reply.wait();
    };
    let queryable = session.declare_queryable(key).callback(answer);
    queryable.background().wait()?;
    Ok(())
}
