//! Chooses the threads of Zenoh.
use std::env;

use rect_core::session::threads::{ONE_THREAD, VARIABLE};

/// Lets Zenoh do all its work on one thread in place of five pools, unless the environment variable `ZENOH_RUNTIME` is set.
///
/// That saves a wake-up for each message, and the memory of the threads. It is only safe for a program in which nothing
/// blocks that thread. These do: a callback of Zenoh itself that blocks, a receive queue with the rule
/// [`WhenFull::Block`](crate::WhenFull::Block), and a service or a dictionary whose answer waits for room on a slow link.
/// One of them stops all other messages of the program as well. Zenoh itself blocks it for up to 10 s when it closes a TCP link
/// that has died with unsent data (`SO_LINGER`), so this is for programs whose router runs on the same computer.
///
/// Call it at the start of `main`, before other threads run and before the first session. Programs that this one starts
/// inherit the variable; a `rect-router` ignores this value.
///
/// ```no_run
/// fn main() -> Result<(), rect::Error> {
///     rect::use_one_thread();
///     let robot = rect::blocking::connect("wombat-1")?;
///     robot.publish("arm/angle", rect::Json(12.5))
/// }
/// ```
pub fn use_one_thread() {
    if env::var_os(VARIABLE).is_none() {
        env::set_var(VARIABLE, ONE_THREAD);
    }
}
