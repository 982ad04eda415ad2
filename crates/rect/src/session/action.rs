//! Carries out the goals of actions, and starts and follows those of others.
mod goal;
mod options;
mod pull;
mod run;
mod serve;

pub use goal::{Cancelled, Goal};
pub use options::{ActionOptions, StartOptions};
pub use run::{ActionChanges, ActionRun};
pub use serve::Action;
