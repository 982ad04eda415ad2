//! The blocking form of the API, for programs without `async`: every call blocks the calling thread until it is complete.
//!
//! A call panics if it would block a thread of an asynchronous runtime. Use [`crate::Robot`] there.
//!
//! ```no_run
//! use std::time::Duration;
//!
//! let robot = rect::blocking::connect("wombat-1")?;
//! robot.publish("arm/angle", rect::Json(12.5))?;
//! for message in robot.subscribe::<f64>("*/arm/angle")? {
//!     println!("{}: {}", message.sender, message.value?);
//! }
//! let volts = robot.request::<f64>("wombat-2", "battery", "")?.value;
//! # Ok::<(), rect::Error>(())
//! ```
mod action;
mod publisher;
#[cfg(feature = "recording")]
mod recorder;
mod runtime;
mod stop;
mod stream;
mod subscription;
mod transfer;

use std::{collections::BTreeMap, sync::Arc, time::Duration};

#[cfg(feature = "recording")]
pub use self::recorder::RobotRecorder;
pub use self::{
    action::{ActionChanges, ActionRun, Goal},
    publisher::Publisher,
    runtime::Runtime,
    stop::{FleetStop, StopChanges},
    stream::Watcher,
    subscription::Subscription,
    transfer::Transfers,
};
use crate::{
    session, Connection, Counters, Deadman, Error, Event, FromPayload, Gathered, GroupOptions,
    Level, LogItem, LogLine, LogOptions, Message, Name, NamedConnection, Options, ParameterGroup,
    ParameterOrder, ParameterValue, Pattern, Payload, Program, Reply, RobotAlert, Service,
    ServiceEntry, ServiceOptions, SubscribeOptions, ToPayload, Topic, Urgency,
};
use rect_core::codec::{dictionary::Dictionary, Codec};

/// A handle of a program's session, through which it communicates as one robot of the fleet; the blocking form of
/// [`crate::Robot`].
///
/// Clones are cheap and share the session.
#[derive(Clone, Debug)]
pub struct Robot {
    robot: session::Robot,
    runtime: Arc<Runtime>,
}

/// Receives the messages that match a pattern; created by [`Robot::subscribe`].
///
/// The iterator blocks until the next message, and ends when the session is closed. Dropping it ends the subscription.
#[derive(Debug)]
pub struct Subscriber<T: FromPayload = Payload> {
    subscriber: session::Subscriber<T>,
    runtime: Arc<Runtime>,
}

/// Receives the replies to one request; created by [`Robot::request_all`] and [`Robot::request_stream`].
///
/// The iterator blocks until the next reply, and ends when all services have replied. Dropping it cancels the request.
#[derive(Debug)]
pub struct Replies<T: FromPayload = Payload> {
    replies: session::Replies<T>,
    runtime: Arc<Runtime>,
}

/// Receives the lines of logs; created by [`Robot::logs`]. The iterator blocks until the next ones.
#[derive(Debug)]
pub struct Logs {
    logs: session::Logs,
    runtime: Arc<Runtime>,
}

/// Receives events of robots, links and the router; created by [`Robot::events`].
///
/// The iterator blocks until the next event, and ends when the session is closed.
#[derive(Debug)]
pub struct Events {
    events: session::Events,
    runtime: Arc<Runtime>,
}

/// Connects to the router of this computer as a program of `robot`, in the fleet `rect`.
///
/// ```no_run
/// let robot = rect::blocking::connect("wombat-1")?;
/// robot.publish("greeting", "hello")?;
/// # Ok::<(), rect::Error>(())
/// ```
///
/// # Errors
/// Returns the same errors as [`crate::connect`].
pub fn connect(robot: &str) -> Result<Robot, Error> {
    Robot::connect(Options::new(robot)?)
}

impl Robot {
    /// Opens a session with `options`.
    ///
    /// ```no_run
    /// use rect::{blocking::Robot, Options};
    ///
    /// let robot = Robot::connect(Options::new("wombat-1")?.router("tcp/192.168.0.7:7447"))?;
    /// # Ok::<(), rect::Error>(())
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`Options::connect`].
    pub fn connect(options: Options) -> Result<Self, Error> {
        let runtime = Runtime::start().map_err(Error::thread)?;
        let robot = runtime.wait(options.connect())?;
        let runtime = Arc::new(runtime);
        Ok(Self { robot, runtime })
    }

    /// Returns the asynchronous handle of the same session.
    pub fn asynchronous(&self) -> &session::Robot {
        &self.robot
    }

    /// Returns the name of this robot.
    pub fn name(&self) -> &Name {
        self.robot.name()
    }

    /// Returns a handle that publishes, sends, requests and streams with `urgency`.
    #[must_use]
    pub fn with_urgency(&self, urgency: Urgency) -> Self {
        Self {
            robot: self.robot.with_urgency(urgency),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle whose requests wait for replies for that time; see [`crate::Robot::with_timeout`].
    #[must_use]
    pub fn with_timeout(&self, timeout: Duration) -> Self {
        Self {
            robot: self.robot.with_timeout(timeout),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle whose requests are repeated, and carried out at most once; see [`crate::Robot::retrying`].
    #[must_use]
    pub fn retrying(&self) -> Self {
        Self {
            robot: self.robot.retrying(),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle that retains what it publishes; see [`crate::Robot::retained`].
    #[must_use]
    pub fn retained(&self) -> Self {
        Self {
            robot: self.robot.retained(),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle that retains what it publishes, also on disk; see [`crate::Robot::retained_on_disk`].
    #[must_use]
    pub fn retained_on_disk(&self) -> Self {
        Self {
            robot: self.robot.retained_on_disk(),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle whose messages expire after that time; see [`crate::Robot::expires_after`].
    #[must_use]
    pub fn expires_after(&self, lifetime: Duration) -> Self {
        Self {
            robot: self.robot.expires_after(lifetime),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle that encodes the payloads of messages and requests with `codec`; see
    /// [`crate::Robot::with_codec`].
    #[must_use]
    pub fn with_codec(&self, codec: Arc<dyn Codec>) -> Self {
        Self {
            robot: self.robot.with_codec(codec),
            runtime: self.runtime.clone(),
        }
    }

    /// Returns a handle that compresses the payloads of messages and requests with `dictionary`; see
    /// [`crate::Robot::with_dictionary`].
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::with_dictionary`].
    pub fn with_dictionary(&self, dictionary: Arc<Dictionary>) -> Result<Self, Error> {
        Ok(Self {
            robot: self.robot.with_dictionary(dictionary)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Returns whether the session is closed.
    pub fn is_closed(&self) -> bool {
        self.robot.is_closed()
    }

    /// Publishes `value` on `topic` to every subscriber. Blocks while the queue of the link is full.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::publish`].
    pub fn publish(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<(), Error> {
        self.runtime.complete(self.robot.publish(topic, value))
    }

    /// Returns the last value of a retained topic of `robot`, or nothing if it retains none or is not reachable.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::latest`].
    pub fn latest<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Option<Message<T::Value>>, Error> {
        self.runtime.wait(self.robot.latest::<T>(robot, topic))
    }

    /// Forgets a retained topic of this robot.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::forget`].
    pub fn forget(&self, topic: impl TryInto<Topic, Error: Into<Error>>) -> Result<(), Error> {
        self.runtime.wait(self.robot.forget(topic))
    }

    /// Sends `value` on `topic` to one robot only. Does not check whether the robot is reachable.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::send`].
    pub fn send(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<(), Error> {
        self.runtime.complete(self.robot.send(robot, topic, value))
    }

    /// Subscribes to the messages that match `pattern`, which is `<robot>/<topic>` with wildcards.
    ///
    /// ```no_run
    /// # fn subscribe(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// for message in robot.subscribe::<f64>("*/arm/angle")? {
    ///     println!("{}: {}", message.sender, message.value?);
    /// }
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::subscribe`].
    pub fn subscribe<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
    ) -> Result<Subscriber<T>, Error> {
        self.subscribe_with(pattern, SubscribeOptions::default())
    }

    /// Subscribes to the messages that match `pattern`, with other settings: of the receive queue, or for fewer messages.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::subscribe_with`].
    pub fn subscribe_with<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        options: impl Into<SubscribeOptions>,
    ) -> Result<Subscriber<T>, Error> {
        let subscribed = self.robot.subscribe_with(pattern, options);
        Ok(Subscriber {
            subscriber: self.runtime.wait(subscribed)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Calls `callback` for each message that matches `pattern`, one at a time on a separate thread, until the returned
    /// subscription is dropped.
    ///
    /// The callback may block and use the robot. If it panics, the panic is logged and the callback is called again for the
    /// next message.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::on_message`].
    pub fn on_message<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        callback: impl FnMut(Message<T::Value>) + Send + 'static,
    ) -> Result<Subscription, Error> {
        self.on_message_with::<T>(pattern, SubscribeOptions::default(), callback)
    }

    /// Calls `callback` for each message that matches `pattern`, with other settings: of the receive queue, or for fewer messages.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::subscribe_with`].
    pub fn on_message_with<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        options: impl Into<SubscribeOptions>,
        callback: impl FnMut(Message<T::Value>) + Send + 'static,
    ) -> Result<Subscription, Error> {
        let subscribed = self.robot.subscribe_with::<T>(pattern, options);
        let subscriber = self.runtime.wait(subscribed)?;
        Subscription::start::<T>(self.runtime.clone(), subscriber, callback)
    }

    /// Declares a publisher of `topic`, which knows whether there are subscribers.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::publisher`].
    pub fn publisher<T>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
    ) -> Result<Publisher<T>, Error> {
        Ok(Publisher {
            publisher: self.runtime.wait(self.robot.publisher(topic))?,
            runtime: self.runtime.clone(),
        })
    }

    /// Records messages to an MCAP file until [`finish`](RobotRecorder::finish) is called.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::record`].
    #[cfg(feature = "recording")]
    pub fn record(
        &self,
        path: impl Into<std::path::PathBuf>,
        options: crate::RecordOptions,
    ) -> Result<RobotRecorder, Error> {
        Ok(RobotRecorder {
            recorder: self.runtime.wait(self.robot.record(path, options))?,
            runtime: self.runtime.clone(),
        })
    }

    /// Blocks until `robot` is reachable, at most for `timeout`. Returns at once if it is.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::wait_for_peer`].
    pub fn wait_for_peer(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        timeout: Duration,
    ) -> Result<(), Error> {
        self.runtime.wait(self.robot.wait_for_peer(robot, timeout))
    }

    /// Blocks until every reachable router knows the subscriptions and services of this program, at most for `timeout`.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::wait_until_established`].
    pub fn wait_until_established(&self, timeout: Duration) -> Result<(), Error> {
        self.runtime
            .wait(self.robot.wait_until_established(timeout))
    }

    /// Blocks until the next message that matches `pattern`, at most for `timeout`. Messages that were sent before the call are
    /// not received.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::wait_for_message`].
    pub fn wait_for_message<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        timeout: Duration,
    ) -> Result<Message<T::Value>, Error> {
        self.runtime
            .wait(self.robot.wait_for_message::<T>(pattern, timeout))
    }

    /// Sends a request to the service `topic` of `robot`, and blocks until its first reply.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::request`].
    pub fn request<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Reply<T::Value>, Error> {
        let asked = self.robot.request::<T>(robot, topic, value);
        self.runtime.wait(asked)
    }

    /// Sends a request to the service `topic` of all robots that provide it. Replies arrive until all services have replied
    /// or the time is up ([`with_timeout`](Self::with_timeout)).
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::request_all`].
    pub fn request_all<T: FromPayload>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Replies<T>, Error> {
        let asked = self.robot.request_all::<T>(topic, value);
        Ok(Replies {
            replies: self.runtime.wait(asked)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Sends a request to the service `topic` of `robot`, which sends several replies, such as the results of a scan.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::request_stream`].
    pub fn request_stream<T: FromPayload>(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        value: impl ToPayload,
    ) -> Result<Replies<T>, Error> {
        let asked = self.robot.request_stream::<T>(robot, topic, value);
        Ok(Replies {
            replies: self.runtime.wait(asked)?,
            runtime: self.runtime.clone(),
        })
    }

    /// Declares the service `topic`, and replies to each request with the result of `answer`, until the returned service is
    /// dropped. An error, or a panic of `answer`, arrives at the requester as [`Error::Service`].
    ///
    /// `answer` may block. It is called on separate threads, for up to 16 requests concurrently.
    ///
    /// ```no_run
    /// # fn serve(robot: rect::blocking::Robot) -> Result<(), rect::Error> {
    /// let _service = robot.serve("double", |request| {
    ///     let number: f64 = request.payload.value().map_err(|error| error.to_string())?;
    ///     Ok::<_, String>(rect::Json(number * 2.0))
    /// })?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::serve`].
    pub fn serve<F, V, E>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        answer: F,
    ) -> Result<Service, Error>
    where
        F: Fn(&session::Request) -> Result<V, E> + Send + Sync + 'static,
        V: ToPayload + Send + 'static,
        E: ToPayload + Send + From<&'static str> + 'static,
    {
        self.serve_with(topic, ServiceOptions::default(), answer)
    }

    /// Does the same as [`serve`](Self::serve), with a description of the service and other options.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::serve_with`].
    pub fn serve_with<F, V, E>(
        &self,
        topic: impl TryInto<Topic, Error: Into<Error>>,
        options: ServiceOptions,
        answer: F,
    ) -> Result<Service, Error>
    where
        F: Fn(&session::Request) -> Result<V, E> + Send + Sync + 'static,
        V: ToPayload + Send + 'static,
        E: ToPayload + Send + From<&'static str> + 'static,
    {
        let answer = Arc::new(answer);
        let served = self.robot.serve_with(topic, options, move |request| {
            let answer = answer.clone();
            async move {
                let answered = tokio::task::spawn_blocking(move || answer(&request)).await;
                answered.unwrap_or_else(|_| Err("the service's function panicked".into()))
            }
        });
        self.runtime.wait(served)
    }

    /// Returns the programs of `robot` that have a name or serve something, each with its services.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::programs`].
    pub fn programs(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
    ) -> Result<Vec<Program>, Error> {
        self.runtime.wait(self.robot.programs(robot))
    }

    /// Returns what the programs of `robot` serve, in alphabetical order of the topics.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::services`].
    pub fn services(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
    ) -> Result<Vec<ServiceEntry>, Error> {
        self.runtime.wait(self.robot.services(robot))
    }

    /// Returns the names of the other robots of the fleet that are reachable now, in alphabetical order.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::peers`].
    pub fn peers(&self) -> Result<Vec<Name>, Error> {
        self.runtime.wait(self.robot.peers())
    }

    /// Returns the connections of this robot's router.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::connections`].
    pub fn connections(&self) -> Result<Vec<Connection>, Error> {
        self.runtime.wait(self.robot.connections())
    }

    /// Declares a group of parameters; see [`crate::Robot::parameters`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn parameters<T: Send + Sync + 'static>(
        &self,
        group: impl Into<GroupOptions<T>>,
    ) -> Result<ParameterGroup<T>, Error> {
        self.runtime.wait(self.robot.parameters(group))
    }

    /// Changes parameters of a program; see [`crate::Robot::set_parameters`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn set_parameters(
        &self,
        robot: impl TryInto<Name, Error: Into<Error>>,
        group: &str,
        order: impl Into<ParameterOrder>,
    ) -> Result<BTreeMap<String, ParameterValue>, Error> {
        self.runtime
            .wait(self.robot.set_parameters(robot, group, order))
    }

    /// Takes part in the stop of the fleet; see [`crate::Robot::fleet_stop`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn fleet_stop(&self) -> Result<FleetStop, Error> {
        let stop = self.runtime.wait(self.robot.fleet_stop())?;
        let runtime = self.runtime.clone();
        Ok(FleetStop { stop, runtime })
    }

    /// Carries out commands while they arrive; see [`crate::Robot::deadman`]: `on_command` on a thread of its own, and `on_lost`, which
    /// does not wait for it, on a thread of the session.
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn deadman<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        within: Duration,
        on_command: impl FnMut(T::Value) + Send + 'static,
        on_lost: impl FnMut(&str) + Send + 'static,
    ) -> Result<Deadman, Error>
    where
        T::Value: Send + 'static,
    {
        let switch = self
            .robot
            .deadman::<T>(pattern, within, on_command, on_lost);
        self.runtime.wait(switch)
    }

    /// Adds a named connection to this robot's router, replacing the one of the same name.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::add_connection`].
    pub fn add_connection(&self, connection: &NamedConnection) -> Result<(), Error> {
        self.runtime.wait(self.robot.add_connection(connection))
    }

    /// Removes a named connection from this robot's router and closes its link.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::remove_connection`].
    pub fn remove_connection(&self, name: &str) -> Result<(), Error> {
        self.runtime.wait(self.robot.remove_connection(name))
    }

    /// Subscribes to events: robots that become reachable or unreachable, links that come up or go down, and the loss and
    /// return of the router.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::events`].
    pub fn events(&self) -> Result<Events, Error> {
        Ok(Events {
            events: self.runtime.wait(self.robot.events())?,
            runtime: self.runtime.clone(),
        })
    }

    /// Logs a line; see [`crate::Robot::log`].
    pub fn log(&self, level: Level, text: impl Into<String>) {
        self.robot.log(level, text);
    }

    /// Logs a line with everything that belongs to it; see [`crate::Robot::log_line`].
    pub fn log_line(&self, line: LogLine) {
        self.robot.log_line(line);
    }

    /// Logs a line that stays on this robot; see [`crate::Robot::log_private`].
    pub fn log_private(&self, line: LogLine) {
        self.robot.log_private(line);
    }

    /// Reads the log of a robot, or of all robots (`*`); see [`crate::Robot::logs`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn logs(&self, robot: &str, options: LogOptions) -> Result<Logs, Error> {
        Ok(Logs {
            logs: self.runtime.wait(self.robot.logs(robot, options))?,
            runtime: self.runtime.clone(),
        })
    }

    /// Raises an alert; see [`crate::Robot::alert`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn alert(&self, level: Level, text: &str) -> Result<(), Error> {
        self.runtime.wait(self.robot.alert(level, text))
    }

    /// Raises an alert under a name of its own; see [`crate::Robot::alert_named`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn alert_named(&self, name: &str, level: Level, text: &str) -> Result<(), Error> {
        self.runtime.wait(self.robot.alert_named(name, level, text))
    }

    /// Returns the alerts of a robot, or of all robots that can be reached (`None`); see [`crate::Robot::alerts`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn alerts(&self, robot: Option<Name>) -> Result<Vec<RobotAlert>, Error> {
        self.runtime.wait(self.robot.alerts(robot))
    }

    /// Clears the alert with this name or text; see [`crate::Robot::clear_alert`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn clear_alert(&self, name: &str) -> Result<(), Error> {
        self.runtime.wait(self.robot.clear_alert(name))
    }

    /// Returns the handle of the async API, for [`crate::LogLayer`].
    pub fn as_async(&self) -> &crate::Robot {
        &self.robot
    }

    /// Returns the counters of this session: messages and bytes sent and received, and messages missed and rejected.
    pub fn counters(&self) -> Counters {
        self.robot.counters()
    }

    /// Closes the session and everything that belongs to it, even if other clones of this handle exist.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Robot::close`].
    pub fn close(&self) -> Result<(), Error> {
        self.runtime.wait(self.robot.close())
    }
}

impl<T: FromPayload> Subscriber<T> {
    /// Blocks until the next message; returns `None` if none arrives within `timeout`, or if the session is closed.
    ///
    /// If the timeout expires while the dictionary of a message is fetched, the next call returns that message.
    pub fn next_timeout(&mut self, timeout: Duration) -> Option<Message<T::Value>> {
        let next = async { tokio::time::timeout(timeout, self.subscriber.next()).await };
        self.runtime.wait(next).ok().flatten()
    }

    /// Returns the number of messages that were dropped because the queue was full.
    pub fn dropped(&self) -> u64 {
        self.subscriber.dropped()
    }
}

impl<T: FromPayload> Iterator for Subscriber<T> {
    type Item = Message<T::Value>;

    fn next(&mut self) -> Option<Message<T::Value>> {
        self.runtime.wait(self.subscriber.next())
    }
}

impl<T: FromPayload> Replies<T> {
    /// Blocks until all robots have replied that serve the topic, or the time is up, and returns the outcome of each of them.
    ///
    /// # Errors
    /// Returns the same errors as [`crate::Replies::gather`].
    pub fn gather(self) -> Result<Gathered<T::Value>, Error> {
        self.runtime.wait(self.replies.gather())
    }
}

impl<T: FromPayload> Iterator for Replies<T> {
    type Item = Result<Reply<T::Value>, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        self.runtime.wait(self.replies.next())
    }
}

impl Iterator for Logs {
    type Item = LogItem;

    fn next(&mut self) -> Option<LogItem> {
        self.runtime.wait(self.logs.next())
    }
}

impl Iterator for Events {
    type Item = Event;

    fn next(&mut self) -> Option<Event> {
        self.runtime.wait(self.events.next())
    }
}
