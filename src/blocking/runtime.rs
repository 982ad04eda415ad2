//! Owns what blocking calls wait on.
use std::{
    future::Future,
    io,
    pin::pin,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
};

use tokio::runtime::{Builder, Runtime as Tokio};

/// One thread for the library's own tasks, and the waiting for them on any other.
#[derive(Debug)]
pub struct Runtime(Option<Tokio>);

impl Runtime {
    /// Starts it.
    ///
    /// # Errors
    /// The system has no thread for it.
    pub fn start() -> io::Result<Self> {
        let mut builder = Builder::new_multi_thread();
        let built = builder.worker_threads(1).thread_name("rect").enable_all();
        Ok(Self(Some(built.build()?)))
    }

    /// Waits for something, on the thread that calls.
    ///
    /// # Panics
    /// On a thread of an async runtime, which it would hold up.
    pub fn wait<T>(&self, what: impl Future<Output = T>) -> T {
        // Pinned here: tokio moves what it is given several times.
        self.tokio().block_on(pin!(what))
    }

    /// The same of what is mostly done at once, and needs no runtime before it has to wait, as [`crate::Robot::publish`]. Then
    /// the runtime is not entered, which would be a good part of the work.
    ///
    /// # Panics
    /// As [`wait`](Self::wait), where it has to wait.
    pub fn complete<T>(&self, what: impl Future<Output = T>) -> T {
        let mut what = pin!(what);
        match what.as_mut().poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(done) => done,
            Poll::Pending => self.wait(what),
        }
    }

    /// Calls `call` with what comes, on the thread that calls this, until nothing comes any more or it returns `false`.
    /// It may wait for things itself.
    pub fn for_each<T, N: Future<Output = Option<T>>>(
        &self,
        next: impl Fn() -> N,
        mut call: impl FnMut(T) -> bool,
    ) {
        // Beside the runtime, not in it: to come out of it for each call takes longer than the call of many a program.
        let _reachable = self.tokio().enter();
        let waker = Waker::from(Arc::new(Unpark(thread::current())));
        let mut context = Context::from_waker(&waker);
        while let Some(item) = parked(next(), &mut context) {
            if !call(item) {
                break;
            }
        }
    }

    fn tokio(&self) -> &Tokio {
        self.0.as_ref().expect("there until it is dropped")
    }
}

/// Sleeps until it is done. `context`: that wakes this thread.
fn parked<T>(what: impl Future<Output = T>, context: &mut Context<'_>) -> T {
    let mut what = pin!(what);
    loop {
        if let Poll::Ready(done) = what.as_mut().poll(context) {
            return done;
        }
        thread::park();
    }
}

struct Unpark(Thread);

impl Wake for Unpark {
    fn wake(self: Arc<Self>) {
        self.wake_by_ref();
    }

    fn wake_by_ref(self: &Arc<Self>) {
        self.0.unpark();
    }
}

impl Drop for Runtime {
    fn drop(&mut self) {
        // Not waited for: the last that needs it may be dropped on its own thread, by a callback.
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}
