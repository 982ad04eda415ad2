//! Implements the dead man's switch: a robot follows commands while they arrive.
use std::{
    fmt,
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::{Duration, Instant},
};

use rect_core::{
    deadman,
    message::{payload::FromPayload, Message},
    name::topic::Pattern,
    registry::connection::Event,
};
use tokio::task::JoinHandle;

use super::{
    events::Events,
    robot::Robot,
    shared::sleep_until,
    stop::{FleetStop, StopChanges},
    subscriber::{call, Subscriber},
};
use crate::error::{valid, Error};

/// A dead man's switch; created by [`Robot::deadman`]. Dropping it ends it, as a loss.
pub struct Deadman {
    is_following: Arc<AtomicBool>,
    task: JoinHandle<()>,
}

/// The next call of a program that follows commands.
#[doc(hidden)]
pub enum DeadmanCall<C> {
    /// Carry out a command.
    Command(C),
    /// Stop the motors, for this reason.
    Lost(String),
}

/// The commands of a dead man's switch, and their losses, for the C library: its program takes them on a thread of its own.
#[doc(hidden)]
pub struct DeadmanCalls<T: FromPayload> {
    switch: deadman::Deadman,
    stop: FleetStop,
    stops: StopChanges,
    events: Events,
    commands: Subscriber<T>,
}

impl<T: FromPayload> DeadmanCalls<T> {
    /// Begins a switch. Fails as [`Robot::deadman`] does.
    pub async fn begin(
        robot: &Robot,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        within: Duration,
    ) -> Result<Self, Error> {
        let pattern: Pattern = valid(pattern)?;
        let mut switch = deadman::Deadman::new(within).map_err(|reason| Error::Option {
            option: "within",
            value: format!("{within:?}"),
            source: reason.into(),
        })?;
        let stop = robot.fleet_stop().await?;
        let events = robot.events().await?;
        let commands = robot.subscribe::<T>(pattern).await?;
        let stops = stop.changes();
        switch.on_stop(stop.reason());
        Ok(Self {
            switch,
            stop,
            stops,
            events,
            commands,
        })
    }

    /// Waits for the next call. Only messages for which `is_command` returns true count. Returns `None` once the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost.
    pub async fn next(
        &mut self,
        is_command: impl Fn(&Message<T::Value>) -> bool,
    ) -> Option<DeadmanCall<Message<T::Value>>> {
        let Self {
            switch,
            stop,
            stops,
            events,
            commands,
        } = self;
        loop {
            if let Some(reason) = switch.poll(Instant::now()) {
                return Some(DeadmanCall::Lost(reason));
            }
            let expired = sleep_until(switch.deadline());
            tokio::select! {
                biased;
                changed = stops.next() => {
                    changed?;
                    switch.on_stop(stop.reason());
                }
                event = events.next() => match event? {
                    Event::PeerDown { robot } => switch.on_gone(&robot),
                    Event::PeerUp { robot } => switch.on_returned(Instant::now(), &robot),
                    Event::ProgramDown { robot, .. } => {
                        switch.on_program_gone(Instant::now(), &robot);
                    }
                    _ => {}
                },
                message = commands.next() => {
                    let message = message?;
                    if is_command(&message) && switch.on_command(Instant::now(), &message) {
                        return Some(DeadmanCall::Command(message));
                    }
                }
                () = expired => {}
            }
        }
    }
}

/// Calls `on_lost` when the switch is dropped.
struct Following<L: FnMut(&str)> {
    is_following: Arc<AtomicBool>,
    on_lost: L,
}

impl<L: FnMut(&str)> Following<L> {
    fn lose(&mut self, reason: &str) {
        self.is_following.store(false, Ordering::Release);
        let on_lost = &mut self.on_lost;
        call("on_lost", || on_lost(reason));
    }
}

impl<L: FnMut(&str)> Drop for Following<L> {
    fn drop(&mut self) {
        self.lose(deadman::ENDED);
    }
}

impl Robot {
    /// Carries out commands while they arrive: calls `on_command` for each message that matches `pattern`, and `on_lost`, which stops the
    /// motors, when none has arrived for the time `within` (0.02 to 60 s), when the robot of the last one cannot be reached, while the
    /// fleet is [stopped](Self::fleet_stop), and before the first one.
    ///
    /// `on_lost` gets the reason, once for each loss; the next command resumes. After a stop, the first command that counts is a neutral
    /// one, whose numbers are all 0. Retained and replayed messages never count, and a message without a value neither. Both functions are called on a thread of
    /// the runtime, one at a time, and must not block it. If this program itself hangs, nothing stops its motors: use
    /// the watchdog of the motor controller as well.
    ///
    /// ```no_run
    /// # #[derive(serde::Deserialize)] struct Drive { left: f64, right: f64 }
    /// # fn set_motors(left: f64, right: f64) {}
    /// # async fn follow(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let within = std::time::Duration::from_millis(300);
    /// let _switch = robot.deadman::<Drive>(
    ///     "laptop/drive",
    ///     within,
    ///     |drive| set_motors(drive.left, drive.right),
    ///     |reason| {
    ///         set_motors(0.0, 0.0);
    ///         println!("stopped: {reason}");
    ///     },
    /// ).await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the pattern is invalid, [`Error::Option`] if the time is, and [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no switch.
    pub async fn deadman<T: FromPayload>(
        &self,
        pattern: impl TryInto<Pattern, Error: Into<Error>>,
        within: Duration,
        mut on_command: impl FnMut(T::Value) + Send + 'static,
        on_lost: impl FnMut(&str) + Send + 'static,
    ) -> Result<Deadman, Error>
    where
        T::Value: Send + 'static,
    {
        let mut calls = DeadmanCalls::<T>::begin(self, pattern, within).await?;
        let is_following = Arc::new(AtomicBool::new(false));
        let mut following = Following {
            is_following: is_following.clone(),
            on_lost,
        };
        let task = self.inner.runtime.spawn(async move {
            while let Some(next) = calls.next(|_| true).await {
                match next {
                    DeadmanCall::Lost(reason) => following.lose(&reason),
                    DeadmanCall::Command(message) => {
                        if let Ok(command) = message.value {
                            (following.is_following).store(true, Ordering::Release);
                            call("on_command", || on_command(command));
                        }
                    }
                }
            }
        });
        Ok(Deadman { is_following, task })
    }
}

impl Deadman {
    /// Returns whether the robot follows commands.
    pub fn is_following(&self) -> bool {
        self.is_following.load(Ordering::Acquire)
    }
}

impl Drop for Deadman {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl fmt::Debug for Deadman {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Deadman")
            .field("is_following", &self.is_following())
            .finish_non_exhaustive()
    }
}
