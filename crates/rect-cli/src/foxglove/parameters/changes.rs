//! Carries out the changes of viewers: those of a group in order, those of several groups at the same time.
use std::{
    collections::BTreeMap,
    future::Future,
    sync::{Mutex, PoisonError},
};

use foxglove::websocket::Parameter;
use rect::{Name, ParameterOrder, ParameterValue, Robot};
use tokio::{
    runtime::Handle,
    sync::{
        mpsc::{self, Receiver, Sender},
        oneshot,
    },
};

use super::of_group;

/// Number of changes of a group that wait at most.
const WAITING: usize = 64;
/// Number of groups with a queue at most. Beyond that, the empty ones are removed.
const MAX_GROUPS: usize = 256;

/// A change of some parameters of a group.
pub struct Change {
    /// The robot.
    pub robot: Name,
    /// The group.
    pub group: String,
    /// The new values.
    pub values: BTreeMap<String, ParameterValue>,
}

/// The changes of viewers.
pub struct Changes {
    robot: Robot,
    runtime: Handle,
    /// The queue of each robot and group.
    queues: Mutex<BTreeMap<(Name, String), Sender<Waiting>>>,
}

/// The parameters that are in force, or why the change failed.
type Outcome = Result<Vec<Parameter>, String>;

struct Waiting {
    change: Change,
    outcome: oneshot::Sender<Outcome>,
}

impl Changes {
    /// Creates the queues. Call it on a tokio runtime.
    pub fn new(robot: Robot) -> Self {
        Self {
            robot,
            runtime: Handle::current(),
            queues: Mutex::default(),
        }
    }

    /// Begins a change, after those of the same group that were begun before.
    pub fn begin(&self, change: Change) -> impl Future<Output = Outcome> + use<> {
        let name = format!("{}/{}", change.robot, change.group);
        let (outcome, finished) = oneshot::channel();
        let begun = self.enqueue(Waiting { change, outcome });
        async move {
            begun.map_err(|problem| format!("{name}: {problem}"))?;
            let outcome = finished.await;
            outcome.unwrap_or_else(|_| Err(format!("{name}: the command ends")))
        }
    }

    fn enqueue(&self, waiting: Waiting) -> Result<(), &'static str> {
        let mut queues = self.queues.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (waiting.change.robot.clone(), waiting.change.group.clone());
        if queues.len() >= MAX_GROUPS {
            queues.retain(|_, queue| queue.capacity() < queue.max_capacity());
        }
        if queues.len() >= MAX_GROUPS && !queues.contains_key(&key) {
            return Err("viewers have changed too many groups");
        }
        let queue = queues.entry(key).or_insert_with(|| {
            let (queue, changes) = mpsc::channel(WAITING);
            self.runtime.spawn(carry_out(self.robot.clone(), changes));
            queue
        });
        (queue.try_send(waiting)).map_err(|_| "too many changes at once: this one is dropped")
    }
}

async fn carry_out(robot: Robot, mut changes: Receiver<Waiting>) {
    while let Some(Waiting { change, outcome }) = changes.recv().await {
        // The viewer may have left.
        let _ = outcome.send(set(&robot, change).await);
    }
}

async fn set(own: &Robot, change: Change) -> Outcome {
    let Change {
        robot,
        group,
        values,
    } = change;
    let order = ParameterOrder::from(values);
    let changed = own.set_parameters(robot.clone(), &group, order).await;
    let changed = changed.map_err(|error| format!("{robot}/{group}: {error}"))?;
    Ok(of_group(&robot, &group, &changed))
}
