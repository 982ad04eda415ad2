//! Raises and clears alerts.
use std::time::SystemTime;

use rect_core::{
    alert::{
        self,
        query::{AlertsQuery, RobotAlert},
        Alert,
    },
    clock::unix::ms_since_1970,
    log::level::Level,
    name::Name,
};

use super::{executor::Executor, robot::Robot, shared::NoItems};
use crate::error::Error;

impl Robot {
    /// Raises an alert: something is wrong with this robot until [`clear_alert`](Self::clear_alert) ends it. `rect status`, the page and
    /// recordings show it.
    ///
    /// It is a [retained](Self::retained) message on the topic `alerts/<name>`, whose name is the text in words: `battery low` has
    /// `alerts/battery-low`. It stays when the program ends. The same alert again replaces the first one.
    ///
    /// ```no_run
    /// # async fn check(robot: rect::Robot) -> Result<(), rect::Error> {
    /// robot.alert(rect::Level::Warn, "battery low").await?;
    /// robot.clear_alert("battery low").await?;
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Topic`] if the text has neither a letter nor a digit, [`Error::NotRetained`] if no router keeps it, and
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the alert may be raised or not.
    pub async fn alert(&self, level: Level, text: &str) -> Result<(), Error> {
        self.alert_named(text, level, text).await
    }

    /// Raises an alert under a name of its own, for a text that changes: `battery` with the text `battery at 12 %`.
    ///
    /// # Errors
    /// Returns the same errors as [`alert`](Self::alert).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the alert may be raised or not.
    pub async fn alert_named(&self, name: &str, level: Level, text: &str) -> Result<(), Error> {
        let alert = Alert {
            text: text.to_owned(),
            level,
            at: ms_since_1970(SystemTime::now()),
            program: self.program_name(),
        };
        let topic = alert::topic(name)?;
        self.retained().publish(topic, alert.write()).await
    }

    /// Returns the alerts of a robot, or of all robots that can be reached (`None`).
    ///
    /// # Errors
    /// [`Error::Closed`] if the session is closed.
    ///
    /// # Cancel safety
    /// Dropping the future has no effect.
    pub async fn alerts(&self, robot: Option<Name>) -> Result<Vec<RobotAlert>, Error> {
        let query = AlertsQuery::new(self.inner.place.clone(), robot, self.timeout);
        let found = Executor::new(&self.inner.session, query, NoItems)
            .run()
            .await?;
        found.ok_or(Error::Closed)
    }

    /// Clears the alert with this name or text. Nothing happens if it was not raised.
    ///
    /// # Errors
    /// Returns the same errors as [`alert`](Self::alert).
    ///
    /// # Cancel safety
    /// If the future is dropped after it was polled, the alert may be cleared or not.
    pub async fn clear_alert(&self, name: &str) -> Result<(), Error> {
        self.forget(alert::topic(name)?).await
    }
}
