//! Decides which requests a program carries out, and which ones get the reply to an earlier request of the same id.
use std::{
    collections::{BTreeMap, VecDeque},
    fmt,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use crate::{
    catalogue::Instance,
    driver::Answer,
    message::{
        encoding::Encoding,
        payload::Payload,
        request::{error_to_payload, RequestHeader, RequestId},
    },
    name::Name,
};

/// The time for which a request may be under way. The requests of a run of a program are remembered until it has sent none for this
/// time and the longest timeout that it has stated.
pub const KEEP: Duration = Duration::from_secs(60);
/// The longest timeout of a request that is repeated.
pub const MAX_TIMEOUT: Duration = Duration::from_secs(600);
/// The maximum number of runs of programs whose requests are remembered.
pub const MAX_RUNS: usize = 64;
/// The maximum number of replies that are kept for one run.
pub const MAX_KEPT: usize = 64;
/// The maximum number of requests that are being carried out.
pub const MAX_RUNNING: usize = 256;
/// The maximum size of all replies that are kept, in bytes.
pub const MAX_BYTES: usize = 1 << 20;

/// The encoding of the error reply to a request that names another run of a program.
const ANOTHER_RUN: &str = "rect/another-run";
/// The encoding of the error reply to a request whose reply is not kept.
const NOT_KEPT: &str = "rect/not-kept";

/// The reason why a program does not carry out a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unrepeated {
    /// The request names another run of a program. That one may still reply.
    AnotherRun,
    /// The program has carried out the request, or may have done so, and does not keep its reply.
    NotKept,
}

/// The requests with an id that a program has carried out. Clones share them. `W` is a query that waits for its answer.
///
/// Requests are distinguished by their ids alone: one that repeats an id with another value gets the reply to the first value.
/// After 4 billion requests of a run, whose numbers begin again, it may be refused for [`KEEP`].
pub struct Once<W>(Arc<Mutex<Memory<W>>>);

/// The permission to carry out one request. If it is dropped without a result, repetitions of the request get no reply.
pub struct Execution<W> {
    id: RequestId,
    once: Once<W>,
}

/// The decision about a request.
#[derive(Debug)]
pub enum Admission<W> {
    /// Carry it out. The permission takes the result; there is none if the request may be carried out each time that it arrives.
    Execute(W, Option<Execution<W>>),
    /// It is being carried out. The query waits for the result in place of another one, which ends.
    Wait(Option<W>),
    /// Answer it without carrying it out.
    Answer(W, Answer),
}

struct Memory<W> {
    me: Name,
    own: Instance,
    runs: BTreeMap<Instance, Run<W>>,
    running: usize,
    /// The requests whose replies are kept, the oldest first.
    kept: VecDeque<RequestId>,
    kept_bytes: usize,
}

/// The requests of one run of a requester.
struct Run<W> {
    requests: BTreeMap<u32, Handling<W>>,
    /// The number of requests that are being carried out.
    running: usize,
    /// Requests up to this number, except for those above, are not carried out: they may have been.
    forgotten_to: Option<u32>,
    last_request: Instant,
    longest_timeout: Duration,
}

enum Handling<W> {
    /// It is being carried out. A repetition of it may wait for the result.
    Running(Option<W>),
    /// It was carried out. `None`: its reply is not kept, or there was none.
    Done(Option<Answer>),
}

impl Unrepeated {
    /// Returns the reason in an error reply; `None` if a service has made the reply.
    pub fn of(error: &Payload) -> Option<Self> {
        match error.encoding.as_str() {
            ANOTHER_RUN => Some(Self::AnotherRun),
            NOT_KEPT => Some(Self::NotKept),
            _ => None,
        }
    }

    fn error(self) -> Payload {
        let (encoding, text) = match self {
            Self::AnotherRun => (ANOTHER_RUN, "the request names another run of a program"),
            Self::NotKept => (NOT_KEPT, "the reply to this request is not kept"),
        };
        Payload::new(text, Encoding::new(encoding))
    }
}

impl<W> Once<W> {
    /// Creates the memory of a run of a program of the robot `me`.
    pub fn new(me: Name, own: Instance) -> Self {
        Self(Arc::new(Mutex::new(Memory {
            me,
            own,
            runs: BTreeMap::new(),
            running: 0,
            kept: VecDeque::new(),
            kept_bytes: 0,
        })))
    }

    /// Handles a request, whose query is `query`. `None`: it has no header.
    pub fn on_request(
        &self,
        now: Instant,
        header: Option<&RequestHeader>,
        query: W,
    ) -> Admission<W> {
        let stated = header.and_then(|header| Some((header, header.once_by?)));
        let Some((header, once_by)) = stated else {
            return Admission::Execute(query, None);
        };
        let mut memory = self.lock();
        let has_room = memory.running < MAX_RUNNING;
        let refusal = match memory.run_of(now, header, once_by) {
            Ok(run) => match run.requests.get_mut(&header.id.number) {
                Some(Handling::Running(waiting)) => return Admission::Wait(waiting.replace(query)),
                Some(Handling::Done(Some(answer))) => {
                    return Admission::Answer(query, answer.clone())
                }
                Some(Handling::Done(None)) => Unrepeated::NotKept.error(),
                None if Some(header.id.number) <= run.forgotten_to => Unrepeated::NotKept.error(),
                None if has_room => {
                    memory.on_start(header.id);
                    let (id, once) = (header.id, self.clone());
                    return Admission::Execute(query, Some(Execution { id, once }));
                }
                None => busy(),
            },
            Err(refusal) => refusal,
        };
        Admission::Answer(query, Answer::Error(error_to_payload(&memory.me, refusal)))
    }

    fn lock(&self) -> MutexGuard<'_, Memory<W>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Returns the error for which there is no room to remember a request.
fn busy() -> Payload {
    let text = "the program cannot remember further requests that are repeated: try again later, or without repetition";
    Payload::new(text, Encoding::TEXT)
}

impl<W> Memory<W> {
    /// Returns the requests of the run that has sent a request, or the error to reply.
    fn run_of(
        &mut self,
        now: Instant,
        header: &RequestHeader,
        once_by: Instance,
    ) -> Result<&mut Run<W>, Payload> {
        if once_by != self.own {
            return Err(Unrepeated::AnotherRun.error());
        }
        if !self.runs.contains_key(&header.id.run) {
            self.forget_silent(now);
            if self.runs.len() >= MAX_RUNS {
                return Err(busy());
            }
        }
        let run = self.runs.entry(header.id.run).or_insert_with(|| Run {
            requests: BTreeMap::new(),
            running: 0,
            forgotten_to: None,
            last_request: now,
            longest_timeout: Duration::ZERO,
        });
        let timeout = Duration::from_millis(header.timeout_ms.into());
        run.longest_timeout = run.longest_timeout.max(timeout.min(MAX_TIMEOUT));
        run.last_request = now;
        Ok(run)
    }

    fn forget_silent(&mut self, now: Instant) {
        self.runs.retain(|_, run| {
            run.running > 0 || now < run.last_request + run.longest_timeout + KEEP
        });
        let mut bytes = 0;
        self.kept.retain(|id| {
            let kept = self.runs.get(&id.run).and_then(|run| run.kept(id.number));
            bytes += kept.map_or(0, size);
            kept.is_some()
        });
        self.kept_bytes = bytes;
    }

    fn on_start(&mut self, id: RequestId) {
        if let Some(run) = self.runs.get_mut(&id.run) {
            run.requests.insert(id.number, Handling::Running(None));
            run.running += 1;
            self.running += 1;
        }
    }

    /// Handles the first result of a request. Returns the query that waits for it.
    fn on_result(&mut self, id: RequestId, answer: Option<Answer>) -> Option<W> {
        let run = self.runs.get_mut(&id.run)?;
        let handling = run.requests.get_mut(&id.number)?;
        let Handling::Running(waiting) = handling else {
            return None;
        };
        let waiting = waiting.take();
        let answer = answer.filter(|answer| size(answer) <= MAX_BYTES);
        if let Some(answer) = &answer {
            self.kept.push_back(id);
            self.kept_bytes += size(answer);
        }
        *handling = Handling::Done(answer);
        run.running -= 1;
        self.running -= 1;
        while self.kept_bytes > MAX_BYTES {
            let Some(oldest) = self.kept.front().copied() else {
                break;
            };
            self.drop_reply(oldest);
        }
        self.forget_oldest(id.run);
        waiting
    }

    /// Forgets the oldest request of a run if there are too many.
    fn forget_oldest(&mut self, run: Instance) {
        let Some(requests) = self.runs.get_mut(&run) else {
            return;
        };
        if requests.requests.len() - requests.running <= MAX_KEPT {
            return;
        }
        let mut handling = requests.requests.iter();
        let oldest = handling.find(|(_, handling)| matches!(handling, Handling::Done(_)));
        let Some((&number, _)) = oldest else { return };
        self.drop_reply(RequestId { run, number });
        if let Some(requests) = self.runs.get_mut(&run) {
            requests.requests.remove(&number);
            requests.forgotten_to = requests.forgotten_to.max(Some(number));
        }
    }

    fn drop_reply(&mut self, id: RequestId) {
        self.kept.retain(|kept| *kept != id);
        let run = self.runs.get_mut(&id.run);
        if let Some(Handling::Done(reply)) = run.and_then(|run| run.requests.get_mut(&id.number)) {
            self.kept_bytes -= reply.take().as_ref().map_or(0, size);
        }
    }
}

impl<W> Run<W> {
    fn kept(&self, number: u32) -> Option<&Answer> {
        match self.requests.get(&number)? {
            Handling::Done(answer) => answer.as_ref(),
            Handling::Running(_) => None,
        }
    }
}

/// Returns the memory that an answer needs.
fn size(answer: &Answer) -> usize {
    let of = |payload: &Payload| payload.bytes.len() + payload.encoding.as_str().len();
    match answer {
        Answer::Reply { key, payload } => key.len() + of(payload),
        Answer::Error(payload) => of(payload),
        Answer::None => 0,
    }
}

impl<W> Execution<W> {
    /// Handles the result. Returns the query that waits for it, too, and gets the same answer. Further results are ignored.
    pub fn on_result(&self, answer: &Answer) -> Option<W> {
        self.once.lock().on_result(self.id, Some(answer.clone()))
    }
}

impl<W> Drop for Execution<W> {
    fn drop(&mut self) {
        let waiting = self.once.lock().on_result(self.id, None);
        // Not while the memory is locked: the language may do anything when a query ends.
        drop(waiting);
    }
}

impl<W> Clone for Once<W> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<W> fmt::Debug for Once<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Once").finish_non_exhaustive()
    }
}

impl<W> fmt::Debug for Execution<W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Execution").field(&self.id).finish()
    }
}
