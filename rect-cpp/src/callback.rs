//! Runs the callbacks of C programs. Guarantees that no callback runs after it was closed, and that its context is released
//! exactly once.
use std::{
    cell::RefCell,
    ffi::c_void,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Condvar, Mutex, MutexGuard, PoisonError,
    },
};

/// Called once with a callback's `context` when the callback will not be called any more, even if the function that the
/// callback was passed to fails. May be NULL.
pub type Release = Option<extern "C" fn(context: *mut c_void)>;

/// The context of a C callback, with the number of calls in progress.
pub struct Callback {
    context: Context,
    /// Number of calls in progress, plus [`CLOSED`] if the callback is closed.
    running: AtomicUsize,
    /// Locked while waiting for calls in progress, and by each call that ends after the callback was closed.
    is_released: Mutex<bool>,
    idle: Condvar,
}

/// The bit of `running` that marks a closed callback.
const CLOSED: usize = 1 << (usize::BITS - 1);

struct Context(*mut c_void, Release);

// SAFETY: rect.h states on which threads callbacks run; the program must make its context usable there.
unsafe impl Send for Context {}
// SAFETY: as for `Send`.
unsafe impl Sync for Context {}

/// The callbacks that the current thread is running, by address.
type ActiveCalls = RefCell<Vec<usize>>;

thread_local! {
    static ACTIVE_CALLS: ActiveCalls = const { RefCell::new(Vec::new()) };
}

impl Callback {
    /// Takes ownership of the context, which is released exactly once.
    pub fn new(context: *mut c_void, release: Release) -> Self {
        Self {
            context: Context(context, release),
            running: AtomicUsize::new(0),
            is_released: Mutex::new(false),
            idle: Condvar::new(),
        }
    }

    /// Runs the callback unless it is closed. Returns whether it was run.
    pub fn run(&self, call: impl FnOnce(*mut c_void)) -> bool {
        ACTIVE_CALLS.with(|active_calls| {
            let running = Running::begin(self, active_calls);
            let may_run = !running.was_closed;
            if may_run {
                call(self.context.0);
            }
            may_run
        })
    }

    /// Closes the callback. Waits for calls in progress on other threads, but not for a call from which this is called.
    pub fn close(&self) {
        let address = self.address();
        let calls_of_this_thread = ACTIVE_CALLS
            .with_borrow(|active_calls| active_calls.iter().filter(|&&at| at == address).count());
        self.running.fetch_or(CLOSED, Ordering::SeqCst);
        let mut is_released = self.is_released();
        while self.running.load(Ordering::SeqCst) & !CLOSED > calls_of_this_thread {
            let waited = self.idle.wait(is_released);
            is_released = waited.unwrap_or_else(PoisonError::into_inner);
        }
        self.release_if_finished(is_released);
    }

    fn release_if_finished(&self, mut is_released: MutexGuard<'_, bool>) {
        let is_finished = self.running.load(Ordering::SeqCst) == CLOSED;
        if !is_finished || std::mem::replace(&mut is_released, true) {
            return;
        }
        drop(is_released);
        if let Context(context, Some(release)) = self.context {
            release(context);
        }
    }

    fn address(&self) -> usize {
        std::ptr::from_ref(self).addr()
    }

    fn is_released(&self) -> MutexGuard<'_, bool> {
        self.is_released
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
    }
}

/// A call in progress. It ends when this is dropped, also during a panic.
struct Running<'a> {
    callback: &'a Callback,
    /// This thread's list. Looked up only once, because thread-local access in a shared library is a function call.
    active_calls: &'a ActiveCalls,
    was_closed: bool,
}

impl<'a> Running<'a> {
    fn begin(callback: &'a Callback, active_calls: &'a ActiveCalls) -> Self {
        let before = callback.running.fetch_add(1, Ordering::SeqCst);
        active_calls.borrow_mut().push(callback.address());
        Self {
            callback,
            active_calls,
            was_closed: before & CLOSED != 0,
        }
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.active_calls.borrow_mut().pop();
        let callback = self.callback;
        // No thread waits before the callback is closed, and a later `close` sees that this call has ended.
        if callback.running.fetch_sub(1, Ordering::SeqCst) & CLOSED != 0 {
            let is_released = callback.is_released();
            callback.idle.notify_all();
            callback.release_if_finished(is_released);
        }
    }
}

impl Drop for Callback {
    fn drop(&mut self) {
        self.close();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::{
        atomic::{AtomicUsize, Ordering},
        mpsc, Arc,
    };

    use super::*;

    extern "C" fn count(context: *mut c_void) {
        // SAFETY: each test passes a counter that outlives the callback.
        let counter = unsafe { &*context.cast::<AtomicUsize>() };
        counter.fetch_add(1, Ordering::SeqCst);
    }

    fn counted(released: &AtomicUsize) -> Callback {
        let context = std::ptr::from_ref(released).cast_mut().cast();
        Callback::new(context, Some(count))
    }

    #[test]
    fn context_is_released_exactly_once() {
        let released = AtomicUsize::new(0);
        drop(counted(&released));
        assert_eq!(released.load(Ordering::SeqCst), 1, "never called");
        let callback = counted(&released);
        assert!(callback.run(|_| callback.close()), "closed by its own call");
        assert_eq!(released.load(Ordering::SeqCst), 2);
        callback.close();
        assert!(!callback.run(|_| panic!("it was closed")));
        drop(callback);
        assert_eq!(released.load(Ordering::SeqCst), 2);
    }

    #[test]
    fn close_waits_for_a_call_in_progress() {
        let released = Arc::new(AtomicUsize::new(0));
        let callback = Arc::new(counted(&released));
        let (started_tx, started_rx) = mpsc::channel();
        let (go_tx, go_rx) = mpsc::channel::<()>();
        let running = std::thread::spawn({
            let callback = callback.clone();
            move || {
                callback.run(|_| {
                    started_tx.send(()).expect("the test receives this");
                    go_rx.recv().expect("the test sends this");
                })
            }
        });
        started_rx.recv().expect("the call has started");
        let closing = std::thread::spawn({
            let (callback, released) = (callback.clone(), released.clone());
            move || {
                callback.close();
                released.load(Ordering::SeqCst)
            }
        });
        assert_eq!(
            released.load(Ordering::SeqCst),
            0,
            "the call is still in progress"
        );
        go_tx.send(()).expect("the call is waiting");
        assert!(running.join().expect("no panic"));
        // The last of the two threads releases the context, possibly a moment after the other one has continued.
        closing.join().expect("no panic");
        drop(callback);
        assert_eq!(released.load(Ordering::SeqCst), 1);
    }
}
