//! Numbers the requests of a program.
use std::{
    sync::atomic::{AtomicU32, Ordering},
    time::Duration,
};

use crate::{
    message::request::{timeout_ms, RequestHeader, RequestId},
    name::{instance::Instance, key::KeySpace},
};

/// The ids of the requests of one run of a program.
#[derive(Debug)]
pub struct RequestIds {
    run: Instance,
    is_announced: bool,
    next: AtomicU32,
}

impl RequestIds {
    /// Creates the ids of a run. `is_announced`: the program has a liveliness token all the time, because it has a name.
    pub fn new(run: Instance, is_announced: bool) -> Self {
        Self {
            run,
            is_announced,
            next: AtomicU32::new(0),
        }
    }

    /// Returns the header of the next request, which a program of the robot of `place` sends.
    pub fn header(&self, place: &KeySpace, timeout: Duration) -> RequestHeader {
        RequestHeader {
            sender: place.robot.clone(),
            timeout_ms: timeout_ms(timeout),
            id: RequestId {
                run: self.run,
                number: self.next.fetch_add(1, Ordering::Relaxed),
            },
            is_announced: self.is_announced,
            is_stream: false,
            once_by: None,
        }
    }
}
