//! Runs the asynchronous API for blocking calls.
use std::{
    future::Future,
    io,
    pin::pin,
    sync::Arc,
    task::{Context, Poll, Wake, Waker},
    thread::{self, Thread},
};

use tokio::runtime::{Builder, Runtime as Tokio};

/// An asynchronous runtime with one thread for the library's tasks, on which any other thread can wait.
#[derive(Debug)]
pub struct Runtime(Option<Tokio>);

impl Runtime {
    /// Starts the runtime.
    ///
    /// # Errors
    /// Returns the error of the operating system if the thread cannot be started.
    pub fn start() -> io::Result<Self> {
        let mut builder = Builder::new_multi_thread();
        let built = builder.worker_threads(1).thread_name("rect").enable_all();
        Ok(Self(Some(built.build()?)))
    }

    /// Blocks the calling thread until `future` is complete, and returns its output.
    ///
    /// # Panics
    /// Panics on a thread of an asynchronous runtime, which the call would block.
    pub fn wait<T>(&self, future: impl Future<Output = T>) -> T {
        // Pinned here, because tokio moves its argument several times.
        self.tokio().block_on(pin!(future))
    }

    /// Blocks the calling thread until `future` is complete, for futures that are usually ready at once and need no runtime
    /// until they have to wait, such as [`crate::Robot::publish`]. A ready future skips entering the runtime, which would be
    /// a considerable part of the work.
    ///
    /// # Panics
    /// Panics on a thread of an asynchronous runtime if the future is not ready at once.
    pub fn complete<T>(&self, future: impl Future<Output = T>) -> T {
        let mut future = pin!(future);
        match future
            .as_mut()
            .poll(&mut Context::from_waker(Waker::noop()))
        {
            Poll::Ready(done) => done,
            Poll::Pending => self.wait(future),
        }
    }

    /// Calls `call` on the calling thread with each item that `next` returns, until `next` returns `None` or `call`
    /// returns `false`. `call` may block.
    pub fn for_each<T, N: Future<Output = Option<T>>>(
        &self,
        next: impl Fn() -> N,
        mut call: impl FnMut(T) -> bool,
    ) {
        // The thread parks itself instead of using `block_on`: leaving the runtime for each call would take longer than
        // a short callback does.
        let _entered = self.tokio().enter();
        let waker = Waker::from(Arc::new(Unpark(thread::current())));
        let mut context = Context::from_waker(&waker);
        while let Some(item) = parked(next(), &mut context) {
            if !call(item) {
                break;
            }
        }
    }

    fn tokio(&self) -> &Tokio {
        self.0.as_ref().expect("present until dropped")
    }
}

/// Parks the thread until `future` is complete. The waker of `context` has to unpark this thread.
fn parked<T>(future: impl Future<Output = T>, context: &mut Context<'_>) -> T {
    let mut future = pin!(future);
    loop {
        if let Poll::Ready(done) = future.as_mut().poll(context) {
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
        // Does not wait for the runtime's thread: a callback on that thread may drop the last handle.
        if let Some(runtime) = self.0.take() {
            runtime.shutdown_background();
        }
    }
}
