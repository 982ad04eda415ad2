//! The same in blocking form, for programs without `async`: every call waits until it is done. Not for use inside of an async
//! runtime, which these calls would hold up; there is [`crate::Robot`] for that.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! let robot = rect::blocking::connect("wombat-1")?;
//! robot.publish("arm/angle", rect::Json(12.5))?;
//! for message in robot.subscribe("wombat-2/**")? {
//!     println!("{} says {:?}", message.from, message.payload);
//! }
//! let answer = robot.request("wombat-2", "battery", "", Duration::from_secs(1))?;
//! # Ok::<(), rect::Error>(())
//! ```
mod runtime;
mod stream;
mod subscription;
mod transfer;

use std::{sync::Arc, time::Duration};

pub use self::{runtime::Runtime, stream::Frames, subscription::Subscription, transfer::Transfers};
use crate::{
    session, Connection, Counters, Error, Event, Message, Name, NamedConnection, Options, Pattern,
    Receiving, Reply, Service, ToPayload, Topic, Urgency,
};

/// A program of a robot, joined with the others; see [`crate::Robot`].
#[derive(Clone, Debug)]
pub struct Robot {
    robot: session::Robot,
    runtime: Arc<Runtime>,
}

/// The messages of a pattern, one after another: an iterator that waits for the next. It ends when the session is closed.
#[derive(Debug)]
pub struct Messages {
    subscriber: session::Subscriber,
    runtime: Arc<Runtime>,
}

/// The answers to one request; an iterator that waits for the next.
#[derive(Debug)]
pub struct Replies {
    replies: session::Replies,
    runtime: Arc<Runtime>,
}

/// What changes about who can be reached; an iterator that waits for the next.
#[derive(Debug)]
pub struct Events {
    events: session::Events,
    runtime: Arc<Runtime>,
}

/// Joins as a program of that robot, at the router of this computer.
///
/// # Errors
/// As [`crate::connect`].
pub fn connect(robot: &str) -> Result<Robot, Error> {
    Robot::join(Options::new(robot)?)
}

impl Robot {
    /// Joins as the options say.
    ///
    /// # Errors
    /// As [`Options::connect`].
    pub fn join(options: Options) -> Result<Self, Error> {
        let runtime = Runtime::start().map_err(no_thread)?;
        let robot = runtime.wait(options.connect())?;
        let runtime = Arc::new(runtime);
        Ok(Self { robot, runtime })
    }

    /// The async form of the same robot.
    pub fn asynchronous(&self) -> &session::Robot {
        &self.robot
    }

    /// This robot's name.
    pub fn name(&self) -> &Name {
        self.robot.name()
    }

    /// The same robot, speaking with that urgency.
    #[must_use]
    pub fn with(&self, urgency: Urgency) -> Self {
        Self {
            robot: self.robot.with(urgency),
            runtime: self.runtime.clone(),
        }
    }

    /// Says it to all.
    ///
    /// # Errors
    /// As [`crate::Robot::publish`].
    pub fn publish<T: TryInto<Topic>>(&self, topic: T, value: impl ToPayload) -> Result<(), Error>
    where
        Error: From<T::Error>,
    {
        self.runtime.complete(self.robot.publish(topic, value))
    }

    /// Says it to one robot alone.
    ///
    /// # Errors
    /// As [`crate::Robot::send`].
    pub fn send<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        to: N,
        topic: T,
        value: impl ToPayload,
    ) -> Result<(), Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        self.runtime.complete(self.robot.send(to, topic, value))
    }

    /// The messages of a pattern.
    ///
    /// # Errors
    /// As [`crate::Robot::subscribe`].
    pub fn subscribe<P: TryInto<Pattern>>(&self, pattern: P) -> Result<Messages, Error>
    where
        Error: From<P::Error>,
    {
        self.subscribe_with(pattern, Receiving::default())
    }

    /// The same, with a say in how messages wait.
    ///
    /// # Errors
    /// As [`crate::Robot::subscribe`].
    pub fn subscribe_with<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        receiving: Receiving,
    ) -> Result<Messages, Error>
    where
        Error: From<P::Error>,
    {
        let subscribed = self.robot.subscribe_with(pattern, receiving);
        Ok(Messages {
            subscriber: self.runtime.wait(subscribed)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Calls `callback` for each message of a pattern, one after another on a thread of its own, until what this returns is
    /// dropped. It may wait, and use the robot; one that panics is reported, and called again for the next message.
    ///
    /// # Errors
    /// As [`crate::Robot::on_message`].
    pub fn on_message<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        callback: impl FnMut(Message) + Send + 'static,
    ) -> Result<Subscription, Error>
    where
        Error: From<P::Error>,
    {
        self.on_message_with(pattern, Receiving::default(), callback)
    }

    /// The same, with a say in how messages wait.
    ///
    /// # Errors
    /// As [`on_message`](Self::on_message).
    pub fn on_message_with<P: TryInto<Pattern>>(
        &self,
        pattern: P,
        receiving: Receiving,
        callback: impl FnMut(Message) + Send + 'static,
    ) -> Result<Subscription, Error>
    where
        Error: From<P::Error>,
    {
        let subscribed = self.robot.subscribe_with(pattern, receiving);
        let subscriber = self.runtime.wait(subscribed)?;
        Subscription::start(self.runtime.clone(), subscriber, callback)
    }

    /// The next message of `robot` about `topic`.
    ///
    /// # Errors
    /// As [`crate::Robot::listen`].
    pub fn listen<N: TryInto<Name>>(
        &self,
        robot: N,
        topic: &str,
        timeout: Duration,
    ) -> Result<Message, Error>
    where
        Error: From<N::Error>,
    {
        self.runtime.wait(self.robot.listen(robot, topic, timeout))
    }

    /// Asks a service of `robot`, and waits for its first answer.
    ///
    /// # Errors
    /// As [`crate::Robot::request`].
    pub fn request<N: TryInto<Name>, T: TryInto<Topic>>(
        &self,
        robot: N,
        topic: T,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Reply, Error>
    where
        Error: From<N::Error> + From<T::Error>,
    {
        let asked = self.robot.request(robot, topic, value, timeout);
        self.runtime.wait(asked)
    }

    /// Asks a service of all robots that have it.
    ///
    /// # Errors
    /// As [`crate::Robot::request_all`].
    pub fn request_all<T: TryInto<Topic>>(
        &self,
        topic: T,
        value: impl ToPayload,
        timeout: Duration,
    ) -> Result<Replies, Error>
    where
        Error: From<T::Error>,
    {
        let asked = self.robot.request_all(topic, value, timeout);
        Ok(Replies {
            replies: self.runtime.wait(asked)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Serves `topic` by a function, one request after another on a thread for such work, until what this returns is
    /// dropped. An error that it returns arrives as [`Error::Service`].
    ///
    /// # Errors
    /// As [`crate::Robot::serve`].
    pub fn serve<T, F, V, E>(&self, topic: T, answer: F) -> Result<Service, Error>
    where
        T: TryInto<Topic>,
        Error: From<T::Error>,
        F: Fn(&session::Request) -> Result<V, E> + Send + Sync + 'static,
        V: ToPayload + Send + 'static,
        E: ToPayload + Send + From<&'static str> + 'static,
    {
        let answer = Arc::new(answer);
        let served = self.robot.serve(topic, move |request| {
            let answer = answer.clone();
            async move {
                let answered = tokio::task::spawn_blocking(move || answer(&request)).await;
                answered.unwrap_or_else(|_| Err("the service's function panicked".into()))
            }
        });
        self.runtime.wait(served)
    }

    /// The other robots of the fleet that are there now, by name.
    ///
    /// # Errors
    /// As [`crate::Robot::peers`].
    pub fn peers(&self) -> Result<Vec<Name>, Error> {
        self.runtime.wait(self.robot.peers())
    }

    /// The connections of this robot's router.
    ///
    /// # Errors
    /// As [`crate::Robot::connections`].
    pub fn connections(&self) -> Result<Vec<Connection>, Error> {
        self.runtime.wait(self.robot.connections())
    }

    /// Gives this robot's router a connection, instead of the one of that name if it has one.
    ///
    /// # Errors
    /// As [`crate::Robot::add_connection`].
    pub fn add_connection(&self, connection: &NamedConnection) -> Result<(), Error> {
        self.runtime.wait(self.robot.add_connection(connection))
    }

    /// Takes a connection from this robot's router.
    ///
    /// # Errors
    /// As [`crate::Robot::remove_connection`].
    pub fn remove_connection(&self, name: &str) -> Result<(), Error> {
        self.runtime.wait(self.robot.remove_connection(name))
    }

    /// What changes about who can be reached.
    ///
    /// # Errors
    /// As [`crate::Robot::events`].
    pub fn events(&self) -> Result<Events, Error> {
        Ok(Events {
            events: self.runtime.wait(self.robot.events())?,
            runtime: self.runtime.clone(),
        })
    }

    /// What this program has said and heard.
    pub fn counters(&self) -> Counters {
        self.robot.counters()
    }

    /// Ends the session now.
    ///
    /// # Errors
    /// As [`crate::Robot::close`].
    pub fn close(&self) -> Result<(), Error> {
        self.runtime.wait(self.robot.close())
    }
}

impl Messages {
    /// The next message; `None`: there was none within that time, or the session was closed.
    pub fn next_within(&mut self, timeout: Duration) -> Option<Message> {
        let next = async { tokio::time::timeout(timeout, self.subscriber.recv()).await };
        self.runtime.wait(next).ok().flatten()
    }

    /// How many were dropped because the program did not take them in time.
    pub fn dropped(&self) -> u64 {
        self.subscriber.dropped()
    }
}

impl Iterator for Messages {
    type Item = Message;

    fn next(&mut self) -> Option<Message> {
        self.runtime.wait(self.subscriber.recv())
    }
}

impl Iterator for Replies {
    type Item = Result<Reply, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        self.runtime.wait(self.replies.next())
    }
}

impl Iterator for Events {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.runtime.wait(self.events.next())
    }
}

fn no_thread(error: std::io::Error) -> Error {
    Error::Zenoh {
        what: "no thread can be started",
        reason: error.to_string(),
    }
}
