//! Exposes the presence of a program, and the catalogues of robots.
use std::sync::{Arc, Mutex};

use pyo3::prelude::*;
use rect_core::{
    catalogue::{
        self, presence,
        registration::{Registered, Registration},
        Program, ServiceEntry,
    },
    registry::catalogue_query,
};

use crate::{
    clock::Clock,
    driver::{lock, Driver},
    errors::raised,
    key_space::{name, topic, AnyTopic, KeySpace},
    parameters::{declaration_parts, ParameterDeclaration, ParameterParts},
};

/// The presence of this program.
#[pyclass(frozen, module = "rect._rect")]
pub struct ProgramPresence {
    core: Arc<Mutex<presence::ProgramPresence>>,
    clock: Clock,
}

/// The last catalogues of robots.
#[pyclass(frozen, module = "rect._rect")]
pub struct Catalogues(pub catalogue_query::Catalogues);

/// A service that the program would like to provide.
#[pyclass(frozen, module = "rect._rect")]
pub struct OfferedService {
    entry: ServiceEntry,
    program: Program,
}

/// The topic of a service, its description, and whether other programs may serve the topic, too.
type EntryParts = (String, String, bool);
/// The name of a group of parameters and its declaration.
type GroupParts<'py> = (String, Vec<ParameterParts<'py>>);
/// The name of a program, its instance, its services, its groups of parameters, and its actions with their descriptions.
type ProgramParts<'py> = (
    Option<String>,
    String,
    Vec<EntryParts>,
    Vec<GroupParts<'py>>,
    Vec<(String, String)>,
);

#[pymethods]
impl Catalogues {
    #[new]
    fn new() -> Self {
        Self(catalogue_query::Catalogues::default())
    }

    /// Creates the question for the catalogue of a robot.
    fn query(&self, key_space: &KeySpace, robot: &str) -> PyResult<Driver> {
        let query = self.0.query(key_space.0.clone(), name(robot)?);
        Ok(Driver::new(query, &Clock::new()))
    }

    /// Creates the question which robots serve a topic. `has_ended`: it is asked a moment later, because a request has just ended.
    fn servers(&self, key_space: &KeySpace, topic: &str, has_ended: bool) -> PyResult<Driver> {
        let (clock, topic) = (Clock::new(), self::topic(topic)?);
        let query = self.0.servers(key_space.0.clone(), topic);
        let query = match has_ended {
            true => query.after_end(clock.created_at()),
            false => query,
        };
        Ok(Driver::new(query, &clock))
    }
}

#[pymethods]
impl ProgramPresence {
    /// Creates the presence of a program, which may have no name. `instance` is a random number.
    #[new]
    fn new(
        key_space: &KeySpace,
        program: Option<&str>,
        instance: u32,
        is_direct: bool,
    ) -> PyResult<Self> {
        let program = program.map(name).transpose()?;
        let place = key_space.0.clone();
        let core = presence::ProgramPresence::new(place, program, instance, is_direct);
        Ok(Self {
            core: Arc::new(Mutex::new(core)),
            clock: Clock::new(),
        })
    }

    /// Returns the driver to execute.
    fn driver(&self) -> Driver {
        Driver::shared(&self.core, &self.clock)
    }

    /// Begins to offer a service, or changes of parameters. Raises `ServiceRefused`.
    #[pyo3(signature = (topic, about, several, parameters=None))]
    fn offer(
        &self,
        py: Python<'_>,
        topic: AnyTopic,
        about: &str,
        several: bool,
        parameters: Option<&ParameterDeclaration>,
    ) -> PyResult<OfferedService> {
        let entry = ServiceEntry {
            parameters: parameters.map(|declaration| declaration.0.clone()),
            ..ServiceEntry::new(topic.0, about, several)
        };
        let program = lock(&self.core).offer(&entry);
        match program {
            Ok(program) => Ok(OfferedService { entry, program }),
            Err(reason) => Err(raised(py, "ServiceRefused", (reason,))),
        }
    }

    /// Creates the registration of the program with that service at its router.
    fn registration(&self, key_space: &KeySpace, offered: &OfferedService) -> Driver {
        let registration = Registration::new(&key_space.0, &offered.program);
        Driver::new(registration, &Clock::new())
    }

    /// Handles that the program provides a service from now on. `is_registered`: its router keeps it, and may have a warning.
    fn on_served(&self, offered: &OfferedService, is_registered: bool, warning: Option<String>) {
        let registered = match is_registered {
            true => Registered::Accepted(warning),
            false => Registered::Unanswered,
        };
        lock(&self.core).on_served(offered.entry.clone(), &offered.program, registered);
    }

    /// Creates the registration of the program as it is, which its router may refuse.
    fn renewal(&self, key_space: &KeySpace) -> Driver {
        let registration = Registration::new(&key_space.0, lock(&self.core).program());
        Driver::new(registration, &Clock::new())
    }

    /// Handles that another program serves a topic, because this one did not answer.
    fn on_taken_over(&self, topic: AnyTopic) {
        lock(&self.core).on_taken_over(&topic.0);
    }

    /// Handles that a service has ended.
    fn on_ended(&self, topic: AnyTopic) {
        lock(&self.core).on_ended(&topic.0);
    }
}

/// Returns the name of a program whose script is `file`, or nothing if that says nothing about it.
#[pyfunction]
pub fn program_name(file: &str) -> Option<String> {
    catalogue::program_name(file).map(|name| name.to_string())
}

/// Reads the catalogue of a robot. Raises `PayloadError`.
#[pyfunction]
pub fn read_catalogue<'py>(py: Python<'py>, bytes: &[u8]) -> PyResult<Vec<ProgramParts<'py>>> {
    let programs = catalogue::read(bytes)
        .map_err(|error| raised(py, "PayloadError", (error.to_string(), "read")))?;
    let parts =
        |entry: &ServiceEntry| (entry.topic.to_string(), entry.about.clone(), entry.several);
    let programs = programs.into_iter().map(|program| {
        let name = program.name.as_ref().map(ToString::to_string);
        let services = program.requestable().map(parts).collect();
        let groups = program.parameters().map(|(group, declaration)| {
            Ok((group.to_owned(), declaration_parts(py, declaration)?))
        });
        let groups = groups.collect::<PyResult<_>>()?;
        let actions = program.actions();
        let actions = actions.map(|(action, about)| (action.to_owned(), about.to_owned()));
        let actions = actions.collect();
        Ok((
            name,
            program.instance.to_string(),
            services,
            groups,
            actions,
        ))
    });
    programs.collect()
}
