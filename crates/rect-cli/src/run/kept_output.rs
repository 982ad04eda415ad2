//! Passes the output of a program on, and keeps its lines.
use std::{
    io::Write,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use rect::Level;
use tokio::{
    io::{AsyncRead, AsyncReadExt},
    task::JoinHandle,
    time::timeout,
};

use super::{journal::Journal, output::Lines};

/// How soon the lines of a stack trace follow one another.
const TOGETHER: Duration = Duration::from_millis(50);
/// The maximum number of bytes that are read at once.
const READ: usize = 16 << 10;

/// An output of a program.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Stream {
    Output,
    Errors,
}

/// Gives the output of a program to its log, in the order in which it arrives.
pub struct KeptOutput {
    journal: Arc<Journal>,
    streams: Mutex<Streams>,
}

#[derive(Default)]
struct Streams {
    output: Lines,
    errors: Lines,
    last_error: String,
}

impl Stream {
    fn other(self) -> Self {
        match self {
            Self::Output => Self::Errors,
            Self::Errors => Self::Output,
        }
    }
}

impl Streams {
    fn of(&mut self, stream: Stream) -> &mut Lines {
        match stream {
            Stream::Output => &mut self.output,
            Stream::Errors => &mut self.errors,
        }
    }
}

impl KeptOutput {
    pub fn new(journal: &Arc<Journal>) -> Self {
        Self {
            journal: Arc::clone(journal),
            streams: Mutex::default(),
        }
    }

    /// Keeps bytes. The text that waits of the other stream is complete.
    fn add(&self, stream: Stream, bytes: &[u8]) {
        let mut streams = self.streams();
        let before = streams.of(stream.other()).settle();
        self.keep(&mut streams, stream.other(), before);
        let texts = streams.of(stream).add(bytes);
        self.keep(&mut streams, stream, texts);
    }

    /// Keeps the text that waits, because no lines have followed it at once.
    fn settle(&self, stream: Stream) {
        let mut streams = self.streams();
        let texts = streams.of(stream).settle();
        self.keep(&mut streams, stream, texts);
    }

    /// Keeps what has no line break at the end of a stream.
    fn finish(&self, stream: Stream) {
        let mut streams = self.streams();
        let texts = streams.of(stream).finish();
        self.keep(&mut streams, stream, texts);
    }

    fn is_waiting(&self, stream: Stream) -> bool {
        self.streams().of(stream).is_waiting()
    }

    pub fn last_error(&self) -> String {
        std::mem::take(&mut self.streams().last_error)
    }

    fn keep(&self, streams: &mut Streams, stream: Stream, texts: Vec<String>) {
        let (name, level) = match stream {
            Stream::Output => ("stdout", Level::Info),
            Stream::Errors => ("stderr", Level::Warn),
        };
        for text in texts {
            if stream == Stream::Errors {
                text.clone_into(&mut streams.last_error);
            }
            self.journal.output(name, level, text);
        }
    }

    fn streams(&self) -> MutexGuard<'_, Streams> {
        self.streams.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Passes the output of a program on, on a task, and keeps its lines. The program never waits for a terminal that has been closed.
pub fn pass_on(
    mut from: impl AsyncRead + Unpin + Send + 'static,
    mut to: impl Write + Send + 'static,
    kept: &Arc<KeptOutput>,
    stream: Stream,
) -> JoinHandle<()> {
    let kept = Arc::clone(kept);
    tokio::spawn(async move {
        let mut buffer = vec![0; READ];
        let mut is_open = true;
        loop {
            let read = from.read(&mut buffer);
            let read = if kept.is_waiting(stream) {
                match timeout(TOGETHER, read).await {
                    Ok(read) => read,
                    Err(_) => {
                        kept.settle(stream);
                        continue;
                    }
                }
            } else {
                read.await
            };
            let Ok(count @ 1..) = read else { break };
            let bytes = &buffer[..count];
            is_open = is_open && to.write_all(bytes).and_then(|()| to.flush()).is_ok();
            kept.add(stream, bytes);
        }
        kept.finish(stream);
    })
}
