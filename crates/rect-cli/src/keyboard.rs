//! Reads single keys from the terminal.
use std::io::{self, IsTerminal, Read};

use rustix::{
    process::getpgrp,
    termios::{tcgetattr, tcgetpgrp, tcsetattr, LocalModes, OptionalActions, Termios},
};
use tokio::sync::mpsc::{unbounded_channel, UnboundedReceiver};

/// The terminal, which reports each key at once until this is dropped.
pub struct Keyboard {
    before: Termios,
    keys: UnboundedReceiver<u8>,
}

impl Keyboard {
    /// Starts to read keys. Returns `None` if the standard input is not a terminal, or that of another job: the system stops a job in
    /// the background that changes or reads its terminal.
    pub fn open() -> Option<Self> {
        let terminal = io::stdin();
        if !terminal.is_terminal() || tcgetpgrp(&terminal).ok()? != getpgrp() {
            return None;
        }
        let before = tcgetattr(&terminal).ok()?;
        let mut changed = before.clone();
        // Ctrl-C keeps its meaning.
        changed.local_modes -= LocalModes::ICANON | LocalModes::ECHO;
        tcsetattr(&terminal, OptionalActions::Now, &changed).ok()?;
        let (sender, keys) = unbounded_channel();
        // The thread ends with the process, or when nobody receives its next key.
        std::thread::spawn(move || {
            for key in io::stdin().lock().bytes() {
                if key.is_err() || key.is_ok_and(|key| sender.send(key).is_err()) {
                    return;
                }
            }
        });
        Some(Self { before, keys })
    }

    /// Waits for the next key. There is none after the end of the input.
    pub async fn next(&mut self) -> u8 {
        match self.keys.recv().await {
            Some(key) => key,
            None => std::future::pending().await,
        }
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        // If that fails, the terminal was closed.
        let _ = tcsetattr(io::stdin(), OptionalActions::Now, &self.before);
    }
}
