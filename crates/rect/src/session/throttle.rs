//! Sends other robots as many messages as they asked for.
use std::fmt;

use rect_core::{name::key::KeySpace, throttle::Throttle};
use zenoh::Session;

use super::{
    executor::{Executor, OnThread},
    warnings::WarningSink,
};
use crate::error::Error;

/// The throttle of a robot, until this is dropped. For routers; a program without a router has one of its own.
#[doc(hidden)]
pub struct RunningThrottle {
    _running: OnThread<Throttle>,
}

impl RunningThrottle {
    /// Begins to send the messages of the robot of `place` that others ask for with `max_hz` or `on_change`, on a thread.
    ///
    /// # Errors
    /// [`Error::Zenoh`] if Zenoh refuses a declaration.
    pub fn start(session: &Session, place: KeySpace) -> Result<Self, Error> {
        let executor = Executor::new(session, Throttle::new(place), WarningSink);
        let _running = OnThread::start(executor, "throttle")?;
        Ok(Self { _running })
    }
}

impl fmt::Debug for RunningThrottle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("RunningThrottle").finish_non_exhaustive()
    }
}
