//! Keeps a group of parameters of this program: serves changes, publishes the values, and stores them.
use std::{
    collections::VecDeque,
    fmt,
    panic::{catch_unwind, AssertUnwindSafe},
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError, RwLock},
    time::Instant,
};

use rect_core::{
    catalogue::ServiceEntry,
    message::payload::Payload,
    parameters::{
        self,
        file::{self, ParametersFile},
        group::Work,
        order::Order,
        Change, Declaration, Group,
    },
};
use tokio::{
    sync::{watch, Notify},
    task::JoinHandle,
};

use super::{
    options::{Check, File, GroupOptions, OnChange, Read},
    order::ParameterOrder,
};
use crate::{
    error::Error,
    session::{
        robot::Robot,
        service::{Request, Requests},
        shared::lock,
        subscriber::call,
        warnings::warn,
    },
};

/// A group of parameters of this program; created by [`Robot::parameters`]. Dropping it stores what has changed, and ends the group: its
/// last values remain visible, as those of a program that has ended.
pub struct ParameterGroup<T = std::collections::BTreeMap<String, parameters::Value>> {
    shared: Arc<Shared<T>>,
    tasks: [JoinHandle<()>; 2],
}

struct Shared<T> {
    name: String,
    group: Mutex<Group>,
    current: RwLock<Arc<T>>,
    /// Held from the proposal of a change until it is in force.
    turn: Mutex<()>,
    /// Held while the file is written.
    saving: Mutex<()>,
    changes: Mutex<Changes<T>>,
    read: Box<Read<T>>,
    check: Option<Box<Check<T>>>,
    on_change: Option<Box<OnChange<T>>>,
    /// Wakes the task that publishes and stores.
    wake: Notify,
    /// Changes when values were stored, or could not be.
    stored: watch::Sender<()>,
}

/// The changes of which the program has not been notified.
struct Changes<T> {
    waiting: VecDeque<(Arc<T>, Change)>,
    is_notifying: bool,
}

impl Robot {
    /// Declares a group of parameters: values of this program that people tune while it runs, such as a gain.
    ///
    /// They are set with [`set_parameters`](Self::set_parameters), `rect param`, and on the dashboard, and kept in a file, so that they
    /// survive a restart. `group` is the name of the group, or [`GroupOptions`].
    ///
    /// ```no_run
    /// #[derive(rect::Parameters)]
    /// struct Drive {
    ///     /// Gain of the heading
    ///     #[parameter(default = 1.0, min = 0.0, max = 10.0, unit = "1/s")]
    ///     kp: f64,
    ///     #[parameter(choices("left", "right"))]
    ///     side: String,
    ///     turbo: bool,
    /// }
    ///
    /// # async fn tune(robot: rect::Robot) -> Result<(), rect::Error> {
    /// let drive = robot.parameters::<Drive>("drive").await?;
    /// println!("{}", drive.get().kp);
    /// # Ok(()) }
    /// ```
    ///
    /// # Errors
    /// [`Error::Parameters`] if the declaration is invalid, [`Error::ServiceRefused`] if a program of this robot has a group of that name
    /// already, and [`Error::Closed`] if the session is closed. A file that cannot be read or does not fit is logged as a warning.
    ///
    /// # Cancel safety
    /// If the future is dropped, there is no group.
    pub async fn parameters<T: Send + Sync + 'static>(
        &self,
        group: impl Into<GroupOptions<T>>,
    ) -> Result<ParameterGroup<T>, Error> {
        let options = group.into();
        let name = options.group;
        let invalid = |reason: String| Error::Parameters { reason };
        let declaration = Declaration::new(options.parameters);
        let declaration = declaration.map_err(|error| invalid(error.to_string()))?;
        let entry = ServiceEntry::of_parameters(&name, &options.about, declaration.clone());
        let entry = entry.ok_or_else(|| invalid(parameters::wrong_group(&name)))?;
        let file = match options.file {
            File::At(path) => Some(path),
            File::None => None,
            File::Default => default_file(self, &name),
        };
        let requests = self.requests_of(entry).await?;
        let file = file.as_deref().map(ParametersFile::new);
        let (group, warnings) = Group::new(declaration, file);
        warnings.iter().for_each(|warning| warn(warning));
        let current = (options.read)(group.declaration(), group.values());
        let shared = Arc::new(Shared {
            name,
            current: RwLock::new(Arc::new(current)),
            group: Mutex::new(group),
            turn: Mutex::default(),
            saving: Mutex::default(),
            changes: Mutex::new(Changes {
                waiting: VecDeque::new(),
                is_notifying: false,
            }),
            read: options.read,
            check: options.check,
            on_change: options.on_change,
            wake: Notify::new(),
            stored: watch::Sender::new(()),
        });
        let runtime = &self.inner.runtime;
        let tasks = [
            runtime.spawn(shared.clone().serve(requests)),
            runtime.spawn(shared.clone().publish_and_store(self.clone())),
        ];
        Ok(ParameterGroup { shared, tasks })
    }
}

fn default_file(robot: &Robot, group: &str) -> Option<PathBuf> {
    let path = file::path(robot.name().as_str(), group, |name| std::env::var_os(name));
    if path.is_none() {
        warn(&format!(
            "the parameters {group} are not kept: there is no folder for them. Set RECT_PARAMETERS to one, or name a file"
        ));
    }
    path
}

impl<T: Send + Sync + 'static> ParameterGroup<T> {
    /// Returns the values that are in force, which do not change any more: call it again for later ones.
    pub fn get(&self) -> Arc<T> {
        self.shared.current()
    }

    /// Changes parameters of this program, also read-only ones: all or none. Returns when they are in force; they are published and
    /// stored in the background.
    ///
    /// # Errors
    /// [`Error::Parameters`] with the reason if a value is refused.
    pub fn set(&self, order: impl Into<ParameterOrder>) -> Result<(), Error> {
        let changed = self.shared.change(order.into().0, None);
        changed.map_err(|reason| Error::Parameters { reason })?;
        Ok(())
    }
}

impl<T> Shared<T> {
    /// Stores the values, if they have changed.
    fn save(&self) {
        let _alone = lock(&self.saving);
        let Some(mut saving) = lock(&self.group).begin_saving() else {
            return;
        };
        saving.run();
        let warning = lock(&self.group).on_saved(saving, Instant::now());
        self.stored.send_replace(());
        if let Some(warning) = warning {
            warn(&warning);
        }
    }
}

impl<T: Send + Sync + 'static> Shared<T> {
    fn current(&self) -> Arc<T> {
        let current = self.current.read();
        current.unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Carries out an order of a robot, or of the program itself (`None`). Returns the reply, and the number of the change.
    fn change(&self, order: Order, robot: Option<&str>) -> Result<(Payload, u64), String> {
        let turn = lock(&self.turn);
        let proposal = lock(&self.group).propose(order, robot.is_none())?;
        let declaration = lock(&self.group).declaration().clone();
        let proposed = Arc::new((self.read)(&declaration, &proposal.values));
        if let Some(check) = &self.check {
            // The requester gets an error, and the group goes on.
            let checked = catch_unwind(AssertUnwindSafe(|| check(&proposed)));
            checked.unwrap_or_else(|_| Err("the check of the program failed".to_owned()))?;
        }
        let mut group = lock(&self.group);
        let change = group.commit(&proposal, robot, Instant::now());
        let reply = (group.in_force(&proposal), group.revision());
        drop(group);
        if let Some(change) = change {
            let mut current = self.current.write().unwrap_or_else(PoisonError::into_inner);
            *current = proposed.clone();
            drop(current);
            if self.on_change.is_some() {
                lock(&self.changes).waiting.push_back((proposed, change));
            }
            self.wake.notify_one();
        }
        drop(turn);
        self.notify();
        Ok(reply)
    }

    /// Reports changes to the program, unless that is being done: `on_change` may change parameters itself.
    fn notify(&self) {
        let Some(on_change) = &self.on_change else {
            return;
        };
        loop {
            let mut changes = lock(&self.changes);
            if changes.is_notifying {
                return;
            }
            let Some((values, change)) = changes.waiting.pop_front() else {
                return;
            };
            changes.is_notifying = true;
            drop(changes);
            call("on_change", || on_change(&values, &change));
            lock(&self.changes).is_notifying = false;
        }
    }

    /// Carries out the orders of other programs, one after the other.
    async fn serve(self: Arc<Self>, requests: Requests) {
        while let Some(request) = requests.next().await {
            let order = Order::read(&request.payload);
            let wants_stored = order.as_ref().is_ok_and(|order| order.stored);
            let robot = request
                .sender
                .as_ref()
                .map_or("a Zenoh program", |robot| robot.as_str());
            // Errors mean that the session is closed.
            match order.and_then(|order| self.change(order, Some(robot))) {
                Err(reason) => drop(request.refuse(reason)),
                Ok((reply, revision)) => {
                    drop(request.reply(reply));
                    if wants_stored {
                        tokio::spawn(self.clone().confirm_stored(request, revision));
                    } else {
                        drop(request.finish());
                    }
                }
            }
        }
    }

    /// Sends the second reply once the values of that change are stored, or could not be.
    async fn confirm_stored(self: Arc<Self>, request: Request, revision: u64) {
        let mut stored = self.stored.subscribe();
        loop {
            let reply = lock(&self.group).stored(revision);
            if let Some(reply) = reply {
                drop(request.reply(reply));
                drop(request.finish());
                return;
            }
            if stored.changed().await.is_err() {
                return;
            }
        }
    }

    async fn publish_and_store(self: Arc<Self>, robot: Robot) {
        let retained = robot.retained();
        let topic = parameters::topic(&self.name);
        loop {
            let work = lock(&self.group).work(Instant::now());
            match work {
                Work::Publish(values) => match retained.publish(topic.as_str(), values).await {
                    Ok(()) => {}
                    Err(Error::Closed) => return,
                    Err(error) => {
                        robot
                            .inner
                            .warnings
                            .on_retention_problem(&error.to_string());
                        lock(&self.group).on_not_published(Instant::now());
                    }
                },
                Work::Save => {
                    let shared = self.clone();
                    // It fails if the runtime ends; the group is dropped then.
                    let _ = tokio::task::spawn_blocking(move || shared.save()).await;
                }
                Work::Wait(None) => self.wake.notified().await,
                Work::Wait(Some(until)) => {
                    let _ = tokio::time::timeout_at(until.into(), self.wake.notified()).await;
                }
            }
        }
    }
}

impl<T> Drop for ParameterGroup<T> {
    fn drop(&mut self) {
        self.tasks.iter().for_each(JoinHandle::abort);
        self.shared.save();
    }
}

impl<T> fmt::Debug for ParameterGroup<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ParameterGroup({})", self.shared.name)
    }
}
