//! Runs the program of a simulated robot: it publishes the angle of an arm and serves the state of a battery.
use std::{
    sync::mpsc::{self, RecvTimeoutError, Sender},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use rect_core::{
    catalogue::{self, token::Token, Instance, ServiceEntry, REGISTER},
    message::attachment::{Attachment, Sent},
    name::{key::KeySpace, topic::Topic, Name},
};
use serde_json::json;
use zenoh::{bytes::Encoding, liveliness::LivelinessToken, query::Query, Session, Wait};

use super::Failure;
use crate::registry::now_s;

/// Interval at which the angle is published.
const PUBLISH_INTERVAL: Duration = Duration::from_secs(1);
/// State of the battery. A text, because the order of the fields of a JSON value depends on features of the build.
const BATTERY: &str = r#"{"volts":12.4,"percent":83}"#;
/// Timeout for the registration of the program.
const REGISTRATION_TIMEOUT: Duration = Duration::from_secs(10);
/// Timeout for the liveliness tokens of the other robots.
const TOKENS_TIMEOUT: Duration = Duration::from_secs(2);

/// A running program. Dropping it stops it.
pub struct Program {
    session: Session,
    fleet: Name,
    publishing: Option<(Sender<()>, JoinHandle<()>)>,
    _token: Option<LivelinessToken>,
}

impl Program {
    /// Starts the program of a robot. If it is not `active`, it publishes and serves nothing.
    ///
    /// # Errors
    /// Fails if the publisher or the service cannot be declared.
    pub fn start(
        session: Session,
        fleet: &Name,
        robot: &str,
        active: bool,
    ) -> Result<Self, Failure> {
        let publishing = active
            .then(|| publish(&session, fleet, robot))
            .transpose()?;
        let token = active.then(|| serve(&session, fleet, robot)).transpose()?;
        Ok(Self {
            session,
            fleet: fleet.clone(),
            publishing,
            _token: token,
        })
    }

    /// Returns whether at least `count` other robots are present.
    pub fn has_peers(&self, count: usize) -> bool {
        let tokens = self
            .session
            .liveliness()
            .get(format!("{}/*/@rect/alive/*", self.fleet));
        let tokens = tokens.timeout(TOKENS_TIMEOUT).wait();
        let present = tokens
            .into_iter()
            .flatten()
            .filter(|reply| reply.result().is_ok());
        present.count() > count
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

/// Starts a thread that publishes the angle until the returned sender is dropped.
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
            if stopped.recv_timeout(PUBLISH_INTERVAL) != Err(RecvTimeoutError::Timeout) {
                return;
            }
            // One period takes ten seconds.
            let degrees =
                45.0 * (start.elapsed().as_secs_f64() * std::f64::consts::TAU / 10.0).sin();
            let attachment = Attachment {
                source,
                sequence,
                sent: Sent::At((now_s() * 1000.0) as u64),
                lifetime_ms: None,
            };
            let put = publisher.put(json!({ "degrees": degrees.round() as i64 }).to_string());
            let put = put
                .encoding(Encoding::APPLICATION_JSON)
                .attachment(attachment.encode().to_vec());
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

/// Serves the state of the battery until the session is closed.
fn serve(session: &Session, fleet: &Name, robot: &str) -> Result<LivelinessToken, Failure> {
    let token = announce(session, fleet, robot)?;
    let key = format!("{fleet}/{robot}/battery");
    let key_of_answer = key.clone();
    let answer = move |query: Query| {
        let reply = query
            .reply(&key_of_answer, BATTERY)
            .encoding(Encoding::APPLICATION_JSON);
        // Sending fails if the requester has disconnected.
        let _ = reply.wait();
    };
    let queryable = session.declare_queryable(key).complete(true);
    let queryable = queryable.callback(answer);
    queryable.background().wait()?;
    Ok(token)
}

/// Adds the program to the catalogue of its robot, as the library does. It stays there until the session is closed.
fn announce(session: &Session, fleet: &Name, robot: &str) -> Result<LivelinessToken, Failure> {
    let place = KeySpace {
        fleet: fleet.clone(),
        robot: Name::new(robot)?,
    };
    let battery = ServiceEntry::new(Topic::new("battery")?, "the voltage and the charge", false);
    let id = session.zid().to_le_bytes();
    let program = catalogue::Program {
        name: Some(Name::new("arm")?),
        instance: Instance(u32::from_le_bytes([id[0], id[1], id[2], id[3]])),
        services: vec![battery],
    };
    let token = Token {
        robot: place.robot.clone(),
        program: program.name.clone(),
        instance: program.instance,
        revision: 0,
    };
    let key = place.own(Some(&place.robot), REGISTER);
    let deadline = Instant::now() + REGISTRATION_TIMEOUT;
    // The router may answer a moment before it keeps a catalogue.
    while session
        .get(&key)
        .payload(program.to_json())
        .wait()?
        .recv()
        .is_err()
    {
        if Instant::now() > deadline {
            return Err(format!("the router of {robot} keeps no catalogue").into());
        }
        thread::sleep(Duration::from_millis(50));
    }
    let token = session.liveliness().declare_token(token.key(fleet));
    token.wait()
}
