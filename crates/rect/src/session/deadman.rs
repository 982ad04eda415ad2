//! Implements the dead man's switch: a robot follows commands while they arrive.
use std::{
    fmt,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc, Arc, Mutex,
    },
    thread,
    time::{Duration, Instant},
};

use rect_core::{
    deadman,
    message::{payload::FromPayload, Message},
    name::topic::Pattern,
    registry::connection::Event,
};
use tokio::{sync::Notify, task::JoinHandle};

use super::{
    events::Events,
    robot::Robot,
    shared::{lock, sleep_until},
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

/// Calls `on_lost` when the commander is lost, also while a command is being carried out on another thread: then at once, and again after
/// the command, which may have moved something since.
#[doc(hidden)]
pub struct Losses<L> {
    state: Mutex<LossState<L>>,
    finished: Notify,
}

struct LossState<L> {
    on_lost: L,
    /// Whether a command is being carried out. Until its end, no other one counts.
    is_busy: bool,
    /// Why the commander was lost meanwhile.
    reason: Option<String>,
}

impl<L: FnMut(&str)> Losses<L> {
    /// Creates what calls `on_lost`.
    pub fn new(on_lost: L) -> Self {
        let state = LossState {
            on_lost,
            is_busy: false,
            reason: None,
        };
        Self {
            state: Mutex::new(state),
            finished: Notify::new(),
        }
    }

    /// Handles that the commander is lost.
    pub fn on_lost(&self, reason: &str) {
        let mut state = lock(&self.state);
        if state.is_busy {
            state.reason = Some(reason.to_owned());
        }
        call("on_lost", || (state.on_lost)(reason));
    }

    /// Handles that a command begins.
    pub fn begin(&self) {
        lock(&self.state).is_busy = true;
    }

    /// Handles that it was carried out.
    pub fn finish(&self) {
        let mut state = lock(&self.state);
        state.is_busy = false;
        if let Some(reason) = state.reason.take() {
            call("on_lost", || (state.on_lost)(&reason));
        }
        drop(state);
        self.finished.notify_one();
    }

    fn is_busy(&self) -> bool {
        lock(&self.state).is_busy
    }
}

/// The commands of a dead man's switch, and their losses, for the C library, too.
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

    /// Waits for the next call. Only messages for which `is_command` returns true count, and none while a command is being carried out.
    /// Returns `None` once the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped, nothing is lost.
    pub async fn next<L: FnMut(&str)>(
        &mut self,
        losses: &Losses<L>,
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
            let is_busy = losses.is_busy();
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
                () = losses.finished.notified(), if is_busy => {}
                message = commands.next(), if !is_busy => {
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
    losses: Arc<Losses<L>>,
}

impl<L: FnMut(&str)> Following<L> {
    fn lose(&self, reason: &str) {
        self.is_following.store(false, Ordering::Release);
        self.losses.on_lost(reason);
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
    /// one, whose numbers are all 0. Retained and replayed messages never count, and a message without a value neither.
    ///
    /// `on_command` is called on a thread of its own, one command at a time, and may block it. Commands that arrive meanwhile count only when
    /// it has returned: if it takes longer than `within`, the commander is lost. `on_lost` is called on a thread of the runtime, which it
    /// must not block. It does not wait for `on_command`: if that is running, `on_lost` is called at once, and again as soon as
    /// `on_command` has returned, which may have started the motors in between. If this program itself hangs, nothing stops its motors:
    /// use the watchdog of the motor controller as well.
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
    /// [`Error::Topic`] if the pattern is invalid, [`Error::Option`] if the time is, [`Error::Thread`] if there is no thread for the
    /// commands, and [`Error::Closed`] if the session is closed.
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
        let losses = Arc::new(Losses::new(on_lost));
        let following = Following {
            is_following: is_following.clone(),
            losses: losses.clone(),
        };
        let runtime = self.inner.runtime.clone();
        let (commands, received) = mpsc::channel::<T::Value>();
        let carry_out = move || {
            // Functions of Tokio can be called there, as elsewhere in the program.
            let _runtime = runtime.enter();
            for command in received {
                call("on_command", || on_command(command));
                losses.finish();
            }
        };
        let thread = thread::Builder::new().name("rect-deadman".to_owned());
        let thread = thread.spawn(carry_out);
        thread.map_err(|source| Error::Thread { source })?;
        let task = self.inner.runtime.spawn(async move {
            let losses = following.losses.clone();
            while let Some(next) = calls.next(&losses, |_| true).await {
                match next {
                    DeadmanCall::Lost(reason) => following.lose(&reason),
                    DeadmanCall::Command(message) => {
                        if let Ok(command) = message.value {
                            (following.is_following).store(true, Ordering::Release);
                            losses.begin();
                            // The thread ends after this task.
                            let _ = commands.send(command);
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
