//! Serves requests with the callbacks of C programs.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::{Arc, Mutex},
};

use rect::{Encoding, Name, Payload};

use crate::{
    argument::{require, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    failure::{Code, Failure},
    handle::{self, lock, Object},
    payload::PayloadView,
    program::Program,
    robot::RobotHandle,
    text::Text,
};

/// A service of this program. `rect_drop(&service.id, ..)` ends it and waits for calls in progress. A callback may drop its
/// own service; its reply is not sent then.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Service {
    /// The handle.
    pub id: u64,
}

/// The description of a service, and whether it may have company.
#[repr(C)]
pub struct ServiceOptions {
    /// The purpose of the service, for `rect service list` and the dashboard: at most 200 characters. NULL: nothing.
    pub about: *const c_char,
    /// Whether other programs of the robot may serve the same topic, which then have to allow it, too. Each of them answers every
    /// request.
    pub allow_several: bool,
}

/// A request, which is valid until the callback returns. Before that, the program replies with `rect_request_reply` or
/// `rect_request_refuse`, on any thread. A request without a reply is refused.
#[repr(C)]
pub struct Request {
    /// The handle, for replying.
    pub id: u64,
    /// The robot that sent the request, according to the request itself; empty if the sender is a stock Zenoh program. The
    /// name is not verified: do not base permissions on it.
    pub sender: Text,
    /// The payload.
    pub payload: PayloadView,
    /// Time until the sender stops waiting for the reply, in milliseconds.
    pub remaining_ms: u32,
}

/// A callback for requests. The request is valid until the callback returns.
pub type OnRequest = Option<extern "C" fn(request: *const Request, context: *mut c_void)>;

struct RunningService {
    service: Mutex<Option<rect::Service>>,
    callback: Arc<Callback>,
}

impl Object for RunningService {
    const KIND: &'static str = "service";

    fn on_dropped(&self) {
        let mut service = lock(&self.service);
        drop(service.take());
        drop(service);
        self.callback.close();
    }
}

type ReplyResult = Result<Payload, Payload>;

/// A request that the callback handles, with the program's last reply if there is one yet. It is sent when the next one follows, or the
/// callback returns.
struct PendingRequest {
    request: Arc<rect::Request>,
    last: Mutex<Option<ReplyResult>>,
}

impl Object for PendingRequest {
    const KIND: &'static str = "request";
}

impl PendingRequest {
    fn set(&self, reply: ReplyResult) -> Result<(), Failure> {
        let mut last = lock(&self.last);
        match last.replace(reply) {
            None => Ok(()),
            Some(Ok(earlier)) => Ok(self.request.reply(earlier)?),
            refusal => {
                *last = refusal;
                Err(Failure::argument("request", "was refused already"))
            }
        }
    }

    fn take(&self) -> Option<ReplyResult> {
        lock(&self.last).take()
    }
}

fn refusal(text: &'static str) -> Payload {
    Payload::new(text, Encoding::TEXT)
}

/// Passes the request to the program's callback and returns its reply.
fn run_callback(
    request: &Arc<rect::Request>,
    callback: &Callback,
    function: extern "C" fn(*const Request, *mut c_void),
) -> ReplyResult {
    let pending = Arc::new(PendingRequest {
        request: request.clone(),
        last: Mutex::default(),
    });
    let called = callback.run(|context| {
        // Removed before the call ends, so that no handle is left when the service has been dropped.
        let id = handle::insert_shared(pending.clone());
        let remaining = request.remaining().as_millis();
        let view = Request {
            id,
            sender: Text::of_some(request.sender.as_ref().map(Name::as_str)),
            payload: PayloadView::of(&request.payload),
            remaining_ms: u32::try_from(remaining).unwrap_or(u32::MAX),
        };
        function(&view, context);
        // Fails if the program has already dropped the request.
        let _ = handle::remove(id);
    });
    if !called {
        return Err(refusal("the service is shutting down"));
    }
    pending
        .take()
        .unwrap_or_else(|| Err(refusal("the service gave no reply")))
}

fn serve(
    program: &Program,
    topic: &str,
    options: rect::ServiceOptions,
    function: extern "C" fn(*const Request, *mut c_void),
    callback: Arc<Callback>,
) -> Result<Service, Failure> {
    let wrapper = callback.clone();
    let service = program.robot.serve_with(topic, options, move |request| {
        let callback = wrapper.clone();
        async move {
            let work = move || run_callback(&request, &callback, function);
            let reply = tokio::task::spawn_blocking(work).await;
            reply.unwrap_or_else(|_| Err(refusal("the service failed with an internal error")))
        }
    });
    let service = Mutex::new(Some(program.wait(service)?));
    let id = handle::insert(RunningService { service, callback });
    Ok(Service { id })
}

/// Serves requests to `topic` with a callback; other robots send them with `rect_robot_request`. Up to 16 requests are
/// handled at a time, on threads of the service, until the service is dropped.
///
/// ```c
/// static void on_battery(const rect_request *request, void *context) {
///     const rect_payload volt = rect_payload_json("7.2");
///     rect_request_reply(request->id, &volt, NULL);
/// }
///
/// rect_robot_serve(robot, "battery", NULL, on_battery, NULL, NULL, &service, &error);
/// ```
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// `options` may be NULL: the defaults.
///
/// Returns `RECT_CODE_TOPIC` if the topic is invalid, and `RECT_CODE_SERVICE_REFUSED` if a program of this robot serves it already.
/// May be called on any thread. The callback may be called on several
/// threads at once; it may call any function of RECT and may drop its own service.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_serve(
    robot: RobotHandle,
    topic: *const c_char,
    options: Option<&ServiceOptions>,
    callback: OnRequest,
    context: *mut c_void,
    release: Release,
    service: Option<&mut MaybeUninit<Service>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("service", &service)?;
        // SAFETY: the caller follows the rules of rect.h.
        let topic = unsafe { text("topic", topic) }?;
        let mut described = rect::ServiceOptions::default();
        if let Some(options) = options {
            // SAFETY: the caller follows the rules of rect.h.
            let about = unsafe { text_or_none("options.about", options.about) }?;
            described.about = about.unwrap_or_default().to_owned();
            described.allow_several = options.allow_several;
        }
        let callback = require("callback", callback)?;
        let running = serve(&*robot.resolve()?, topic, described, callback, wrapper)?;
        write_out("service", service, running)
    })
}

/// # Safety
/// The payload follows the rules of rect.h.
unsafe fn finish(
    request: u64,
    payload: Option<&PayloadView>,
    as_result: fn(Payload) -> ReplyResult,
) -> Result<(), Failure> {
    // SAFETY: guaranteed by this function's caller.
    let payload = unsafe { require("payload", payload)?.read() }?;
    handle::get::<PendingRequest>(request)?.set(as_result(payload))
}

/// Replies to a request. `request` is its `id`. A service may reply several times; `rect_robot_request` receives the first reply, and
/// `rect_robot_request_stream` all of them. The last one is sent when the callback returns.
///
/// Returns `RECT_CODE_ARGUMENT` if the request was refused, and `RECT_CODE_HANDLE` after the callback has returned. May be
/// called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_request_reply(
    request: u64,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    call(error, || unsafe { finish(request, payload, Ok) })
}

/// Replies to a request with an error. The sender's call returns `RECT_CODE_SERVICE` with this payload as the text.
/// `request` is the request's `id`.
///
/// Returns `RECT_CODE_ARGUMENT` if it was refused already, and `RECT_CODE_HANDLE` after the callback has returned. May be
/// called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_request_refuse(
    request: u64,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    call(error, || unsafe { finish(request, payload, Err) })
}

/// Returns whether the requester still waits for a reply, so that a callback can stop when nobody does. `request` is the request's `id`.
///
/// It does not wait after its deadline, or if it has closed the request, or if its program or robot has ended. Except for the deadline,
/// this is known within 0.5 s. The end of a program is known if the program has a name, and that of a stock Zenoh program never. The first
/// call begins to observe the requester, which sends nothing on the air. Returns false after the callback has returned. May be called on
/// any thread.
#[no_mangle]
pub extern "C" fn rect_request_is_wanted(request: u64) -> bool {
    let mut is_wanted = false;
    let code = call(None, || {
        is_wanted = handle::get::<PendingRequest>(request)?.request.is_wanted();
        Ok(())
    });
    matches!(code, Code::Ok) && is_wanted
}
