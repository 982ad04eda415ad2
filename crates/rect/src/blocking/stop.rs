//! The blocking form of the stop of a fleet.
use std::sync::Arc;

use super::Runtime;
use crate::{session, Confirmation, Error, Name, Stop};

/// The stop of the fleet; created by [`Robot::fleet_stop`](super::Robot::fleet_stop). See [`crate::FleetStop`].
#[derive(Clone, Debug)]
pub struct FleetStop {
    pub(super) stop: session::FleetStop,
    pub(super) runtime: Arc<Runtime>,
}

/// Reports changes of the stop of the fleet; created by [`FleetStop::changes`]. The iterator blocks until the next one.
#[derive(Debug)]
pub struct StopChanges {
    changes: session::StopChanges,
    runtime: Arc<Runtime>,
}

impl FleetStop {
    /// Stops the fleet; see [`crate::FleetStop::press`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn press(&self, reason: &str) -> Result<(), Error> {
        self.runtime.wait(self.stop.press(reason))
    }

    /// Releases all stops that this robot knows; see [`crate::FleetStop::release`].
    ///
    /// # Errors
    /// Returns the same errors.
    pub fn release(&self) -> Result<(), Error> {
        self.runtime.wait(self.stop.release())
    }

    /// Returns whether the fleet is stopped.
    pub fn is_stopped(&self) -> bool {
        self.stop.is_stopped()
    }

    /// Returns the stops that nobody has released, the latest first.
    pub fn pressed(&self) -> Vec<Stop> {
        self.stop.pressed()
    }

    /// Returns whether a robot has confirmed; see [`crate::FleetStop::confirmation`].
    pub fn confirmation(&self, robot: &Name) -> Option<Confirmation> {
        self.stop.confirmation(robot)
    }

    /// Reports stops, releases and confirmations from now on.
    pub fn changes(&self) -> StopChanges {
        StopChanges {
            changes: self.stop.changes(),
            runtime: self.runtime.clone(),
        }
    }
}

impl Iterator for StopChanges {
    type Item = ();

    fn next(&mut self) -> Option<()> {
        self.runtime.wait(self.changes.next())
    }
}
