//! Runs the simulated air within one process: the model behind a lock, and one task that drives its timers. It uses
//! tokio's clock; if that clock is paused, everything happens in virtual time.
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
use zenoh_link_ble_radio::{interval::ConnectionInterval, RadioError};

use super::{
    adapter::{address_of, AdapterStats},
    air::{Air, AirStatus, AttachError, NoSuchAdapter},
    attachment::{AirConnection, Attachment},
    condition::Condition,
    id::AdapterId,
    message::{Command, Event, Violation},
    options::AirOptions,
    radio::SimRadio,
};

/// A simulated air in this process. Clones share the same air, which ends with the last clone and the last radio.
///
/// ```no_run
/// # use zenoh_link_ble_air::{AirOptions, SimAir};
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
    reschedule: Arc<Notify>,
}

struct Inner {
    air: Air,
    /// Time at which the driver task wakes up.
    driver_wakes_at: Option<Duration>,
    outboxes: HashMap<AdapterId, mpsc::UnboundedSender<Event>>,
    radios: HashMap<String, Weak<Attachment>>,
    sniffer: Option<Box<Sniffer>>,
}

/// Is given the time since the start of the air and each SDU, as a receiver that follows all connections.
type Sniffer = dyn FnMut(Duration, &[u8]) + Send;

/// An attached adapter, and the events that the air sends to it. Dropping it detaches the adapter.
pub(super) struct Attached {
    pub(super) events: mpsc::UnboundedReceiver<Event>,
    pub(super) handle: AirHandle,
}

/// Sends the commands of one adapter to the air.
pub(super) struct AirHandle {
    id: AdapterId,
    shared: Arc<Shared>,
}

impl SimAir {
    /// Creates an air without adapters. Must be called within a tokio runtime, which then drives the air. Options
    /// outside the range of Bluetooth are clamped to it; [`AirOptions::check`] reports them.
    pub fn new(options: AirOptions) -> Self {
        let reschedule = Arc::new(Notify::new());
        let shared = Arc::new(Shared {
            start: Instant::now(),
            inner: Mutex::new(Inner {
                air: Air::new(options),
                driver_wakes_at: None,
                outboxes: HashMap::new(),
                radios: HashMap::new(),
                sniffer: None,
            }),
            reschedule: Arc::clone(&reschedule),
        });
        tokio::spawn(drive(Arc::downgrade(&shared), reschedule));
        Self { shared }
    }

    /// Returns the adapter of that name. Attaches it, powered on, unless this process has already attached it.
    ///
    /// # Errors
    /// Fails if the name is invalid or if a client of the air's [`AirServer`](super::AirServer) has attached it.
    // Async although it does not wait: attaching to another process does, and tests use both.
    #[allow(clippy::unused_async)]
    pub async fn radio(&self, name: &str) -> Result<Arc<SimRadio>, RadioError> {
        let existing = {
            let inner = self.shared.inner.lock();
            inner.radios.get(name).and_then(Weak::upgrade)
        };
        if let Some(attachment) = existing {
            return Ok(Arc::new(SimRadio { attachment }));
        }
        let Attached { mut events, handle } =
            self.attach(name).map_err(|error| RadioError::NoAdapter {
                adapter: name.to_owned(),
                advice: error.to_string(),
            })?;
        let attachment = Arc::new(Attachment::new(name, address_of(name), Box::new(handle)));
        attachment.set_intervals(self.default_interval(), self.changes_open_connections());
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

    /// Cuts the radio contact between all adapters. Links end when their supervision timeout expires.
    pub fn cut(&self) {
        self.shared.with_air(|air, now| air.cut(now));
    }

    /// Cuts the radio contact once `packets` more packets with data have arrived (0: immediately). Every packet of an
    /// SDU and every L2CAP command counts (channel request, response, credits, disconnect); a retransmitted packet
    /// counts once.
    pub fn cut_after(&self, packets: u64) {
        self.shared.with_air(|air, now| air.cut_after(packets, now));
    }

    /// Restores the radio contact between all adapters.
    pub fn restore(&self) {
        self.shared.with_air(|air, now| air.restore(now));
    }

    /// Cuts the radio contact between two adapters.
    pub fn cut_between(&self, a: &str, b: &str) {
        self.shared.with_air(|air, now| air.cut_between(a, b, now));
    }

    /// Switches an adapter on (also a removed one) or off.
    ///
    /// # Errors
    /// Fails if no adapter of that name is attached.
    pub fn power(&self, name: &str, on: bool) -> Result<(), NoSuchAdapter> {
        self.shared.with_air(|air, now| air.power(name, on, now))
    }

    /// Removes an adapter without notice, as when a dongle is unplugged. [`SimAir::power`] adds it again.
    ///
    /// # Errors
    /// Fails if no adapter of that name is attached.
    pub fn remove(&self, name: &str) -> Result<(), NoSuchAdapter> {
        self.shared.with_air(|air, now| air.remove(name, now))
    }

    /// Changes the radio condition.
    pub fn set_condition(&self, condition: Condition) {
        self.shared
            .with_air(|air, now| air.set_condition(condition, now));
    }

    /// Returns the traffic that an adapter has sent; `None` if it is not attached.
    pub fn stats(&self, name: &str) -> Option<AdapterStats> {
        self.shared.with_air(|air, now| {
            air.poll(now);
            air.stats(name)
        })
    }

    /// Returns the attached adapters and the connections between them.
    pub fn status(&self) -> AirStatus {
        self.shared.with_air(|air, now| {
            air.poll(now);
            air.status()
        })
    }

    /// Returns the connection interval of links for which no other one is set.
    pub(super) fn default_interval(&self) -> ConnectionInterval {
        self.shared.inner.lock().air.default_interval()
    }

    /// Returns whether an adapter can change the interval of an open connection.
    pub(super) fn changes_open_connections(&self) -> bool {
        let inner = self.shared.inner.lock();
        inner.air.changes_open_connections()
    }

    /// Gives each SDU that is sent from now on to `sniffer`, which must not block. A former sniffer is replaced.
    pub fn sniff(&self, sniffer: impl FnMut(Duration, &[u8]) + Send + 'static) {
        self.shared.inner.lock().sniffer = Some(Box::new(sniffer));
    }

    /// Returns the age of the air by tokio's clock.
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
            handle: AirHandle {
                id,
                shared: Arc::clone(&self.shared),
            },
        })
    }
}

impl AirHandle {
    /// Sends a command to the air.
    ///
    /// # Errors
    /// Returns a violation if no correct adapter would send the command.
    pub(super) fn try_command(&self, command: Command) -> Result<(), Violation> {
        if let Command::Send { sdu, .. } = &command {
            let at = self.shared.start.elapsed();
            if let Some(sniffer) = &mut self.shared.inner.lock().sniffer {
                sniffer(at, sdu);
            }
        }
        self.shared
            .with_air(|air, now| air.command(self.id, command, now))
    }
}

impl AirConnection for AirHandle {
    fn command(&self, command: Command) {
        if let Err(violation) = self.try_command(command) {
            tracing::error!("the simulated air refused a command of its own radio: {violation}");
        }
    }

    fn missing_error(&self, adapter: &str) -> RadioError {
        RadioError::NoAdapter {
            adapter: adapter.to_owned(),
            advice: "it was removed from the simulated air; call `SimAir::power` to add it again"
                .to_owned(),
        }
    }
}

impl Drop for AirHandle {
    fn drop(&mut self) {
        self.shared.with_air(|air, now| air.detach(self.id, now));
        self.shared.inner.lock().outboxes.remove(&self.id);
    }
}

impl Shared {
    /// Applies `action` to the model at the current time, and dispatches the resulting events.
    fn with_air<T>(&self, action: impl FnOnce(&mut Air, Duration) -> T) -> T {
        let mut inner = self.inner.lock();
        // Read while the lock is held, so that the model's time never goes backwards.
        let now = self.start.elapsed();
        let result = action(&mut inner.air, now);
        inner.dispatch();
        let next = inner.air.next_wakeup();
        let driver_wakes_at = inner.driver_wakes_at;
        drop(inner);
        if next.is_some_and(|next| driver_wakes_at.is_none_or(|until| next < until)) {
            self.reschedule.notify_one();
        }
        result
    }

    /// Handles expired timers, and returns the time at which the driver should wake up again.
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
        for timed in self.air.drain() {
            if let Some(outbox) = self.outboxes.get(&timed.adapter) {
                let _ = outbox.send(timed.event);
            }
        }
    }
}

impl Drop for Shared {
    fn drop(&mut self) {
        // Wakes up the driver, which then ends.
        self.reschedule.notify_one();
    }
}

async fn drive(shared: Weak<Shared>, reschedule: Arc<Notify>) {
    while let Some(next) = shared.upgrade().map(|shared| shared.drive()) {
        let due = async {
            match next {
                Some(next) => sleep_until(next).await,
                None => pending().await,
            }
        };
        tokio::select! {
            () = due => {}
            () = reschedule.notified() => {}
        }
    }
}
