//! Handles SIGTERM and SIGINT: the first signal requests a clean end, the second ends the program immediately.

use std::{io, process, sync::mpsc::Sender, thread};

use signal_hook::{
    consts::{SIGINT, SIGTERM},
    iterator::Signals,
    low_level::signal_name,
};

use crate::logging;

/// Starts a thread that sends `event()` on the first signal.
///
/// # Errors
/// Fails if the signal handlers or the thread cannot be created.
pub fn watch<E: Send + 'static>(events: Sender<E>, event: fn() -> E) -> io::Result<()> {
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            let mut is_ending = false;
            for signal in signals.forever() {
                let name = signal_name(signal).unwrap_or("signal");
                if is_ending {
                    tracing::warn!("{name} again: exiting without closing the links");
                    logging::finish();
                    process::exit(128 + signal);
                }
                is_ending = true;
                // Sending fails if the router has already ended by itself.
                let _ = events.send(event());
                tracing::info!("{name}: closing");
            }
        })?;
    Ok(())
}
