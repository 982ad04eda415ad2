//! Serves the catalogue of the robot's programs: `<fleet>/<robot>/@rect/catalogue` (docs/reference/registry.md).
use std::{
    sync::{mpsc::Receiver, Arc},
    thread,
    time::{Duration, Instant},
};

use parking_lot::Mutex;
use rect_core::{
    catalogue::{
        keeper::{Keeper, Refused},
        token::{tokens, Token},
        Instance, Program, CATALOGUE, REGISTER,
    },
    name::{key::KeySpace, topic::Topic},
    session::{
        requester_end,
        service::{taken_over, PING},
    },
};
use serde::Serialize;
use zenoh::{
    bytes::ZBytes,
    query::{Query, QueryTarget},
    sample::{Sample, SampleKind},
    Session, Wait,
};

use crate::reply;

/// How long a program that serves a topic may take to answer before another one takes it over.
const PING_TIMEOUT: Duration = Duration::from_secs(1);
/// The pause before a program is asked again whose service nobody serves.
const PING_PAUSE: Duration = Duration::from_millis(50);
/// How long the notice that its service has ended may wait for a program that does not answer.
const TAKEN_OVER_TIMEOUT: Duration = Duration::from_secs(60);
/// The maximum number of registrations that wait for the one in progress; further ones are answered with an error.
const MAX_WAITING_QUERIES: usize = 64;

/// Observes the programs of the robot of `place`, and answers until the session is closed.
///
/// # Errors
/// Fails if a queryable or the subscriber cannot be declared.
pub fn serve(
    session: &Session,
    place: &KeySpace,
    keeper: &Arc<Mutex<Keeper>>,
    is_retained: IsRetained,
) -> zenoh::Result<()> {
    let keeper = Arc::clone(keeper);
    let (of_tokens, observer) = (Arc::clone(&keeper), place.clone());
    let on_token = move |sample: Sample| {
        if let Some(token) = Token::parse(&observer, sample.key_expr().as_str()) {
            let is_up = sample.kind() == SampleKind::Put;
            of_tokens.lock().on_token(&token, is_up, Instant::now());
        }
    };
    let own = Some(&place.robot);
    let subscriber = session
        .liveliness()
        .declare_subscriber(tokens(place, own))
        .history(true)
        .callback(on_token);
    subscriber.background().wait()?;
    let key = place.own(own, REGISTER);
    let busy = "too many programs are registering: try again";
    let next = reply::queue(session, &key, MAX_WAITING_QUERIES, busy)?;
    let registrar = Registrar {
        session: session.clone(),
        place: place.clone(),
        key,
        keeper: Arc::clone(&keeper),
        is_retained,
    };
    thread::Builder::new()
        .name("catalogue".to_owned())
        .spawn(move || registrar.run(&next))?;
    let key = place.own(own, CATALOGUE);
    let key_of_answer = key.clone();
    let (passing, at) = (session.clone(), place.clone());
    let on_query = move |query: Query| {
        let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
        let programs = keeper.lock().programs(Instant::now());
        match requester_end::passed_on(&at, &payload) {
            Some((topic, get)) if programs.iter().any(|program| program.serves(&topic)) => {
                notify(&passing, get.selector, get.timeout);
            }
            Some(_) => {}
            None => reply::reply(&query, &key_of_answer, Ok(programs)),
        }
    };
    let queryable = session.declare_queryable(key).callback(on_query);
    queryable.background().wait()
}

/// Sends a notice to the services of a topic, which do not reply. It may wait that long for a program that does not answer.
fn notify(session: &Session, notice: String, timeout: Duration) {
    let sent = session.get(&notice).target(QueryTarget::AllComplete);
    if let Err(error) = sent.timeout(timeout).callback(drop).wait() {
        tracing::debug!("cannot send the notice {notice}: {error}");
    }
}

/// Accepts and refuses registrations, on a thread of its own.
struct Registrar {
    session: Session,
    place: KeySpace,
    key: String,
    keeper: Arc<Mutex<Keeper>>,
    is_retained: IsRetained,
}

/// Returns whether a topic is retained, so that no program can serve it.
pub type IsRetained = Box<dyn Fn(&Topic) -> bool + Send>;

/// The answer to a registration.
#[derive(Serialize)]
struct Registered {
    /// A problem that the program reports to its user.
    warning: Option<String>,
}

/// The outcome of a question whether a service still answers.
enum Pinged {
    Answers,
    /// It did not answer in time.
    Silent,
    /// Nobody serves the topic.
    Absent,
}

impl Registrar {
    fn run(&self, queries: &Receiver<Query>) {
        while let Ok(query) = queries.recv() {
            let payload = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
            let program = Program::read(&payload).map_err(|error| error.to_string());
            let registered = program.and_then(|program| self.register(program));
            let answer = registered.map(|warning| Registered { warning });
            reply::reply(&query, &self.key, answer);
        }
    }

    /// Registers a program. If another one serves one of its topics, that one is asked whether it still answers.
    fn register(&self, program: Program) -> Result<Option<String>, String> {
        let mut topics = program.services.iter().map(|service| &service.topic);
        if let Some(topic) = topics.find(|topic| (self.is_retained)(topic)) {
            return Err(format!(
                "{topic} is retained by a program of this robot, and a topic cannot be served and retained: choose another topic, or forget it (`rect topic forget {topic}`)"
            ));
        }
        let deadline = Instant::now() + PING_TIMEOUT;
        loop {
            let registered = self.keeper.lock().register(program.clone(), Instant::now());
            let (topic, instance) = match &registered {
                Err(Refused::Served {
                    topic, instance, ..
                }) => (topic, *instance),
                _ => return registered.map_err(|refused| refused.to_string()),
            };
            match self.ping(topic) {
                Pinged::Answers => {
                    // The program may have served it before, and may not have answered for a while.
                    self.end_service(topic, program.instance);
                    return registered.map_err(|refused| refused.to_string());
                }
                // It has ended, and its token ends in a moment; or it has registered, and declares its service in a moment.
                Pinged::Absent if Instant::now() < deadline => thread::sleep(PING_PAUSE),
                Pinged::Absent | Pinged::Silent => {
                    let warning = self.keeper.lock().on_silent(instance);
                    self.end_service(topic, instance);
                    let registered = self.keeper.lock().register(program, Instant::now());
                    let registered = registered.map(|other| warning.or(other));
                    return registered.map_err(|refused| refused.to_string());
                }
            }
        }
    }

    /// Notifies a program that another one serves its topic. A program that is stopped reads it when it continues.
    fn end_service(&self, topic: &Topic, of: Instance) {
        let notice = format!("{}?{}", self.place.publication(topic), taken_over(of));
        notify(&self.session, notice, TAKEN_OVER_TIMEOUT);
    }

    /// Asks the program that serves a topic whether it still answers.
    fn ping(&self, topic: &Topic) -> Pinged {
        let ping = format!("{}?{PING}", self.place.publication(topic));
        let asked = self
            .session
            .get(ping)
            .target(QueryTarget::AllComplete)
            .timeout(PING_TIMEOUT);
        let replies: Vec<_> = asked.wait().into_iter().flatten().collect();
        match replies.iter().any(|reply| reply.result().is_ok()) {
            true => Pinged::Answers,
            // Zenoh replies with an error when the time is up.
            false if !replies.is_empty() => Pinged::Silent,
            false => Pinged::Absent,
        }
    }
}
