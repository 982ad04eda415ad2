//! Keeps the values of a group of parameters: decides about changes, and when to publish and store them.
use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use super::{
    file::ParametersFile,
    order::{to_cbor, InForce, Order, Reset, Snapshot, Stored},
    Declaration, Parameter, Value, Values, MAX_BYTES,
};
use crate::message::payload::Payload;

/// How long a change waits for further ones before all are stored.
const STORE_AFTER: Duration = Duration::from_millis(300);
/// When it is tried again to publish or store values if that has failed.
const AGAIN_AFTER: Duration = Duration::from_secs(5);
/// The reason why values are not stored if there is no file for them.
const NO_FILE: &str = "the program does not keep its parameters in a file";

/// A group of parameters of a program.
#[derive(Debug)]
pub struct Group {
    declaration: Declaration,
    values: Values,
    file: Option<ParametersFile>,
    /// Counts the changes.
    revision: u64,
    published: u64,
    publish_at: Option<Instant>,
    stored: u64,
    /// Why the values are not stored.
    problem: Option<String>,
    store_at: Option<Instant>,
    is_working: bool,
    last: Snapshot,
}

/// Values that are not in force yet, which the program may check.
#[derive(Clone, Debug, PartialEq)]
pub struct Proposal {
    /// The values as they will be.
    pub values: Values,
    order: Order,
}

/// A change of parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Change {
    /// The parameters that have another value now.
    pub changed: Vec<Changed>,
    /// The program that changed them, `<robot>/<program>`; empty if it was the program itself.
    pub by: String,
}

/// A parameter that has another value now.
#[derive(Clone, Debug, PartialEq)]
pub struct Changed {
    /// The parameter.
    pub name: String,
    /// The value before.
    pub old: Value,
    /// The value now.
    pub new: Value,
}

/// The next thing to do for a group.
#[derive(Debug)]
pub enum Work {
    /// Publish the values, retained. If that fails, call [`Group::on_not_published`].
    Publish(Payload),
    /// Store the values: call [`Group::begin_saving`], [`Saving::run`], and then [`Group::on_saved`].
    Save,
    /// Wait until this time, or for a change.
    Wait(Option<Instant>),
}

/// Values that are being stored.
#[derive(Debug)]
pub struct Saving {
    declaration: Declaration,
    values: Values,
    file: ParametersFile,
    revision: u64,
    result: Result<Option<String>, String>,
}

impl Group {
    /// Creates a group with the values of its file. Returns what the program's user should know.
    pub fn new(declaration: Declaration, file: Option<ParametersFile>) -> (Self, Vec<String>) {
        let mut file = file;
        let (values, warnings) = match &mut file {
            Some(file) => file.load(&declaration),
            None => (Values::defaults(&declaration), Vec::new()),
        };
        let group = Self {
            declaration,
            values,
            file,
            revision: 1,
            published: 0,
            publish_at: None,
            stored: 1,
            problem: None,
            store_at: None,
            is_working: false,
            last: Snapshot::default(),
        };
        (group, warnings)
    }

    /// Returns the declaration.
    pub fn declaration(&self) -> &Declaration {
        &self.declaration
    }

    /// Returns the values that are in force.
    pub fn values(&self) -> &Values {
        &self.values
    }

    /// Returns the value of a parameter.
    ///
    /// # Errors
    /// Returns that the group has no such parameter, and which one may be meant.
    pub fn value(&self, name: &str) -> Result<&Value, String> {
        self.declaration.find(name)?;
        let mut pairs = self.values.of(&self.declaration);
        let found = pairs.find(|(parameter, _)| parameter.name == name);
        found.map(|(_, value)| value).ok_or_else(String::new)
    }

    /// Returns the values as they will be if an order is carried out. `is_own`: it is the program's own.
    ///
    /// # Errors
    /// Returns why it is not carried out. Nothing has changed then.
    pub fn propose(&self, order: Order, is_own: bool) -> Result<Proposal, String> {
        let mut values = self.values.clone();
        let may_change = |parameter: &Parameter| match parameter.read_only && !is_own {
            true => Err(format!("{} is read-only", parameter.name)),
            false => Ok(()),
        };
        match &order.reset {
            Reset::All(false) => {}
            Reset::All(true) => {
                for parameter in self.declaration.parameters() {
                    if may_change(parameter).is_ok() {
                        let default = parameter.default.clone();
                        values.replace(&self.declaration, &parameter.name, default);
                    }
                }
            }
            Reset::Some(names) => {
                for name in names {
                    let parameter = self.declaration.find(name)?;
                    may_change(parameter)?;
                    values.replace(&self.declaration, name, parameter.default.clone());
                }
            }
        }
        for (name, value) in &order.set {
            let parameter = self.declaration.find(name)?;
            may_change(parameter)?;
            let value = parameter.accept(value)?;
            values.replace(&self.declaration, name, value);
        }
        if values.iter().map(Value::size).sum::<usize>() > MAX_BYTES {
            return Err(format!(
                "the values of the group would have more than {MAX_BYTES} bytes"
            ));
        }
        Ok(Proposal { values, order })
    }

    /// Puts the proposed values into force. Nobody may have changed the group since they were proposed. `robot`: the robot that has sent
    /// the order; `None` if it is the program's own. Returns the change, if there is one.
    pub fn commit(
        &mut self,
        proposal: &Proposal,
        robot: Option<&str>,
        now: Instant,
    ) -> Option<Change> {
        let pairs = self
            .values
            .of(&self.declaration)
            .zip(proposal.values.iter());
        let changed = pairs
            .filter(|((_, old), new)| old != new)
            .map(|((parameter, old), new)| Changed {
                name: parameter.name.clone(),
                old: old.clone(),
                new: new.clone(),
            });
        let changed: Vec<_> = changed.collect();
        if changed.is_empty() {
            return None;
        }
        let by = match (robot, proposal.order.by.as_str()) {
            (None, _) => String::new(),
            (Some(robot), "") => robot.to_owned(),
            (Some(robot), program) => format!("{robot}/{program}"),
        };
        self.values = proposal.values.clone();
        self.revision += 1;
        self.last = Snapshot {
            values: BTreeMap::new(),
            changed: changed.iter().map(|changed| changed.name.clone()).collect(),
            by: by.clone(),
        };
        if self.file.is_some() || self.is_working {
            self.store_at.get_or_insert(now + STORE_AFTER);
        }
        Some(Change { changed, by })
    }

    /// Returns the reply to an order that was carried out.
    pub fn in_force(&self, proposal: &Proposal) -> Payload {
        let order = &proposal.order;
        let is_named = |name: &String| match &order.reset {
            Reset::All(true) => true,
            Reset::Some(names) if names.contains(name) => true,
            _ => order.set.contains_key(name),
        };
        let pairs = self.values.of(&self.declaration);
        let named = pairs.filter(|(parameter, _)| is_named(&parameter.name));
        let values = named.map(|(parameter, value)| (parameter.name.clone(), value.clone()));
        to_cbor(&InForce {
            values: values.collect(),
        })
    }

    /// Returns the number of changes so far.
    pub fn revision(&self) -> u64 {
        self.revision
    }

    /// Returns the second reply to an order that asked for it, once the values of that revision are stored or could not be.
    pub fn stored(&self, revision: u64) -> Option<Payload> {
        let reason = match &self.problem {
            _ if self.stored >= revision => String::new(),
            Some(problem) => problem.clone(),
            None if self.file.is_none() && !self.is_working => NO_FILE.to_owned(),
            None => return None,
        };
        let stored = reason.is_empty();
        Some(to_cbor(&Stored { stored, reason }))
    }

    /// Returns what to do now. If that is not to wait, call it again after it is done.
    pub fn work(&mut self, now: Instant) -> Work {
        let is_due = self.publish_at.is_some_and(|at| at <= now);
        if self.published != self.revision || is_due {
            self.published = self.revision;
            self.publish_at = None;
            let pairs = self.values.of(&self.declaration);
            let values = pairs.map(|(parameter, value)| (parameter.name.clone(), value.clone()));
            return Work::Publish(to_cbor(&Snapshot {
                values: values.collect(),
                ..self.last.clone()
            }));
        }
        match self.store_at {
            Some(at) if at <= now && !self.is_working => Work::Save,
            _ if self.is_working => Work::Wait(self.publish_at),
            at => Work::Wait(at.into_iter().chain(self.publish_at).min()),
        }
    }

    /// Begins to store the values, if they have changed. Also for a program that ends. Nothing else is stored until
    /// [`on_saved`](Self::on_saved).
    pub fn begin_saving(&mut self) -> Option<Saving> {
        self.store_at?;
        let file = self.file.take()?;
        self.store_at = None;
        self.is_working = true;
        Some(Saving {
            declaration: self.declaration.clone(),
            values: self.values.clone(),
            file,
            revision: self.revision,
            result: Ok(None),
        })
    }

    /// Handles that the values could not be published.
    pub fn on_not_published(&mut self, now: Instant) {
        self.publish_at = Some(now + AGAIN_AFTER);
    }

    /// Handles that values were stored, or could not be. Returns a warning, if there is a new one.
    pub fn on_saved(&mut self, saving: Saving, now: Instant) -> Option<String> {
        self.is_working = false;
        self.file = Some(saving.file);
        match saving.result {
            Ok(warning) => {
                self.stored = saving.revision;
                self.problem = None;
                warning
            }
            Err(problem) => {
                self.store_at.get_or_insert(now + AGAIN_AFTER);
                let is_new = self.problem.as_ref() != Some(&problem);
                self.problem = Some(problem.clone());
                is_new.then_some(problem)
            }
        }
    }
}

impl Saving {
    /// Writes the file. Blocks, for the time that the disk takes.
    pub fn run(&mut self) {
        self.result = self.file.save(&self.declaration, &self.values);
    }
}
