//! Owns C's callbacks: what they are called with, that none runs once it has been dropped, and that what they need is
//! released exactly once.
use std::{
    cell::RefCell,
    ffi::c_void,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Condvar, Mutex, MutexGuard, PoisonError,
    },
};

/// Called once when a callback will not be called any more, with its `context`; may be NULL. That is so even where the call
/// that it was given to fails.
pub type Release = Option<extern "C" fn(context: *mut c_void)>;

/// What a callback needs, and how often it runs now.
pub struct Callback {
    context: Context,
    /// How often it runs, and whether it is [`CLOSED`].
    running: AtomicUsize,
    /// Held by whoever waits for those that run, or ends as one of them once it is closed.
    is_released: Mutex<bool>,
    idle: Condvar,
}

/// It is called no more.
const CLOSED: usize = 1 << (usize::BITS - 1);

struct Context(*mut c_void, Release);

// SAFETY: rect.h says on which threads callbacks run, and that what they need has to bear that.
unsafe impl Send for Context {}
// SAFETY: as above.
unsafe impl Sync for Context {}

/// The callbacks that a thread is in, by address.
type Inside = RefCell<Vec<usize>>;

thread_local! {
    static INSIDE: Inside = const { RefCell::new(Vec::new()) };
}

impl Callback {
    /// Takes over the context, which is released in any case.
    pub fn new(context: *mut c_void, release: Release) -> Self {
        Self {
            context: Context(context, release),
            running: AtomicUsize::new(0),
            is_released: Mutex::new(false),
            idle: Condvar::new(),
        }
    }

    /// Calls it, unless it was closed; whether it was called.
    pub fn run(&self, call: impl FnOnce(*mut c_void)) -> bool {
        INSIDE.with(|inside| {
            let running = Running::begin(self, inside);
            let may_run = !running.was_closed;
            if may_run {
                call(self.context.0);
            }
            may_run
        })
    }

    /// It is not called any more. Waits for those that run, but for the one from which this is called.
    pub fn close(&self) {
        let here = self.address();
        let own = INSIDE.with_borrow(|inside| inside.iter().filter(|&&at| at == here).count());
        self.running.fetch_or(CLOSED, Ordering::SeqCst);
        let mut is_released = self.is_released();
        while self.running.load(Ordering::SeqCst) & !CLOSED > own {
            let waited = self.idle.wait(is_released);
            is_released = waited.unwrap_or_else(PoisonError::into_inner);
        }
        self.release_if_over(is_released);
    }

    fn release_if_over(&self, mut is_released: MutexGuard<'_, bool>) {
        let is_over = self.running.load(Ordering::SeqCst) == CLOSED;
        if !is_over || std::mem::replace(&mut is_released, true) {
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

/// A call under way; over when it is dropped, however that comes.
struct Running<'a> {
    callback: &'a Callback,
    /// This thread's; looked for once, which in a shared library is a call.
    inside: &'a Inside,
    was_closed: bool,
}

impl<'a> Running<'a> {
    fn begin(callback: &'a Callback, inside: &'a Inside) -> Self {
        let before = callback.running.fetch_add(1, Ordering::SeqCst);
        inside.borrow_mut().push(callback.address());
        Self {
            callback,
            inside,
            was_closed: before & CLOSED != 0,
        }
    }
}

impl Drop for Running<'_> {
    fn drop(&mut self) {
        self.inside.borrow_mut().pop();
        let callback = self.callback;
        // Nobody waits before it is closed. Whoever closes it later finds that this runs no more.
        if callback.running.fetch_sub(1, Ordering::SeqCst) & CLOSED != 0 {
            let is_released = callback.is_released();
            callback.idle.notify_all();
            callback.release_if_over(is_released);
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
        // SAFETY: each test gives a counter that outlives the callback.
        let counter = unsafe { &*context.cast::<AtomicUsize>() };
        counter.fetch_add(1, Ordering::SeqCst);
    }

    fn counted(released: &AtomicUsize) -> Callback {
        let context = std::ptr::from_ref(released).cast_mut().cast();
        Callback::new(context, Some(count))
    }

    #[test]
    fn it_is_released_once_whoever_closes_it() {
        let released = AtomicUsize::new(0);
        drop(counted(&released));
        assert_eq!(released.load(Ordering::SeqCst), 1, "never called");
        let callback = counted(&released);
        assert!(callback.run(|_| callback.close()), "from inside");
        assert_eq!(released.load(Ordering::SeqCst), 2);
        callback.close();
        assert!(!callback.run(|_| panic!("it was closed")));
        drop(callback);
        assert_eq!(released.load(Ordering::SeqCst), 2);
    }

    #[test]
    fn who_closes_it_waits_for_the_one_that_runs() {
        let released = Arc::new(AtomicUsize::new(0));
        let callback = Arc::new(counted(&released));
        let (began, begins) = mpsc::channel();
        let (go, goes) = mpsc::channel::<()>();
        let running = std::thread::spawn({
            let callback = callback.clone();
            move || {
                callback.run(|_| {
                    began.send(()).expect("waited for");
                    goes.recv().expect("let go");
                })
            }
        });
        begins.recv().expect("began");
        let closing = std::thread::spawn({
            let (callback, released) = (callback.clone(), released.clone());
            move || {
                callback.close();
                released.load(Ordering::SeqCst)
            }
        });
        assert_eq!(released.load(Ordering::SeqCst), 0, "it runs still");
        go.send(()).expect("waits");
        assert!(running.join().expect("no panic"));
        // Whichever of the two threads is last releases it, maybe a moment after the other went on.
        closing.join().expect("no panic");
        drop(callback);
        assert_eq!(released.load(Ordering::SeqCst), 1);
    }
}
