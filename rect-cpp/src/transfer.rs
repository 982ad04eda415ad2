//! Owns transfers: files and bytes of any size, to a robot and from others.
use std::{
    ffi::{c_char, c_void},
    future::{Future, IntoFuture},
    mem::MaybeUninit,
    path::Path,
    pin::Pin,
    sync::Arc,
    time::Duration,
};

use rect::{core::transfer::Progress as Held, storage::Content, ReceiveTransfers, TransferSource};
use tokio::sync::Mutex;

use crate::{
    argument::{text, text_or_none, there},
    boundary::{call, give, wanted, ErrorOut},
    callback::{Callback, Release},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    robot::Robot,
    text::Text,
    waiting::{Awaited, Waiting},
};

/// How much of a transfer the receiver holds.
#[repr(C)]
pub struct Progress {
    /// What it holds.
    pub held_bytes: u64,
    /// Of how many.
    pub size_bytes: u64,
}

/// Called with how much is there, up to ten times a second, on the transfer's thread.
pub type OnProgress = Option<extern "C" fn(progress: *const Progress, context: *mut c_void)>;

/// A transfer that this program sends. `rect_drop(&transfer.id, ..)` ends it, all there or not.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Transfer {
    /// Its handle.
    pub id: u64,
}

/// What is transferred, and how. What is 0 or NULL is left at its default.
#[repr(C)]
pub struct TransferOptions {
    /// A file, by its path. It must not change before all is there. NULL: `payload` is transferred.
    pub file: *const c_char,
    /// Bytes, where there is no file.
    pub payload: PayloadView,
    /// What it is called there; default: the file's name, and bytes have none.
    pub name: *const c_char,
    /// What a file is; default `zenoh/bytes`.
    pub encoding: *const c_char,
    /// How long nothing may be heard of the receiver, in ms; default: it may come back whenever it likes.
    pub patience_ms: u32,
}

/// How transfers are taken. What is 0 or NULL is left at its default.
#[repr(C)]
pub struct ReceiveOptions {
    /// Into a folder for each sender in this one, under the name that the sender gives; NULL: into memory. What came into
    /// files goes on after a restart.
    pub folder: *const c_char,
    /// The largest that is taken, in bytes. It has to be given.
    pub max_bytes: u64,
    /// How many at once, half of them of one sender at most; others wait. Default 4.
    pub at_once: usize,
    /// How long nothing may come before one is given up, in ms; default 600000.
    pub patience_ms: u32,
}

/// The transfers that come. `rect_drop(&transfers.id, ..)` when no more are wanted.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Transfers {
    /// Its handle.
    pub id: u64,
}

/// A transfer that came, with the right checksum. It is there until `rect_drop(&received.id, ..)`; a file stays.
#[repr(C)]
pub struct Received {
    /// Its handle.
    pub id: u64,
    /// Of whom.
    pub from: Text,
    /// About what.
    pub topic: Text,
    /// What its sender calls it; may be empty.
    pub name: Text,
    /// The file that it is in; nothing, where it is in memory.
    pub file: Text,
    /// What it is, and its bytes, unless they are in a file.
    pub payload: PayloadView,
    /// How long it is.
    pub size_bytes: u64,
}

struct Came {
    received: rect::Received,
    file: Option<String>,
}

impl Object for Came {
    const KIND: &'static str = "received transfer";
}

impl Awaited for rect::Transfers {
    const KIND: &'static str = "taker of transfers";
}

fn hold(received: rect::Received) -> Received {
    let file = match &received.content {
        Content::Bytes(_) => None,
        Content::File(path) => Some(path.to_string_lossy().into_owned()),
    };
    let held = Arc::new(Came { received, file });
    let about = &held.received.about;
    let bytes = match &held.received.content {
        Content::Bytes(bytes) => bytes.as_ref(),
        Content::File(_) => &[],
    };
    let view = Received {
        id: 0,
        from: Text::of(about.from.as_str()),
        topic: Text::of(about.topic.as_str()),
        name: Text::of(&about.name),
        file: Text::of_some(held.file.as_deref()),
        payload: PayloadView {
            data: bytes.as_ptr().cast(),
            len: bytes.len(),
            encoding: Text::of(about.encoding.as_str()),
        },
        size_bytes: about.size_bytes,
    };
    let id = handle::insert_shared(held);
    Received { id, ..view }
}

/// # Safety
/// The options are as rect.h asks.
unsafe fn source(given: &TransferOptions) -> Result<TransferSource, Failure> {
    // SAFETY: as this function asks.
    let file = unsafe { text_or_none("options.file", given.file) }?;
    Ok(match file {
        Some(file) => Path::new(file).into(),
        // SAFETY: as this function asks.
        None => unsafe { given.payload.read() }?.into(),
    })
}

type Ending = Pin<Box<dyn Future<Output = Result<(), rect::Error>> + Send>>;

/// A transfer under way.
struct Sending {
    /// Nothing once its end was told.
    ending: Mutex<Option<Ending>>,
    progress: Arc<Callback>,
}

impl Awaited for Sending {
    const KIND: &'static str = "transfer";

    fn on_dropped(&self) {
        self.progress.close();
    }
}

impl Sending {
    /// Begins.
    fn of(transfer: rect::Transfer, on_progress: OnProgress, progress: Arc<Callback>) -> Self {
        let transfer = match on_progress {
            None => transfer,
            Some(function) => {
                let called = progress.clone();
                transfer.on_progress(move |progress: Held| {
                    let Held {
                        held_bytes,
                        size_bytes,
                    } = progress;
                    let view = Progress {
                        held_bytes,
                        size_bytes,
                    };
                    called.run(|context| function(&view, context));
                })
            }
        };
        Self {
            ending: Mutex::new(Some(transfer.into_future())),
            progress,
        }
    }

    /// How it ended, once it has.
    async fn end(&self) -> Result<(), Failure> {
        let mut ending = self.ending.lock().await;
        let how = ending.as_mut().ok_or(Failure::End)?.await;
        *ending = None;
        self.progress.close();
        Ok(how?)
    }
}

/// Begins to transfer a file or bytes of any size to one robot, until it ends or is dropped. Everything else overtakes it.
/// Links may come and go meanwhile, and either side may be restarted: it goes on where it was. `progress`: NULL, or called
/// with `context` on the transfer's thread. `release` is called with `context` once, when there will be no more calls, even
/// where this call fails.
///
/// Thread: any. The callback may drop its own transfer, and must not wait for it.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_begin_transfer(
    robot: Robot,
    to: *const c_char,
    topic: *const c_char,
    options: Option<&TransferOptions>,
    progress: OnProgress,
    context: *mut c_void,
    release: Release,
    transfer: Option<&mut MaybeUninit<Transfer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, release));
    call(error, || {
        wanted("transfer", &transfer)?;
        let options = there("options", options)?;
        // SAFETY: as rect.h asks.
        let (to, topic, source, name, encoding) = unsafe {
            (
                text("to", to)?,
                text("topic", topic)?,
                source(options)?,
                text_or_none("options.name", options.name)?,
                text_or_none("options.encoding", options.encoding)?,
            )
        };
        let program = robot.live()?;
        let mut begun = program.robot.transfer(to, topic, source)?;
        if let Some(name) = name {
            begun = begun.named(name);
        }
        if let Some(encoding) = encoding {
            begun = begun.encoding(crate::payload::named(encoding.as_bytes())?);
        }
        if options.patience_ms != 0 {
            begun = begun.patience(Duration::from_millis(options.patience_ms.into()));
        }
        let sending = Sending::of(begun, progress, called);
        let id = handle::insert(Waiting::new(sending, &program));
        give("transfer", transfer, Transfer { id })
    })
}

/// Waits until all is there and right, or can't be. RECT_CODE_TIMED_OUT: it goes on after `timeout_ms` (RECT_FOREVER: it waits
/// as long as it takes); RECT_CODE_CLOSED: the session was closed, or another thread dropped it; RECT_CODE_END: its end was
/// told before.
///
/// Thread: any but the transfer's own, on which its callback runs.
#[no_mangle]
pub extern "C" fn rect_transfer_wait(
    transfer: Transfer,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = handle::get::<Waiting<Sending>>(transfer.id)?;
        waiting.next("end of the transfer", timeout_ms, |sending| async {
            Some(sending.end().await)
        })?
    })
}

/// # Safety
/// The options are as rect.h asks.
unsafe fn taking(given: &ReceiveOptions) -> Result<ReceiveTransfers, Failure> {
    if given.max_bytes == 0 {
        let wrong = "is 0: how large may a transfer be?";
        return Err(Failure::argument("options.max_bytes", wrong));
    }
    // SAFETY: as this function asks.
    let mut taking = match unsafe { text_or_none("options.folder", given.folder) }? {
        Some(folder) => ReceiveTransfers::in_folder(folder, given.max_bytes),
        None => ReceiveTransfers::in_memory(given.max_bytes),
    };
    if given.at_once != 0 {
        taking = taking.at_once(given.at_once);
    }
    if given.patience_ms != 0 {
        taking = taking.patience(Duration::from_millis(given.patience_ms.into()));
    }
    Ok(taking)
}

/// Takes the transfers of a pattern, as `*/maps/*`, that others send to this robot, until it is dropped. Without it none is
/// taken.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_receive_transfers(
    robot: Robot,
    pattern: *const c_char,
    options: Option<&ReceiveOptions>,
    transfers: Option<&mut MaybeUninit<Transfers>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("transfers", &transfers)?;
        // SAFETY: as rect.h asks.
        let (pattern, taking) = unsafe {
            (
                text("pattern", pattern)?,
                taking(there("options", options)?)?,
            )
        };
        let program = robot.live()?;
        let taken = program.wait(program.robot.receive_transfers(pattern, taking))?;
        let id = handle::insert(Waiting::new(taken, &program));
        give("transfers", transfers, Transfers { id })
    })
}

/// The next transfer that ended: all of it, or RECT_CODE_TRANSFER_FAILED, and there may be more. RECT_CODE_TIMED_OUT: none did
/// within `timeout_ms` (RECT_FOREVER: it waits as long as it takes); RECT_CODE_CLOSED: the session was closed, or another
/// thread dropped it.
///
/// Thread: any; of several that wait, one gets it.
#[no_mangle]
pub extern "C" fn rect_transfers_next(
    transfers: Transfers,
    timeout_ms: u32,
    received: Option<&mut MaybeUninit<Received>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("received", &received)?;
        let waiting = handle::get::<Waiting<rect::Transfers>>(transfers.id)?;
        let next = waiting.next("transfer", timeout_ms, rect::Transfers::next)??;
        give("received", received, hold(next))
    })
}
