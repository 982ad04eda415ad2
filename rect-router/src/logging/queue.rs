//! Carries the log's lines to their reader: a bounded queue and the thread that writes. A reader that is slow,
//! has stopped or is gone costs lines, never time.

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

/// How many lines may wait: a burst while the disk or the terminal is busy. With lines of 300 bytes, 1.2 MB.
const WAITING: usize = 4096;

enum Item {
    Line(Vec<u8>),
    /// Everything before is written once this is answered.
    Flush(SyncSender<()>),
}

/// The way to the thread that writes.
pub struct LineQueue {
    items: SyncSender<Item>,
    /// Lines that were left out since the last one that was written.
    lost: Arc<AtomicU64>,
}

impl LineQueue {
    /// Starts the thread that writes to `out`.
    pub fn start(out: impl Write + Send + 'static) -> io::Result<Self> {
        let (items, next) = mpsc::sync_channel(WAITING);
        let lost = Arc::<AtomicU64>::default();
        let writing = Writing {
            out,
            lost: Arc::clone(&lost),
        };
        thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || writing.run(&next))?;
        Ok(Self { items, lost })
    }

    /// Hands a line over, or counts it as lost if too many wait.
    pub fn push(&self, line: Vec<u8>) {
        match self.items.try_send(Item::Line(line)) {
            Ok(()) => {}
            Err(TrySendError::Full(_) | TrySendError::Disconnected(_)) => {
                self.lost.fetch_add(1, Ordering::Relaxed);
            }
        }
    }

    /// Waits until all lines so far are written, at most as long as `timeout`; tells whether they are.
    pub fn flush(&self, timeout: Duration) -> bool {
        let (written, is_written) = mpsc::sync_channel(1);
        // If the queue is full, nobody reads, and waiting would be in vain.
        self.items.try_send(Item::Flush(written)).is_ok()
            && is_written.recv_timeout(timeout).is_ok()
    }
}

struct Writing<W> {
    out: W,
    lost: Arc<AtomicU64>,
}

impl<W: Write> Writing<W> {
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
            let note = format!("rect-router: lines of the log are missing here ({lost}): they were not read in time, or could not be written\n");
            let noted = self.out.write_all(note.as_bytes());
            if noted.is_err() {
                self.lost.fetch_add(lost, Ordering::Relaxed);
            }
            noted?;
        }
        self.out.write_all(line)?;
        self.out.flush()
    }
}

/// One line of the log while it is put together; dropping it hands it over.
pub struct Line {
    queue: &'static LineQueue,
    text: Vec<u8>,
}

impl Line {
    /// An empty one.
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

    /// A writer that does what its test says: each permit is one `write_all`, which succeeds or fails.
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

    const PATIENCE: Duration = Duration::from_secs(30);

    fn text(written: &Mutex<Vec<u8>>) -> String {
        let written = written.lock().expect("unpoisoned").clone();
        String::from_utf8(written).expect("text")
    }

    #[test]
    fn a_reader_that_has_stopped_costs_lines_and_no_time() {
        let (queue, permit, written) = gated();
        // Nothing is read, and yet this returns.
        for line in 0..WAITING + 100 {
            queue.push(format!("{line}\n").into_bytes());
        }
        assert!(!queue.flush(PATIENCE), "it is full");
        // Each line, the note about those that are missing, and the last line.
        for _ in 0..WAITING + 10 {
            permit.send(true).expect("the thread runs");
        }
        while !queue.flush(PATIENCE) {
            thread::yield_now();
        }
        queue.push(b"last\n".to_vec());
        assert!(queue.flush(PATIENCE));
        let text = text(&written);
        assert!(text.contains("lines of the log are missing here"), "{text}");
        assert!(text.ends_with("last\n"), "{text}");
    }

    #[test]
    fn lines_that_cannot_be_written_are_counted() {
        let (queue, permit, written) = gated();
        permit.send(false).expect("the thread runs");
        queue.push(b"lost\n".to_vec());
        assert!(queue.flush(PATIENCE));
        for _ in 0..2 {
            permit.send(true).expect("the thread runs");
        }
        queue.push(b"kept\n".to_vec());
        assert!(queue.flush(PATIENCE));
        let text = text(&written);
        assert!(text.contains("are missing here (1)"), "{text}");
        assert!(text.ends_with("kept\n"), "{text}");
    }
}
