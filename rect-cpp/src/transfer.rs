//! Sends and receives transfers: files and payloads of any size.
use std::{
    ffi::{c_char, c_void},
    future::{Future, IntoFuture},
    mem::MaybeUninit,
    path::Path,
    pin::Pin,
    sync::Arc,
    time::Duration,
};

use rect::TransferSource;
use rect_core::{storage::Content, transfer::Progress as LibraryProgress};
use tokio::sync::Mutex;

use crate::{
    argument::{require, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    cancellable::{Cancellable, Waitable},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    robot::RobotHandle,
    text::Text,
};

/// The progress of an outgoing transfer.
#[repr(C)]
pub struct Progress {
    /// Number of bytes that the receiver has.
    pub received_bytes: u64,
    /// Size of the transfer in bytes.
    pub size_bytes: u64,
}

/// A callback for progress. It is called up to ten times per second, on the thread of the transfer.
pub type OnProgress = Option<extern "C" fn(progress: *const Progress, context: *mut c_void)>;

/// An outgoing transfer. `rect_drop(&transfer.id, ..)` ends it, whether or not it is complete.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Transfer {
    /// The handle.
    pub id: u64,
}

/// The content of a transfer, and its options. Fields that are 0 or NULL keep their defaults.
#[repr(C)]
pub struct TransferOptions {
    /// Path of the file to transfer, which must not change until the transfer is complete. NULL transfers `payload`.
    pub file: *const c_char,
    /// The payload to transfer if there is no file.
    pub payload: PayloadView,
    /// The file name at the receiver. Default: the name of the file; a payload has none.
    pub name: *const c_char,
    /// The encoding of the content. Default: that of `payload`, and `zenoh/bytes` for a file.
    pub encoding: *const c_char,
    /// How long the receiver may be unreachable, or its program take none of the transfers that have arrived, before the
    /// transfer fails, in milliseconds. Default: no limit.
    pub timeout_ms: u32,
}

/// The options for receiving transfers. Fields that are 0 or NULL keep their defaults.
#[repr(C)]
pub struct ReceiveOptions {
    /// The folder for received files, which no other receiver may use. Each sender has a subfolder. Files keep the names
    /// that their senders give, and replace files of the same name. Transfers into a folder resume after a restart. NULL
    /// keeps transfers in memory.
    pub folder: *const c_char,
    /// Maximum size of a transfer in bytes. Larger ones are refused. Required.
    pub max_bytes: u64,
    /// Maximum number of transfers at the same time, of which at most half (rounded up) have the same sender. Others wait.
    /// Default: 4.
    pub max_concurrent: usize,
    /// How long a transfer may make no progress before the receiver abandons it, in milliseconds. Default: 600000.
    pub timeout_ms: u32,
}

/// A receiver of transfers. `rect_drop(&transfers.id, ..)` ends it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Transfers {
    /// The handle.
    pub id: u64,
}

/// A transfer that was received completely and whose checksum is correct. It is valid until `rect_drop(&received.id, ..)`,
/// which does not delete a received file.
#[repr(C)]
pub struct Received {
    /// The handle.
    pub id: u64,
    /// The robot that sent the transfer.
    pub sender: Text,
    /// The topic.
    pub topic: Text,
    /// The file name that the sender gave the transfer; may be empty.
    pub name: Text,
    /// Path of the received file; empty if the transfer is in memory.
    pub file: Text,
    /// The encoding, and the bytes unless they are in a file.
    pub payload: PayloadView,
    /// Size of the transfer in bytes.
    pub size_bytes: u64,
}

struct ReceivedTransfer {
    received: rect::Received,
    file: Option<String>,
}

impl Object for ReceivedTransfer {
    const KIND: &'static str = "received transfer";
}

impl Waitable for rect::Transfers {
    const KIND: &'static str = "receiver of transfers";
}

fn into_c(received: rect::Received) -> Received {
    let file = match &received.content {
        Content::Bytes(_) => None,
        Content::File(path) => Some(path.to_string_lossy().into_owned()),
    };
    let owned = Arc::new(ReceivedTransfer { received, file });
    let offer = &owned.received.transfer;
    let bytes = match &owned.received.content {
        Content::Bytes(bytes) => bytes.as_ref(),
        Content::File(_) => &[],
    };
    let view = Received {
        id: 0,
        sender: Text::of(offer.sender.as_str()),
        topic: Text::of(offer.topic.as_str()),
        name: Text::of(&offer.name),
        file: Text::of_some(owned.file.as_deref()),
        payload: PayloadView {
            data: bytes.as_ptr().cast(),
            len: bytes.len(),
            encoding: Text::of(offer.encoding.as_str()),
        },
        size_bytes: offer.size_bytes,
    };
    let id = handle::insert_shared(owned);
    Received { id, ..view }
}

/// # Safety
/// The pointers of the options follow the rules of rect.h.
unsafe fn source(given: &TransferOptions) -> Result<TransferSource, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let file = unsafe { text_or_none("options.file", given.file) }?;
    Ok(match file {
        Some(file) => Path::new(file).into(),
        // SAFETY: guaranteed by this function's caller.
        None => unsafe { given.payload.read() }?.into(),
    })
}

type Outcome = Pin<Box<dyn Future<Output = Result<(), rect::Error>> + Send>>;

/// An outgoing transfer that a program may wait for.
struct OutgoingTransfer {
    /// The pending result; `None` once it has been returned.
    outcome: Mutex<Option<Outcome>>,
    progress: Arc<Callback>,
}

impl Waitable for OutgoingTransfer {
    const KIND: &'static str = "transfer";

    fn on_dropped(&self) {
        self.progress.close();
    }
}

impl OutgoingTransfer {
    /// Starts the transfer.
    fn of(transfer: rect::Transfer, on_progress: OnProgress, progress: Arc<Callback>) -> Self {
        let transfer = match on_progress {
            None => transfer,
            Some(function) => {
                let wrapper = progress.clone();
                transfer.on_progress(move |progress: LibraryProgress| {
                    let LibraryProgress {
                        received_bytes,
                        size_bytes,
                    } = progress;
                    let view = Progress {
                        received_bytes,
                        size_bytes,
                    };
                    wrapper.run(|context| function(&view, context));
                })
            }
        };
        Self {
            outcome: Mutex::new(Some(transfer.into_future())),
            progress,
        }
    }

    /// Waits for the result of the transfer.
    async fn result(&self) -> Result<(), Failure> {
        let mut outcome = self.outcome.lock().await;
        let result = outcome.as_mut().ok_or(Failure::End)?.await;
        *outcome = None;
        self.progress.close();
        Ok(result?)
    }
}

/// Starts to transfer a file or payload of any size to the robot `recipient`, and writes the handle to `transfer`.
///
/// The transfer runs until it is complete, fails, or is dropped. All other messages overtake it. It resumes after links were
/// interrupted and after either side was restarted.
///
/// ```c
/// rect_transfer_options options = {0};
/// options.file = "hall.pcd";
/// rect_robot_begin_transfer(robot, "wombat-2", "maps/hall", &options, NULL, NULL, NULL, &transfer, &error);
/// rect_transfer_wait(transfer, RECT_FOREVER, &error);
/// ```
///
/// `progress` may be NULL; otherwise it is called with `context` on the thread of the transfer. `release` is called once
/// with `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_NAME` or `RECT_CODE_TOPIC` if the recipient or the topic is invalid; `rect_transfer_wait` reports all
/// later errors. May be called on any thread. The callback may drop its own transfer, but must not wait for it.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_begin_transfer(
    robot: RobotHandle,
    recipient: *const c_char,
    topic: *const c_char,
    options: Option<&TransferOptions>,
    progress: OnProgress,
    context: *mut c_void,
    release: Release,
    transfer: Option<&mut MaybeUninit<Transfer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("transfer", &transfer)?;
        let options = require("options", options)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (recipient, topic, source, name, encoding) = unsafe {
            (
                text("recipient", recipient)?,
                text("topic", topic)?,
                source(options)?,
                text_or_none("options.name", options.name)?,
                text_or_none("options.encoding", options.encoding)?,
            )
        };
        let program = robot.resolve()?;
        let mut transfer_builder = program.robot.transfer(recipient, topic, source)?;
        if let Some(name) = name {
            transfer_builder = transfer_builder.name(name);
        }
        if let Some(encoding) = encoding {
            transfer_builder =
                transfer_builder.encoding(crate::payload::named(encoding.as_bytes())?);
        }
        if options.timeout_ms != 0 {
            transfer_builder =
                transfer_builder.timeout(Duration::from_millis(options.timeout_ms.into()));
        }
        let outgoing = OutgoingTransfer::of(transfer_builder, progress, wrapper);
        let id = handle::insert(Cancellable::new(outgoing, &program));
        write_out("transfer", transfer, Transfer { id })
    })
}

/// Waits until the transfer is complete and verified, or has failed.
///
/// Returns `RECT_CODE_TIMED_OUT` if it is still running after `timeout_ms` (`RECT_FOREVER` waits without a limit), or if
/// the timeout of its options has expired; `RECT_CODE_TRANSFER_REFUSED` or `RECT_CODE_TRANSFER_FAILED` if it failed;
/// `RECT_CODE_FILE` if its file cannot be read; `RECT_CODE_NAME` if its file name is invalid; `RECT_CODE_CLOSED` if the
/// session was closed or another thread dropped the transfer; and `RECT_CODE_END` if an earlier call has already returned
/// the result.
///
/// May be called on any thread except the one of the transfer's callback.
#[no_mangle]
pub extern "C" fn rect_transfer_wait(
    transfer: Transfer,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = handle::get::<Cancellable<OutgoingTransfer>>(transfer.id)?;
        waiting.next("result of the transfer", timeout_ms, |outgoing| async {
            Some(outgoing.result().await)
        })?
    })
}

/// # Safety
/// The pointers of the options follow the rules of rect.h.
unsafe fn read_receive_options(given: &ReceiveOptions) -> Result<rect::ReceiveOptions, Failure> {
    if given.max_bytes == 0 {
        let problem = "is 0; specify the maximum size of a transfer";
        return Err(Failure::argument("options.max_bytes", problem));
    }
    // SAFETY: guaranteed by this function's caller.
    let mut receive_options = match unsafe { text_or_none("options.folder", given.folder) }? {
        Some(folder) => rect::ReceiveOptions::in_folder(folder, given.max_bytes),
        None => rect::ReceiveOptions::in_memory(given.max_bytes),
    };
    if given.max_concurrent != 0 {
        receive_options = receive_options.max_concurrent(given.max_concurrent);
    }
    if given.timeout_ms != 0 {
        receive_options = receive_options.timeout(Duration::from_millis(given.timeout_ms.into()));
    }
    Ok(receive_options)
}

/// Receives the transfers that others send to this robot and that match a pattern, e.g. `*/maps/*`, until `transfers` is
/// dropped. Transfers whose topics match no receiver are refused.
///
/// Returns `RECT_CODE_TOPIC` or `RECT_CODE_NAME` if the pattern is invalid, `RECT_CODE_ARGUMENT` if `options` is NULL or its
/// `max_bytes` is 0, and `RECT_CODE_FILE` if the folder cannot be used. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_receive_transfers(
    robot: RobotHandle,
    pattern: *const c_char,
    options: Option<&ReceiveOptions>,
    transfers: Option<&mut MaybeUninit<Transfers>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("transfers", &transfers)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (pattern, receive_options) = unsafe {
            (
                text("pattern", pattern)?,
                read_receive_options(require("options", options)?)?,
            )
        };
        let program = robot.resolve()?;
        let incoming = program.wait(program.robot.receive_transfers(pattern, receive_options))?;
        let id = handle::insert(Cancellable::new(incoming, &program));
        write_out("transfers", transfers, Transfers { id })
    })
}

/// Waits for the next transfer to finish and writes it to `received`.
///
/// Returns `RECT_CODE_TRANSFER_FAILED` if an incoming transfer failed, after which there may be more; `RECT_CODE_TIMED_OUT`
/// if none finished within `timeout_ms` (`RECT_FOREVER` waits without a limit); and `RECT_CODE_CLOSED` if the session was
/// closed or another thread dropped the receiver.
///
/// May be called on any thread; if several threads wait, one of them receives the transfer.
#[no_mangle]
pub extern "C" fn rect_transfers_next(
    transfers: Transfers,
    timeout_ms: u32,
    received: Option<&mut MaybeUninit<Received>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("received", &received)?;
        let waiting = handle::get::<Cancellable<rect::Transfers>>(transfers.id)?;
        let next = waiting.next("transfer", timeout_ms, rect::Transfers::next)??;
        write_out("received", received, into_c(next))
    })
}
