//! Implements the stop of a fleet.
use std::{
    fmt,
    sync::{Arc, Mutex, Weak},
    time::SystemTime,
};

use rect_core::{
    clock::unix::ms_since_1970,
    message::{payload::Payload, Message},
    name::{topic::Pattern, Name},
    registry::connection::Event,
    stop::{self, Confirmation, Stop, AGAIN_AFTER, MARKED_WITHIN, TOPIC},
};
use tokio::{
    sync::{watch, Notify},
    task::JoinHandle,
};

use super::{events::Events, robot::Robot, shared::lock, subscriber::Subscriber, warnings::warn};
use crate::error::Error;

/// The stop of the fleet; created by [`Robot::fleet_stop`]. Clones are the same one.
///
/// While one exists, this robot takes part: it remembers stops, passes them on, and confirms them.
#[derive(Clone)]
pub struct FleetStop(Arc<Shared>);

/// Reports changes of the stop of the fleet; created by [`FleetStop::changes`].
#[derive(Debug)]
pub struct StopChanges(watch::Receiver<()>);

struct Shared {
    robot: Robot,
    known: Mutex<stop::FleetStop>,
    changes: watch::Sender<()>,
    /// The message that was published last, unless this program has learned since that its robot is behind.
    published: Mutex<Option<Payload>>,
    /// Wakes the task that publishes what this robot knows.
    publish: Arc<Notify>,
    tasks: Mutex<Vec<JoinHandle<()>>>,
}

impl Robot {
    /// Takes part in the stop of the fleet: with it, this program stops all robots that take part, learns of a stop, and confirms it.
    ///
    /// A stop holds until somebody releases it. The robots remember it, on their disks as well, and pass it on: one that was out of reach
    /// learns of it when it returns, and a program that starts again before this call returns. The motors are up to the program;
    /// [`deadman`](Self::deadman) handles stops, and nothing moves at the release.
    ///
    /// ```no_run
    /// # async fn smoke(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let stop = robot.fleet_stop().await?;
    /// stop.press("smoke").await?;
    /// println!("{:?}", stop.confirmation(&"wombat-2".parse()?));
    /// stop.release().await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, this program does not take part.
    pub async fn fleet_stop(&self) -> Result<FleetStop, Error> {
        let mut existing = self.inner.stop.lock().await;
        let shared = existing.upgrade().map(|shared| shared.downcast::<Shared>());
        if let Some(Ok(shared)) = shared {
            return Ok(FleetStop(shared));
        }
        let program = self.inner.program.driver().program().clone();
        let known =
            stop::FleetStop::new(self.name().clone(), program.name.as_ref(), program.instance);
        let shared = Arc::new(Shared {
            robot: self.clone(),
            known: Mutex::new(known),
            changes: watch::Sender::new(()),
            published: Mutex::default(),
            publish: Arc::default(),
            tasks: Mutex::default(),
        });
        let messages = self.subscribe::<Payload>(Pattern::of(None, TOPIC)?).await?;
        let events = self.events().await?;
        // A program that starts again knows of a stop before it does anything.
        if let Some(message) = self.latest::<Payload>(self.name().clone(), TOPIC).await? {
            shared.on_message(&message);
        }
        let runtime = &self.inner.runtime;
        let follow = runtime.spawn(follow(Arc::downgrade(&shared), messages, events));
        let publish = runtime.spawn(publish(Arc::downgrade(&shared), shared.publish.clone()));
        lock(&shared.tasks).extend([follow, publish]);
        shared.publish.notify_one();
        let weak: Weak<Shared> = Arc::downgrade(&shared);
        *existing = weak;
        Ok(FleetStop(shared))
    }
}

async fn follow(shared: Weak<Shared>, messages: Subscriber<Payload>, events: Events) {
    loop {
        tokio::select! {
            message = messages.next() => {
                let (Some(shared), Some(message)) = (shared.upgrade(), message) else { return };
                shared.on_message(&message);
            }
            event = events.next() => {
                let (Some(shared), Some(event)) = (shared.upgrade(), event) else { return };
                match event {
                    Event::PeerDown { robot } => lock(&shared.known).on_gone(&robot),
                    Event::PeerUp { robot } => lock(&shared.known).on_returned(&robot),
                    // It may be the one that takes part, which only the router of the robot knows.
                    Event::ProgramDown { robot, .. } => {
                        let runtime = shared.robot.inner.runtime.clone();
                        runtime.spawn(ask_again(Arc::downgrade(&shared), shared.robot.clone(), robot));
                        continue;
                    }
                    _ => continue,
                }
                shared.changes.send_replace(());
            }
        }
    }
}

/// Asks a robot for its state, in which its router marks that the program has ended.
async fn ask_again(shared: Weak<Shared>, robot: Robot, other: Name) {
    tokio::time::sleep(MARKED_WITHIN).await;
    let takes_part = |shared: Arc<Shared>| lock(&shared.known).confirmation(&other).is_some();
    if !shared.upgrade().is_some_and(takes_part) {
        return;
    }
    let latest = robot.latest::<Payload>(other, TOPIC).await;
    if let (Ok(Some(message)), Some(shared)) = (latest, shared.upgrade()) {
        shared.on_message(&message);
    }
}

async fn publish(shared: Weak<Shared>, wake: Arc<Notify>) {
    loop {
        wake.notified().await;
        let Some(shared) = shared.upgrade() else {
            return;
        };
        match shared.publish().await {
            Ok(()) => {}
            Err(Error::Closed) => return,
            Err(error) => {
                let warnings = &shared.robot.inner.warnings;
                warnings.on_retention_problem(&error.to_string());
                tokio::time::sleep(AGAIN_AFTER).await;
                wake.notify_one();
            }
        }
    }
}

impl Shared {
    fn on_message(&self, message: &Message) {
        if message.is_forgotten() {
            return;
        }
        let has_ended = message.retained.is_some_and(|retained| retained.has_ended);
        let learned = lock(&self.known).on_message(&message.sender, &message.payload, has_ended);
        match learned {
            Ok(true) => {
                *lock(&self.published) = None;
                self.publish.notify_one();
            }
            Ok(false) => {}
            Err(problem) => warn(&format!(
                "{} sends something on {TOPIC} that is not a stop: {problem}",
                message.sender
            )),
        }
        self.changes.send_replace(());
    }

    /// Publishes what this program knows, unless that is published already.
    async fn publish_in_memory(&self) -> Result<(), Error> {
        let message = lock(&self.known).message();
        if lock(&self.published).as_ref() == Some(&message) {
            return Ok(());
        }
        let retained = self.robot.urgent().retained();
        retained.publish(TOPIC, message.clone()).await?;
        *lock(&self.published) = Some(message);
        Ok(())
    }

    /// Publishes what this program knows: at once, and then on the disk of the robot, which takes longer.
    async fn publish(&self) -> Result<(), Error> {
        self.publish_in_memory().await?;
        if self.robot.inner.direct {
            // A program without a router keeps nothing on disk.
            return Ok(());
        }
        let message = lock(&self.known).message();
        let on_disk = self.robot.urgent().retained_on_disk();
        on_disk.publish(TOPIC, message).await
    }
}

/// Wakes the task that publishes when it is dropped.
struct PublishesLater<'a>(&'a Notify);

impl Drop for PublishesLater<'_> {
    fn drop(&mut self) {
        self.0.notify_one();
    }
}

impl FleetStop {
    /// Stops the fleet, until somebody releases it. `reason`: why, in a few words, for people; may be empty. Returns when the router of
    /// this robot has the stop; [`confirmation`](Self::confirmation) says which robots have it.
    ///
    /// # Errors
    /// [`Error::NotRetained`] if no router keeps it: only robots that are reachable now get it. [`Error::Closed`] if the session is
    /// closed.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the stop is published nevertheless.
    pub async fn press(&self, reason: &str) -> Result<(), Error> {
        let now = ms_since_1970(SystemTime::now());
        lock(&self.0.known).press(reason, now);
        self.publish().await
    }

    /// Releases all stops that this robot knows. Nothing moves yet: [`deadman`](Robot::deadman) waits for a neutral command. Nothing
    /// happens if there is none.
    ///
    /// # Errors
    /// Returns the errors of [`press`](Self::press).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the release is published nevertheless.
    pub async fn release(&self) -> Result<(), Error> {
        match lock(&self.0.known).release() {
            true => {}
            false => return Ok(()),
        }
        self.publish().await
    }

    async fn publish(&self) -> Result<(), Error> {
        self.0.changes.send_replace(());
        // The task puts it on the disk, also if the future is dropped or this fails.
        let _later = PublishesLater(&self.0.publish);
        self.0.publish_in_memory().await
    }

    /// Returns whether the fleet is stopped.
    pub fn is_stopped(&self) -> bool {
        lock(&self.0.known).is_stopped()
    }

    /// Returns the stops that nobody has released, the latest first.
    pub fn pressed(&self) -> Vec<Stop> {
        lock(&self.0.known).pressed()
    }

    pub(super) fn reason(&self) -> Option<String> {
        lock(&self.0.known).reason()
    }

    /// Returns whether a robot has confirmed the stop, or its release; `None` if none of its programs takes part, or if it is not
    /// reachable.
    pub fn confirmation(&self, robot: &Name) -> Option<Confirmation> {
        lock(&self.0.known).confirmation(robot)
    }

    /// Reports stops, releases and confirmations from now on.
    pub fn changes(&self) -> StopChanges {
        StopChanges(self.0.changes.subscribe())
    }
}

impl StopChanges {
    /// Waits until a stop, a release or a confirmation is known that was not when this was called last. Several are reported as one.
    /// Returns `None` once this program does not take part any more.
    ///
    /// # Cancel safety
    /// If the future is dropped, no change is lost.
    pub async fn next(&mut self) -> Option<()> {
        self.0.changed().await.ok()
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        lock(&self.tasks).iter().for_each(JoinHandle::abort);
    }
}

impl fmt::Debug for FleetStop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("FleetStop")
            .field("pressed", &self.pressed())
            .finish_non_exhaustive()
    }
}
