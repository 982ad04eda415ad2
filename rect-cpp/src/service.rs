//! Owns serving: the requests that come to a service of this program, and their answers.
use std::{
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::{Arc, Mutex, PoisonError},
};

use rect::{Encoding, Name, Payload};

use crate::{
    argument::{text, there},
    boundary::{call, give, wanted, ErrorOut},
    callback::{Callback, Release},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
    program::Program,
    robot::Robot,
    text::Text,
};

/// A service, until `rect_drop(&service.id, ..)`; that waits for calls that are under way. It may be dropped in its own
/// callback, whose answer is not sent then.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Service {
    /// Its handle.
    pub id: u64,
}

/// A request, which is there until the callback returns. It is answered by `rect_request_reply` or `rect_request_refuse`
/// before that, on any thread; one that was not is refused.
#[repr(C)]
pub struct Request {
    /// Its handle.
    pub id: u64,
    /// Who asks; nothing: a stock program, which does not say.
    pub from: Text,
    /// What is asked.
    pub payload: PayloadView,
    /// How long an answer is of use still, in ms.
    pub remaining_ms: u32,
}

/// Called with a request, which is there until it returns.
pub type OnRequest = Option<extern "C" fn(request: *const Request, context: *mut c_void)>;

struct Serving {
    service: Mutex<Option<rect::Service>>,
    callback: Arc<Callback>,
}

impl Object for Serving {
    const KIND: &'static str = "service";

    fn on_dropped(&self) {
        let mut service = self.service.lock().unwrap_or_else(PoisonError::into_inner);
        drop(service.take());
        drop(service);
        self.callback.close();
    }
}

type Answer = Result<Payload, Payload>;

/// What the program has answered so far.
#[derive(Default)]
struct Answering(Mutex<Option<Answer>>);

impl Object for Answering {
    const KIND: &'static str = "request";
}

impl Answering {
    fn say(&self, answer: Answer) -> Result<(), Failure> {
        let mut said = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if said.is_some() {
            return Err(Failure::argument("request", "was answered already"));
        }
        *said = Some(answer);
        Ok(())
    }

    fn said(&self) -> Option<Answer> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).take()
    }
}

fn refusal(text: &'static str) -> Payload {
    Payload::new(text, Encoding::TEXT)
}

/// Shows the request to the program, and takes its answer.
fn answer(
    request: &rect::Request,
    callback: &Callback,
    function: extern "C" fn(*const Request, *mut c_void),
) -> Answer {
    let answering = Arc::new(Answering::default());
    let id = handle::insert_shared(answering.clone());
    let remaining = request.remaining().as_millis();
    let view = Request {
        id,
        from: Text::of_some(request.from.as_ref().map(Name::as_str)),
        payload: PayloadView::of(&request.payload),
        remaining_ms: u32::try_from(remaining).unwrap_or(u32::MAX),
    };
    let called = callback.run(|context| function(&view, context));
    // The program may have dropped it.
    let _ = handle::remove(id);
    if !called {
        return Err(refusal("the service ends"));
    }
    answering
        .said()
        .unwrap_or_else(|| Err(refusal("the service gave no answer")))
}

fn serve(
    program: &Program,
    topic: &str,
    function: extern "C" fn(*const Request, *mut c_void),
    callback: Arc<Callback>,
) -> Result<Service, Failure> {
    let called = callback.clone();
    let service = program.robot.serve(topic, move |request| {
        let callback = called.clone();
        async move {
            let work = move || answer(&request, &callback, function);
            let answered = tokio::task::spawn_blocking(work).await;
            answered.unwrap_or_else(|_| Err(refusal("the service has a fault")))
        }
    });
    let service = Mutex::new(Some(program.wait(service)?));
    let id = handle::insert(Serving { service, callback });
    Ok(Service { id })
}

/// Serves `topic` by a function: others ask for it with `rect_robot_request`. Up to 16 requests are worked on at a time, on
/// threads for such work, until the service is dropped. `release` is called with `context` once, when there will be no more
/// calls, even where this call fails.
///
/// Thread: any. The callback may be called on several threads at once; it may call any function of RECT, and drop its own
/// service.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_serve(
    robot: Robot,
    topic: *const c_char,
    callback: OnRequest,
    context: *mut c_void,
    release: Release,
    service: Option<&mut MaybeUninit<Service>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, release));
    call(error, || {
        wanted("service", &service)?;
        // SAFETY: as rect.h asks.
        let topic = unsafe { text("topic", topic) }?;
        let callback = there("callback", callback)?;
        let serving = serve(&*robot.live()?, topic, callback, called)?;
        give("service", service, serving)
    })
}

/// # Safety
/// The payload is as rect.h asks.
unsafe fn say(
    request: u64,
    payload: Option<&PayloadView>,
    as_answer: fn(Payload) -> Answer,
) -> Result<(), Failure> {
    // SAFETY: as this function asks.
    let payload = unsafe { there("payload", payload)?.read() }?;
    handle::get::<Answering>(request)?.say(as_answer(payload))
}

/// Answers; `request` is its `id`.
///
/// Thread: any, until the callback returns.
#[no_mangle]
pub unsafe extern "C" fn rect_request_reply(
    request: u64,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: as rect.h asks.
    call(error, || unsafe { say(request, payload, Ok) })
}

/// Answers with an error, which the asker gets as RECT_CODE_SERVICE; `request` is its `id`.
///
/// Thread: any, until the callback returns.
#[no_mangle]
pub unsafe extern "C" fn rect_request_refuse(
    request: u64,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: as rect.h asks.
    call(error, || unsafe { say(request, payload, Err) })
}
