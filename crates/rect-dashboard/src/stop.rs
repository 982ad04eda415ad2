//! Implements the Stop button: stops the fleet, and shows all browsers who has stopped it and how far each robot has followed, until
//! somebody releases it. The fleet remembers the stop, so this program does not.
mod progress;

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use rect::{Error, Event, FleetStop, Robot, StopChanges};
use tokio::{sync::OnceCell, time::sleep};

use self::progress::Progress;
use crate::{browsers::Browsers, protocol::State};

/// How often the progress is shown while the fleet is stopped.
const SHOWN_EVERY: Duration = Duration::from_secs(1);
/// How long to wait before this program tries again to take part.
const AGAIN_AFTER: Duration = Duration::from_secs(2);

/// The Stop button of all browsers.
pub struct StopButton {
    robot: Robot,
    browsers: Arc<Browsers>,
    fleet_stop: OnceCell<FleetStop>,
    progress: Mutex<Progress>,
}

impl StopButton {
    /// Creates the button. [`run`](Self::run) has to run, so that browsers learn of stops.
    pub fn new(robot: Robot, browsers: Arc<Browsers>) -> Arc<Self> {
        let button = Self {
            progress: Mutex::new(Progress::new(robot.name().clone())),
            robot,
            browsers,
            fleet_stop: OnceCell::new(),
        };
        button.show();
        Arc::new(button)
    }

    /// Shows stops, releases and confirmations of all programs, until the session is closed.
    pub async fn run(&self) {
        loop {
            match self.fleet_stop().await {
                Ok(stop) => return self.follow(stop.changes()).await,
                Err(Error::Closed) => return,
                Err(error) => {
                    tracing::warn!("this program takes no part in stops of the fleet: {error}");
                    sleep(AGAIN_AFTER).await;
                }
            }
        }
    }

    async fn follow(&self, mut changes: StopChanges) {
        loop {
            let is_stopped = self.update();
            tokio::select! {
                change = changes.next() => match change {
                    Some(()) => {}
                    None => return,
                },
                () = sleep(SHOWN_EVERY), if is_stopped => {}
            }
        }
    }

    /// Stops the fleet. `by`: the user of the button, for people.
    ///
    /// # Errors
    /// Returns why no router keeps the stop. It is sent as soon as one does.
    pub async fn press(&self, by: &str) -> Result<(), String> {
        self.progress().on_press(Instant::now());
        let pressed = match self.fleet_stop().await {
            Ok(stop) => stop.press(by).await,
            Err(error) => Err(error),
        };
        let pressed = pressed.map_err(|error| error.to_string());
        self.progress().on_pressed(pressed.clone().err());
        self.update();
        pressed
    }

    /// Releases all stops of the fleet.
    ///
    /// # Errors
    /// Returns why no router keeps the release.
    pub async fn release(&self) -> Result<(), String> {
        let released = match self.fleet_stop().await {
            Ok(stop) => stop.release().await,
            Err(error) => Err(error),
        };
        self.update();
        released.map_err(|error| error.to_string())
    }

    /// Handles a change of the fleet.
    pub fn on_event(&self, event: &Event) {
        self.progress().on_event(event);
        self.update();
    }

    async fn fleet_stop(&self) -> Result<&FleetStop, Error> {
        let take_part = || self.robot.fleet_stop();
        self.fleet_stop.get_or_try_init(take_part).await
    }

    /// Takes over what this program knows of stops. Returns whether the fleet is stopped.
    fn update(&self) -> bool {
        let Some(stop) = self.fleet_stop.get() else {
            return false;
        };
        let pressed = stop.pressed();
        let is_stopped = !pressed.is_empty();
        self.progress()
            .update(pressed, |robot| stop.confirmation(robot), Instant::now());
        self.show();
        is_stopped
    }

    /// Sends the stop to all browsers, and to those that come later.
    fn show(&self) {
        let stop = self.progress().state(Instant::now());
        self.browsers.publish("stop", &State::Stop { stop });
    }

    fn progress(&self) -> MutexGuard<'_, Progress> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
