//! Messages of retained topics: their values ([`value`]), their attachment ([`live`]), and which of them a subscription delivers.
pub mod live;
pub(super) mod order;
pub mod value;

use std::{
    sync::{
        atomic::{AtomicBool, Ordering},
        Arc,
    },
    time::Duration,
};

use serde::{Deserialize, Serialize};

use self::value::Value;
use crate::name::Name;

/// The maximum size of a value, in bytes.
pub const MAX_VALUE: usize = 64 << 10;

/// Identifies a value: the run of the program that published it, and how many values that run had published before.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Origin(pub u32, pub u64);

/// A place in the order in which one run of a router numbers values: the run, a random number, and the number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Position(pub u32, pub u64);

/// The meaning of a retained message beside its value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Retained {
    /// How long ago it was published, by the clock of its robot's router; it does not depend on the time of day.
    pub age: Duration,
    /// Whether the program that published it has ended.
    pub has_ended: bool,
    /// Whether its robot has forgotten the topic: there is no value any more.
    pub is_forgotten: bool,
}

/// Whether retained messages reach a program through its router. If not, because the router is older than they are, they are delivered as
/// they are published.
#[derive(Clone, Debug)]
pub struct Following(Arc<AtomicBool>);

impl Default for Following {
    fn default() -> Self {
        Self(Arc::new(AtomicBool::new(true)))
    }
}

impl Following {
    /// Returns whether they do.
    pub fn is_active(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    pub(crate) fn set(&self, is_active: bool) {
        self.0.store(is_active, Ordering::Relaxed);
    }
}

/// Something from the router of a program, for its subscriptions.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// A value, with the name of its robot.
    Value {
        /// The value.
        value: Value,
        /// The run of the program's router.
        router: u32,
    },
    /// All values of a robot have arrived: others are forgotten.
    Complete {
        /// The robot.
        robot: Name,
        /// The position at the robot's router up to which all are known.
        at: Position,
        /// The run of the program's router.
        router: u32,
    },
}
