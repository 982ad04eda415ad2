//! Owns the simulated air inside one process: the model behind a lock, and one task that wakes it when something is
//! due. It keeps tokio's time, so with tokio's clock paused everything happens in virtual time.
use std::{
    collections::HashMap,
    future::pending,
    sync::{Arc, Weak},
    time::Duration,
};

use parking_lot::Mutex;
use tokio::{
    sync::{mpsc, Notify},
    time::{sleep_until, Instant},
};

use super::{
    adapter::{address_of, AdapterStats},
    air::{AdapterId, Air, AirStatus, AttachError, NoSuchAdapter},
    attachment::{Attachment, Carrier},
    condition::Condition,
    message::{Command, Event, Violation},
    options::AirOptions,
    radio::SimRadio,
};
use crate::radio::RadioError;

/// A simulated air in this process. Clones are the same air; it ends with the last clone and the last radio.
///
/// ```no_run
/// # use zenoh_link_ble::radio::sim::{AirOptions, SimAir};
/// # async fn example() -> Result<(), Box<dyn std::error::Error>> {
/// let air = SimAir::new(AirOptions::default());
/// let a = air.radio("sim-a").await?;
/// let b = air.radio("sim-b").await?;
/// air.cut_between("sim-a", "sim-b");
/// # Ok(())
/// # }
/// ```
#[derive(Clone)]
pub struct SimAir {
    shared: Arc<Shared>,
}

struct Shared {
    start: Instant,
    inner: Mutex<Inner>,
    earlier: Arc<Notify>,
}

struct Inner {
    air: Air,
    /// When the driver wakes by itself.
    driver_wakes_at: Option<Duration>,
    outboxes: HashMap<AdapterId, mpsc::UnboundedSender<Event>>,
    radios: HashMap<String, Weak<Attachment>>,
}

/// An adapter brought on the air, with what the air tells it. It leaves the air when it is dropped.
pub(super) struct Attached {
    pub(super) events: mpsc::UnboundedReceiver<Event>,
    pub(super) place: Place,
}

/// An adapter's way of telling the air something.
pub(super) struct Place {
    id: AdapterId,
    shared: Arc<Shared>,
}

impl SimAir {
    /// An air with nobody on it. Must be called within a tokio runtime, which then drives it.
    /// Options that no link could have are brought to the nearest that one could; [`AirOptions::check`] tells.
    pub fn new(options: AirOptions) -> Self {
        let earlier = Arc::new(Notify::new());
        let shared = Arc::new(Shared {
            start: Instant::now(),
            inner: Mutex::new(Inner {
                air: Air::new(options),
                driver_wakes_at: None,
                outboxes: HashMap::new(),
                radios: HashMap::new(),
            }),
            earlier: Arc::clone(&earlier),
        });
        tokio::spawn(drive(Arc::downgrade(&shared), earlier));
        Self { shared }
    }

    /// The adapter of that name; brought on the air, powered on, unless this process has it there already.
    // Async although it waits for nothing: the radio of another process does, and tests swap them.
    #[allow(clippy::unused_async)]
    pub async fn radio(&self, name: &str) -> Result<Arc<SimRadio>, RadioError> {
        let known = {
            let inner = self.shared.inner.lock();
            inner.radios.get(name).and_then(Weak::upgrade)
        };
        if let Some(attachment) = known {
            return Ok(Arc::new(SimRadio { attachment }));
        }
        let Attached { mut events, place } =
            self.attach(name).map_err(|error| RadioError::NoAdapter {
                adapter: name.to_owned(),
                advice: error.to_string(),
            })?;
        let attachment = Arc::new(Attachment::new(name, address_of(name), Box::new(place)));
        let weak = Arc::downgrade(&attachment);
        self.shared
            .inner
            .lock()
            .radios
            .insert(name.to_owned(), Weak::clone(&weak));
        tokio::spawn(async move {
            while let Some(event) = events.recv().await {
                match weak.upgrade() {
                    Some(attachment) => attachment.on_event(event),
                    None => return,
                }
            }
        });
        Ok(Arc::new(SimRadio { attachment }))
    }

    /// Nobody hears anybody any more; links end when their supervision timeout passes.
    pub fn cut(&self) {
        self.shared.act(|air, now| air.cut(now));
    }

    /// The same, at the moment when so many more packets with data have arrived (0: now). Every packet of an SDU counts, and
    /// every command of L2CAP (asking for a channel, the answer, credits, the end); one that is repeated counts once.
    pub fn cut_after(&self, packets: u64) {
        self.shared.act(|air, now| air.cut_after(packets, now));
    }

    /// Everybody hears everybody again.
    pub fn restore(&self) {
        self.shared.act(|air, now| air.restore(now));
    }

    /// These two do not hear each other any more.
    pub fn cut_between(&self, a: &str, b: &str) {
        self.shared.act(|air, now| air.cut_between(a, b, now));
    }

    /// Switches an adapter on (also one that was removed) or off.
    pub fn power(&self, name: &str, on: bool) -> Result<(), NoSuchAdapter> {
        self.shared.act(|air, now| air.power(name, on, now))
    }

    /// Pulls an adapter out.
    pub fn remove(&self, name: &str) -> Result<(), NoSuchAdapter> {
        self.shared.act(|air, now| air.remove(name, now))
    }

    /// Changes how good the air is.
    pub fn set_condition(&self, condition: Condition) {
        self.shared
            .act(|air, now| air.set_condition(condition, now));
    }

    /// What an adapter has sent so far; `None` when it is not on the air.
    pub fn stats(&self, name: &str) -> Option<AdapterStats> {
        self.shared.act(|air, now| {
            air.poll(now);
            air.stats(name)
        })
    }

    /// Who is on the air and who is linked with whom.
    pub fn status(&self) -> AirStatus {
        self.shared.act(|air, now| {
            air.poll(now);
            air.status()
        })
    }

    /// How long the air has been there, by tokio's clock.
    pub fn elapsed(&self) -> Duration {
        self.shared.start.elapsed()
    }

    pub(super) fn attach(&self, name: &str) -> Result<Attached, AttachError> {
        let (outbox, events) = mpsc::unbounded_channel();
        let now = self.elapsed();
        let mut inner = self.shared.inner.lock();
        let id = inner.air.attach(name, now)?;
        inner.outboxes.insert(id, outbox);
        inner.dispatch();
        Ok(Attached {
            events,
            place: Place {
                id,
                shared: Arc::clone(&self.shared),
            },
        })
    }
}

impl Place {
    /// Tells the air something; a violation when no correct adapter would.
    pub(super) fn try_command(&self, command: Command) -> Result<(), Violation> {
        self.shared
            .act(|air, now| air.command(self.id, command, now))
    }
}

impl Carrier for Place {
    fn command(&self, command: Command) {
        if let Err(violation) = self.try_command(command) {
            tracing::error!("the simulated air refused its own radio: {violation}");
        }
    }

    fn absence(&self, adapter: &str) -> RadioError {
        RadioError::NoAdapter {
            adapter: adapter.to_owned(),
            advice: "it was removed from the simulated air; `power` it on there".to_owned(),
        }
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.shared.act(|air, now| air.detach(self.id, now));
        self.shared.inner.lock().outboxes.remove(&self.id);
    }
}

impl Shared {
    /// Does something to the model at this moment, and passes on what came of it.
    fn act<T>(&self, deed: impl FnOnce(&mut Air, Duration) -> T) -> T {
        let mut inner = self.inner.lock();
        // Read under the lock, so that the model's time never goes back.
        let now = self.start.elapsed();
        let result = deed(&mut inner.air, now);
        inner.dispatch();
        let next = inner.air.next_wakeup();
        let sleeps_until = inner.driver_wakes_at;
        drop(inner);
        if next.is_some_and(|next| sleeps_until.is_none_or(|until| next < until)) {
            self.earlier.notify_one();
        }
        result
    }

    /// Does what is due, and tells when the driver is to do so again.
    fn drive(&self) -> Option<Instant> {
        let mut inner = self.inner.lock();
        inner.air.poll(self.start.elapsed());
        inner.dispatch();
        inner.driver_wakes_at = inner.air.next_wakeup();
        inner.driver_wakes_at.map(|at| self.start + at)
    }
}

impl Inner {
    fn dispatch(&mut self) {
        for happened in self.air.drain() {
            if let Some(outbox) = self.outboxes.get(&happened.adapter) {
                let _ = outbox.send(happened.event);
            }
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // The driver finds nobody and ends.
        self.earlier.notify_one();
    }
}

async fn drive(shared: Weak<Shared>, earlier: Arc<Notify>) {
    while let Some(next) = shared.upgrade().map(|shared| shared.drive()) {
        let due = async {
            match next {
                Some(next) => sleep_until(next).await,
                None => pending().await,
            }
        };
        tokio::select! {
            () = due => {}
            () = earlier.notified() => {}
        }
    }
}
