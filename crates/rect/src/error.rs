//! Defines [`Error`], the error type of sessions. Each variant documents what the program or its user can do about it.
use std::{path::PathBuf, time::Duration};

use rect_core::{
    action::{goal_ended, state::Phase},
    codec::{dictionary::DictionaryError, CodecError},
    message::payload::{Payload, PayloadError},
    name::{
        topic::{Topic, TopicError},
        Name, NameError,
    },
    session::{
        endpoint,
        login::LoginRefused,
        names::{interrupted, no_action, no_parameters, no_service, not_reachable},
        router::WrongRobot,
    },
    stream::options::OptionError,
    text::humanize,
    transfer::{Fault, OfferError, Refusal},
};
use zenoh::session::SessionClosedError;

/// An error of a session, of a codec, or of the arguments of a call.
///
/// The `Display` text names the robot, topic or endpoint involved, and suggests what to do.
///
/// ```no_run
/// # use std::time::Duration;
/// # async fn ask(robot: rect::Robot) -> Result<(), rect::Error> {
/// match robot.request::<f64>("wombat-2", "battery", "").await {
///     Ok(reply) => println!("{}", reply.value),
///     Err(rect::Error::NoService { available, .. }) => println!("reachable robots: {available:?}"),
///     Err(error) => return Err(error),
/// }
/// # Ok(()) }
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The name of a robot or fleet is invalid. Choose another name.
    #[error(transparent)]
    Name(#[from] NameError),
    /// A topic or pattern is invalid. The text describes the expected form.
    #[error(transparent)]
    Topic(#[from] TopicError),
    /// A value cannot be sent, or a payload cannot be read as the requested type. Read it as the type that its encoding
    /// states.
    #[error(transparent)]
    Payload(#[from] PayloadError),
    /// A codec does not support the payload, or an encoded payload is damaged. Choose a codec for this kind of payload,
    /// or have the payload sent again.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// No router answers at the endpoint. Start one, or select another one with [`Options::router`](crate::Options::router).
    #[error(
        "no router answers at {endpoint}: {reason}. {}", endpoint::advice(.endpoint, .reason, "rect-router")
    )]
    NoRouter {
        /// The endpoint that was tried, such as `tcp/127.0.0.1:7447`.
        endpoint: String,
        /// The essential part of Zenoh's reason, or how long the router did not answer.
        reason: String,
        /// The error of Zenoh; `None` if the router did not answer.
        source: Option<zenoh::Error>,
    },
    /// The router requires a login, and the program's login is missing or wrong. Select the team's login file.
    #[error(transparent)]
    LoginRefused(#[from] LoginRefused),
    /// The router belongs to another robot. Connect under the router's name, or to the right router.
    #[error(transparent)]
    WrongRobot(#[from] WrongRobot),
    /// A locator or another value of the options is invalid. Correct the value; the text contains the reason.
    #[error("the option {option} cannot be {value:?}: {}", humanize::with_causes(.source.as_ref()))]
    Option {
        /// The name of the option.
        option: &'static str,
        /// The rejected value.
        value: String,
        /// The reason that Zenoh reports, or the values that RECT allows.
        source: zenoh::Error,
    },
    /// The robot to which a message is sent is not reachable. Check its name, or wait for it
    /// ([`Robot::wait_for_peer`](crate::Robot::wait_for_peer)).
    #[error("{}", not_reachable(.robot, .available))]
    NotReachable {
        /// The recipient.
        robot: Name,
        /// The reachable robots.
        available: Vec<Name>,
    },
    /// A message was published and is not retained: programs that start later do not get it. The reason states what to do.
    #[error("{topic} is not retained: {reason}")]
    NotRetained {
        /// The topic.
        topic: String,
        /// The reason.
        reason: String,
    },
    /// No program provides the service. Is the robot reachable, and is its program running?
    #[error("{}", no_service(.robot.as_ref(), .topic, .available))]
    NoService {
        /// The robot that was asked; `None` if all were.
        robot: Option<Name>,
        /// The topic of the service.
        topic: String,
        /// The reachable robots.
        available: Vec<Name>,
    },
    /// The program cannot serve a topic: another program of this robot serves it already. The reason names that program, and what to
    /// do.
    #[error("{reason}")]
    ServiceRefused {
        /// The reason.
        reason: String,
    },
    /// A declaration of parameters is invalid, or one of this program's own values is refused. The reason states what to do.
    #[error("{reason}")]
    Parameters {
        /// The reason.
        reason: String,
    },
    /// No program of the robot has the group of parameters. Is its program running? A robot that was configured by an earlier version
    /// lacks the rule for `@rect/@set/parameters/**` in its access control.
    #[error("{}", no_parameters(.robot, .group, .available))]
    NoParameters {
        /// The robot.
        robot: Name,
        /// The group.
        group: String,
        /// The groups of the robot.
        available: Vec<String>,
    },
    /// No program of the robot has the action. Is its program running? A robot that was configured by an earlier version lacks the rule for
    /// `@rect/@set/actions/**` in its access control.
    #[error("{}", no_action(.robot, .action, .available))]
    NoAction {
        /// The robot.
        robot: Name,
        /// The action.
        action: String,
        /// The actions of the robot.
        available: Vec<String>,
    },
    /// The robot does not know the goal: it never began, or ended more than ten minutes ago.
    #[error("{robot} does not know the goal {goal} of the action {action}: it never began, or ended more than 10 minutes ago")]
    NoGoal {
        /// The robot.
        robot: Name,
        /// The action.
        action: String,
        /// The id of the goal.
        goal: String,
    },
    /// A goal was not carried out, or not to its end. If its phase is [`Phase::Done`], it was, and its result of more than 48 kB cannot be
    /// received: the program that has it has ended, for example.
    #[error("{}", goal_ended(*.phase, .reason))]
    Goal {
        /// How it ended.
        phase: Phase,
        /// Why; empty if that is clear.
        reason: String,
    },
    /// An action cannot be declared. The reason states what to do.
    #[error("{reason}")]
    Action {
        /// The reason.
        reason: String,
    },
    /// The values are in force, but are lost when the program of the robot ends. The reason names the file, if there is one.
    #[error("{robot} uses the values, and has not stored them: {reason}")]
    NotStored {
        /// The robot.
        robot: Name,
        /// The reason.
        reason: String,
    },
    /// A service received the request, or may have received it, and no reply followed: the program that serves it, a router or the
    /// link to it ended meanwhile, or the program ended the request without a reply. It may have been carried out; ask the robot
    /// before you repeat a request that must not be carried out twice.
    #[error("{}", interrupted(.robot.as_ref(), .topic))]
    Interrupted {
        /// The robot that was asked; `None` if all were, and none replied.
        robot: Option<Name>,
        /// The topic of the service.
        topic: String,
    },
    /// The timeout expired. Try again, set a longer timeout, or check the link (`rect connections`).
    #[error("no {expected} within {}", humanize::duration(*.timeout))]
    TimedOut {
        /// The item that the call waited for, as a noun phrase.
        expected: String,
        /// How long it waited.
        timeout: Duration,
    },
    /// The service replied with an error. The payload describes it.
    #[error("{} replied with an error: {}", .robot.as_ref().map_or("the service", Name::as_str), beginning(.payload))]
    Service {
        /// The robot that replied; `None` if the service is a stock Zenoh program, whose replies do not name one.
        robot: Option<Name>,
        /// The error, as the service returned it.
        payload: Payload,
    },
    /// A Zenoh operation failed. The text contains the reason that Zenoh reports.
    #[error("{operation}: {}", humanize::with_causes(.source.as_ref()))]
    Zenoh {
        /// The failure, such as "cannot declare the publisher".
        operation: &'static str,
        /// The reason that Zenoh reports.
        source: zenoh::Error,
    },
    /// The call runs outside of tokio's runtime with several threads, which Zenoh requires. `#[tokio::main]` provides it, and
    /// `#[tokio::test(flavor = "multi_thread")]`.
    #[error(
        "Zenoh requires tokio's runtime with several threads, and {found}: use `#[tokio::main]` without \
         `flavor = \"current_thread\"`, or `#[tokio::test(flavor = \"multi_thread\")]`"
    )]
    Runtime {
        /// The situation of the call, as a clause such as "this one has a single thread".
        found: &'static str,
    },
    /// A thread cannot be started. Has the computer too many processes, or too little memory?
    #[error("cannot start a thread: {source}")]
    Thread {
        /// The error of the operating system.
        source: std::io::Error,
    },
    /// A dictionary cannot be shared, because this program shares another one with the same id. Train one of them again.
    #[error(transparent)]
    Dictionary(#[from] DictionaryError),
    /// The receiver refused the transfer. The receiver sets what it accepts in its call of
    /// [`receive_transfers`](crate::Robot::receive_transfers).
    #[error("{robot} refused the transfer {topic}: {refusal}")]
    TransferRefused {
        /// The receiver.
        robot: Name,
        /// The topic of the transfer.
        topic: Topic,
        /// The reason for the refusal.
        #[source]
        refusal: Refusal,
    },
    /// A transfer ended before it was complete. The fault states whether sending it again can help.
    #[error("the transfer {topic} with {robot} failed: {fault}")]
    TransferFailed {
        /// The robot at the other end.
        robot: Name,
        /// The topic of the transfer.
        topic: Topic,
        /// The reason for the failure.
        #[source]
        fault: Fault,
    },
    /// A file or folder of a transfer cannot be used. Check that it exists, and its permissions.
    #[error("{}: {reason}", .path.display())]
    File {
        /// The path of the file or folder.
        path: PathBuf,
        /// The error of the operating system.
        #[source]
        reason: std::io::Error,
    },
    /// The file name of a transfer is invalid. Choose another name.
    #[error(transparent)]
    Offer(#[from] OfferError),
    /// A recording cannot start, or not become a file. Choose another name, or make room on the disk; `rect recording merge` makes a
    /// file of what was recorded.
    #[cfg(feature = "recording")]
    #[error(transparent)]
    Recording(#[from] rect_recording::RecorderError),
    /// The session was closed. Connect again to continue.
    #[error("the session is closed")]
    Closed,
}

/// Returns the first 500 characters of a service's error.
fn beginning(payload: &Payload) -> String {
    let text = String::from_utf8_lossy(&payload.bytes);
    text.chars().take(500).collect()
}

impl From<OptionError> for Error {
    fn from(error: OptionError) -> Self {
        Self::Option {
            option: error.option,
            source: error.reason().into(),
            value: error.value,
        }
    }
}

impl From<std::convert::Infallible> for Error {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

/// Returns an argument of a call as the type that it stands for.
pub(crate) fn valid<T>(argument: impl TryInto<T, Error: Into<Error>>) -> Result<T, Error> {
    argument.try_into().map_err(Into::into)
}

impl Error {
    /// Returns a function that converts an error of Zenoh. `operation` states what failed, in the form "cannot ...".
    pub(crate) fn zenoh(operation: &'static str) -> impl FnOnce(zenoh::Error) -> Self {
        move |source| {
            if source.is::<SessionClosedError>() {
                return Self::Closed;
            }
            Self::Zenoh { operation, source }
        }
    }

    /// Returns the robot that has sent the error.
    pub(crate) fn sender(&self) -> Option<Name> {
        match self {
            Self::Service { robot, .. } => robot.clone(),
            _ => None,
        }
    }

    /// Converts the error that a thread cannot be started.
    pub(crate) fn thread(source: std::io::Error) -> Self {
        Self::Thread { source }
    }
}
