//! Owns transfers: files and bytes of any size, to a robot and from others.
use std::{
    ffi::{c_char, c_void},
    future::IntoFuture,
    mem::MaybeUninit,
    path::Path,
    sync::Arc,
    time::Duration,
};

use rect::{core::transfer::Progress as Held, storage::Content, ReceiveTransfers, TransferSource};

use crate::{
    argument::{text, text_or_none, there},
    boundary::{call, give, wanted, ErrorOut},
    callback::Callback,
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    program::Program,
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
    /// How many at once; others wait. Default 4.
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

fn send(
    program: &Program,
    transfer: rect::Transfer,
    progress: OnProgress,
    callback: &Arc<Callback>,
) -> Result<(), Failure> {
    let transfer = match progress {
        None => transfer,
        Some(function) => {
            let called = callback.clone();
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
    let sent = program.wait(transfer.into_future());
    callback.close();
    sent
}

/// Transfers a file or bytes of any size to one robot, and waits until all is there and right. Everything else overtakes it.
/// Links may come and go meanwhile, and either side may be restarted: it goes on where it was. `progress`: NULL, or called
/// with `context` on the transfer's thread, until this returns.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_transfer(
    robot: Robot,
    to: *const c_char,
    topic: *const c_char,
    options: Option<&TransferOptions>,
    progress: OnProgress,
    context: *mut c_void,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, None));
    call(error, || {
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
        let mut transfer = program.robot.transfer(to, topic, source)?;
        if let Some(name) = name {
            transfer = transfer.named(name);
        }
        if let Some(encoding) = encoding {
            transfer = transfer.encoding(crate::payload::named(encoding)?);
        }
        if options.patience_ms != 0 {
            transfer = transfer.patience(Duration::from_millis(options.patience_ms.into()));
        }
        send(&program, transfer, progress, &called)
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
