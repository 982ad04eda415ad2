//! Defines the interface between the drivers, which make the decisions of a session, and the executors of each language,
//! which perform the drivers' actions on Zenoh.
//!
//! An executor calls [`Driver::poll`] until the step is to wait or the driver has finished, and performs each action.
//! It reports what Zenoh delivers with [`Driver::on_event`]. Drivers do no I/O and never block.
mod action;
pub mod ended_tokens;
mod event;
pub mod question;

pub use action::{Action, Answer, Declaration, Get, RetainedReply, Target};
pub use event::{Event, Reaction, Sample};

use std::time::Instant;

/// Names a declaration or a query of one driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id(pub u64);

/// Names a query that arrived at a queryable of a driver. The executor chooses the number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct QueryId(pub u64);

/// The maximum number of queries that a driver has not answered. The executor ends further ones without an answer.
pub const MAX_OPEN_QUERIES: usize = 256;

/// The decisions of one handle of a session: a subscription to events, a stream, a transfer, a query.
pub trait Driver {
    /// An item that the driver delivers to the program, such as a frame.
    type Item;
    /// The result with which the driver finishes.
    type Output;

    /// Handles an event. Items that the reaction contains are delivered at once.
    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item>;

    /// Returns what to do now. Executors call it again after each action and each item.
    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output>;
}

/// The next thing that an executor does.
#[derive(Clone, Debug, PartialEq)]
pub enum Step<I, O> {
    /// Perform the action.
    Act(Action),
    /// Deliver the item to the program.
    Deliver(I),
    /// Wait until this time, or until an event whose reaction asks for a poll. `None`: wait only for such an event.
    Wait(Option<Instant>),
    /// The driver has finished. All that it declared ends.
    Finished(O),
}
