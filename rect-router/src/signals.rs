//! SIGTERM and SIGINT: the first asks for a clean end, the second ends the program on the spot.

use std::{io, process, sync::mpsc::Sender, thread};

use signal_hook::{
    consts::{SIGINT, SIGTERM},
    iterator::Signals,
    low_level::signal_name,
};

use crate::logging;

/// Sends `event()` on the first signal.
pub fn watch<E: Send + 'static>(events: Sender<E>, event: fn() -> E) -> io::Result<()> {
    let mut signals = Signals::new([SIGTERM, SIGINT])?;
    thread::Builder::new()
        .name("signals".into())
        .spawn(move || {
            let mut asked = false;
            for signal in signals.forever() {
                let name = signal_name(signal).unwrap_or("signal");
                if asked {
                    tracing::warn!("{name} again: ending without closing the links");
                    logging::finish();
                    process::exit(128 + signal);
                }
                asked = true;
                // Nobody listens once the router has ended by itself; then there is nothing left to stop.
                let _ = events.send(event());
                tracing::info!("{name}: closing");
            }
        })?;
    Ok(())
}
