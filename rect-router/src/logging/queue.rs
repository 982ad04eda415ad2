//! Queues the lines of the log for the thread that writes them. The queue is bounded: if the reader of the log is slow, has
//! stopped or has exited, lines are dropped, and the logging threads are never blocked.

use std::{
    io::{self, Write},
    sync::{
        atomic::{AtomicU64, Ordering},
        mpsc::{self, Receiver, SyncSender, TrySendError},
        Arc,
    },
    thread,
    time::Duration,
};

use rect_core::text::humanize::without_locations;

/// Maximum number of queued lines, for a burst while the disk or the terminal is busy. With lines of 300 bytes, 1.2 MB.
const CAPACITY: usize = 4096;

enum Item {
    Line(Vec<u8>),
    /// A request for a reply once all items before it are written.
    Flush(SyncSender<()>),
}

/// The queue of the thread that writes the log.
pub struct LineQueue {
    items: SyncSender<Item>,
    /// Number of lines dropped since the last line that was written.
    lost: Arc<AtomicU64>,
}

impl LineQueue {
    /// Starts a thread that writes to `out`.
    ///
    /// # Errors
    /// Fails if the system cannot start a thread.
    pub fn start(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (items, next) = mpsc::sync_channel(CAPACITY);
        let lost = Arc::<AtomicU64>::default();
        let writer = Writer {
            out,
            lost: Arc::clone(&lost),
        };
        thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || writer.run(&next))?;
        Ok(Self { items, lost })
    }

    /// Queues a line, or drops and counts it if the queue is full. Never blocks.
    pub fn push(&self, line: Vec<u8>) {
        match self.items.try_send(Item::Line(line)) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Waits until all lines queued so far are written, at most for `timeout`. Returns whether they were.
    pub fn flush(&self, timeout: Duration) -> bool {
        let (written, is_written) = mpsc::sync_channel(1);
        // If the queue is full, the reader has stopped, and waiting would not help.
        self.items.try_send(Item::Flush(written)).is_ok()
            && is_written.recv_timeout(timeout).is_ok()
    }
}

struct Writer<W> {
    out: W,
    lost: Arc<AtomicU64>,
}

impl<W: Write> Writer<W> {
    fn run(mut self, next: &Receiver<Item>) {
        for item in next {
            match item {
                Item::Line(line) => {
                    if self.write(&line).is_err() {
                        self.lost.fetch_add(1, Ordering::Relaxed);
                    }
                }
                Item::Flush(written) => {
                    let _ = written.send(());
                }
            }
        }
    }

    fn write(&mut self, line: &[u8]) -> io::Result<()> {
        let lost = self.lost.swap(0, Ordering::Relaxed);
        if lost > 0 {
            let note = format!(
                "rect-router: log lines dropped here: {lost} (not read in time, or could not be written)\n"
            );
            let noted = self.out.write_all(note.as_bytes());
            if noted.is_err() {
                self.lost.fetch_add(lost, Ordering::Relaxed);
            }
            noted?;
        }
        match std::str::from_utf8(line) {
            Ok(text) => self.out.write_all(without_locations(text).as_bytes())?,
            Err(_) => self.out.write_all(line)?,
        }
        self.out.flush()
    }
}

/// A line of the log under construction. Dropping it queues it.
pub struct Line {
    queue: &'static LineQueue,
    text: Vec<u8>,
}

impl Line {
    /// Creates an empty line.
    pub fn new(queue: &'static LineQueue) -> Self {
        Self {
            queue,
            text: Vec::new(),
        }
    }
}

impl Write for Line {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.text.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Drop for Line {
    fn drop(&mut self) {
        if !self.text.is_empty() {
            self.queue.push(std::mem::take(&mut self.text));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    /// A writer controlled by its test: each permit lets one `write_all` succeed or fail.
    struct Gate {
        permits: Receiver<bool>,
        written: Arc<Mutex<Vec<u8>>>,
    }

    impl Write for Gate {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            match self.permits.recv() {
                Ok(true) => {
                    self.written.lock().expect("unpoisoned").extend(bytes);
                    Ok(bytes.len())
                }
                Ok(false) | Err(_) => Err(io::ErrorKind::BrokenPipe.into()),
            }
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    fn gated() -> (LineQueue, mpsc::Sender<bool>, Arc<Mutex<Vec<u8>>>) {
        let (permit, permits) = mpsc::channel();
        let written = Arc::<Mutex<Vec<u8>>>::default();
        let gate = Gate {
            permits,
            written: Arc::clone(&written),
        };
        (LineQueue::start(gate).expect("a thread"), permit, written)
    }

    const TIMEOUT: Duration = Duration::from_secs(30);

    fn text(written: &Mutex<Vec<u8>>) -> String {
        let written = written.lock().expect("unpoisoned").clone();
        String::from_utf8(written).expect("text")
    }

    #[test]
    fn drops_lines_instead_of_blocking_when_the_reader_has_stopped() {
        let (queue, permit, written) = gated();
        // Nothing is read, but the loop does not block.
        for line in 0..CAPACITY + 100 {
            queue.push(format!("{line}\n").into_bytes());
        }
        assert!(!queue.flush(TIMEOUT), "the queue is full");
        // Permits for each line, the note about missing lines, and the last line.
        for _ in 0..CAPACITY + 10 {
            permit.send(true).expect("the thread runs");
        }
        while !queue.flush(TIMEOUT) {
            thread::yield_now();
        }
        queue.push(b"last\n".to_vec());
        assert!(queue.flush(TIMEOUT));
        let text = text(&written);
        assert!(text.contains("log lines dropped here"), "{text}");
        assert!(text.ends_with("last\n"), "{text}");
    }

    #[test]
    fn counts_lines_that_cannot_be_written() {
        let (queue, permit, written) = gated();
        permit.send(false).expect("the thread runs");
        queue.push(b"lost\n".to_vec());
        assert!(queue.flush(TIMEOUT));
        for _ in 0..2 {
            permit.send(true).expect("the thread runs");
        }
        queue.push(b"kept\n".to_vec());
        assert!(queue.flush(TIMEOUT));
        let text = text(&written);
        assert!(text.contains("log lines dropped here: 1 "), "{text}");
        assert!(text.ends_with("kept\n"), "{text}");
    }
}
