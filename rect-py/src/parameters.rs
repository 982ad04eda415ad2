//! Exposes groups of parameters: their declarations, values and files, and the orders that change them.
use std::{path::PathBuf, sync::Mutex, time::Instant};

use pyo3::{
    exceptions::PyAttributeError,
    prelude::*,
    pybacked::PyBackedBytes,
    types::{PyDict, PyFloat},
    IntoPyObjectExt,
};
use rect_core::{
    parameters::{
        self,
        declaration::Kind,
        file::{self, ParametersFile},
        group::{self, Change, Work},
        order::{to_cbor, Order, Reset},
        Declaration, Parameter, Value,
    },
    session::names,
};
use serde::{de::IntoDeserializer, Deserialize};

use crate::{
    codec::{parts, payload, Parts},
    detached::detached,
    driver::lock,
    errors::raised,
    key_space::name,
    value::{self, Value as Plain},
};

/// The declaration of a group of parameters.
#[pyclass(frozen, module = "rect._rect")]
pub struct ParameterDeclaration(pub Declaration);

/// A group of parameters of this program.
#[pyclass(frozen, module = "rect._rect")]
pub struct ParameterGroup {
    core: Mutex<parameters::Group>,
    /// Held while the file is written.
    saving: Mutex<()>,
}

/// A change of parameters that is not in force yet.
#[pyclass(frozen, module = "rect._rect")]
pub struct ParameterProposal(group::Proposal);

/// An order to change parameters.
#[pyclass(frozen, module = "rect._rect")]
pub struct ParameterOrder(Order);

/// The name of a parameter, its type (`None`: that of the default), default, minimum, maximum, choices, unit and description, and whether
/// it is read-only.
pub type ParameterParts<'py> = (
    String,
    Option<String>,
    Bound<'py, PyAny>,
    Option<f64>,
    Option<f64>,
    Vec<String>,
    String,
    String,
    bool,
);
/// The parameters that have another value, with the old and the new one, and who has changed them.
type ChangeParts<'py> = (Vec<(String, Bound<'py, PyAny>, Bound<'py, PyAny>)>, String);

#[pymethods]
impl ParameterDeclaration {
    /// Checks the parameters of a group. Raises `ParameterError`.
    #[new]
    fn new(py: Python<'_>, parameters: Vec<ParameterParts<'_>>) -> PyResult<Self> {
        let parameters = parameters.into_iter().map(parameter);
        let declaration = Declaration::new(parameters.collect::<PyResult<_>>()?);
        let declaration = declaration.map_err(|error| wrong(py, &error.to_string()))?;
        Ok(Self(declaration))
    }
}

#[pymethods]
impl ParameterGroup {
    /// Creates a group with the values of its file, if it has one. Returns what the program's user should know, too.
    #[staticmethod]
    fn open(
        py: Python<'_>,
        declaration: &ParameterDeclaration,
        file: Option<PathBuf>,
    ) -> (Self, Vec<String>) {
        let file = file.map(|path| ParametersFile::new(&path));
        let declaration = declaration.0.clone();
        let (core, warnings) = detached(py, || parameters::Group::new(declaration, file));
        let group = Self {
            core: Mutex::new(core),
            saving: Mutex::default(),
        };
        (group, warnings)
    }

    /// Returns the names of the parameters, in the order of their declaration.
    fn names(&self) -> Vec<String> {
        let group = lock(&self.core);
        let parameters = group.declaration().parameters().iter();
        parameters.map(|parameter| parameter.name.clone()).collect()
    }

    /// Returns the value of a parameter. Raises `AttributeError`.
    fn value<'py>(&self, py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyAny>> {
        let value = lock(&self.core).value(name).cloned();
        to_python(py, &value.map_err(PyAttributeError::new_err)?)
    }

    /// Returns all values.
    fn values<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let values = lock(&self.core).values().clone();
        self.dict(py, &values)
    }

    /// Returns what an order will change. `is_own`: it is the program's own. Raises `ParameterError`.
    fn propose(
        &self,
        py: Python<'_>,
        order: &ParameterOrder,
        is_own: bool,
    ) -> PyResult<ParameterProposal> {
        let proposal = lock(&self.core).propose(order.0.clone(), is_own);
        proposal
            .map(ParameterProposal)
            .map_err(|reason| wrong(py, &reason))
    }

    /// Returns all values as they will be.
    fn proposed<'py>(
        &self,
        py: Python<'py>,
        proposal: &ParameterProposal,
    ) -> PyResult<Bound<'py, PyDict>> {
        self.dict(py, &proposal.0.values)
    }

    /// Puts the proposed values into force. `robot`: the robot that has sent the order; `None` if it is the program's own.
    fn commit<'py>(
        &self,
        py: Python<'py>,
        proposal: &ParameterProposal,
        robot: Option<&str>,
    ) -> PyResult<Option<ChangeParts<'py>>> {
        let change = lock(&self.core).commit(&proposal.0, robot, Instant::now());
        change.map(|change| change_parts(py, &change)).transpose()
    }

    /// Returns the reply to an order that was carried out.
    fn in_force<'py>(&self, py: Python<'py>, proposal: &ParameterProposal) -> Parts<'py> {
        let reply = lock(&self.core).in_force(&proposal.0);
        parts(py, &reply)
    }

    /// The number of changes so far.
    #[getter]
    fn revision(&self) -> u64 {
        lock(&self.core).revision()
    }

    /// Returns the second reply to an order, once the values of that revision are stored or could not be.
    fn stored<'py>(&self, py: Python<'py>, revision: u64) -> Option<Parts<'py>> {
        let reply = lock(&self.core).stored(revision);
        reply.map(|reply| parts(py, &reply))
    }

    /// Returns what to do now: `publish` with a payload, `save`, or `wait` with the seconds until something is to be done (`None`: until
    /// something changes).
    fn work<'py>(&self, py: Python<'py>) -> (&'static str, Option<Parts<'py>>, Option<f64>) {
        let now = Instant::now();
        let work = lock(&self.core).work(now);
        match work {
            Work::Publish(values) => ("publish", Some(parts(py, &values)), None),
            Work::Save => ("save", None, None),
            Work::Wait(until) => {
                let seconds = until.map(|at| at.saturating_duration_since(now).as_secs_f64());
                ("wait", None, seconds)
            }
        }
    }

    /// Handles that the values could not be published.
    fn on_not_published(&self) {
        lock(&self.core).on_not_published(Instant::now());
    }

    /// Stores the values if they have changed. Returns a warning, if there is a new one.
    fn save(&self, py: Python<'_>) -> Option<String> {
        detached(py, || {
            let _alone = lock(&self.saving);
            let mut saving = lock(&self.core).begin_saving()?;
            saving.run();
            lock(&self.core).on_saved(saving, Instant::now())
        })
    }
}

impl ParameterGroup {
    /// Converts values. Python's collector may run meanwhile, and with it other code that uses the group: it is not locked.
    fn dict<'py>(
        &self,
        py: Python<'py>,
        values: &parameters::Values,
    ) -> PyResult<Bound<'py, PyDict>> {
        let declaration = lock(&self.core).declaration().clone();
        let all = PyDict::new(py);
        for (parameter, value) in values.of(&declaration) {
            all.set_item(&parameter.name, to_python(py, value)?)?;
        }
        Ok(all)
    }
}

#[pymethods]
impl ParameterOrder {
    /// Creates the order of a program. Raises `ParameterError`.
    #[new]
    #[pyo3(signature = (values, reset, stored=false, by=None))]
    fn new(
        py: Python<'_>,
        values: &Bound<'_, PyDict>,
        reset: ResetArgument,
        stored: bool,
        by: Option<&str>,
    ) -> PyResult<Self> {
        let mut order = Order {
            reset: match reset {
                ResetArgument::All(all) => Reset::All(all),
                ResetArgument::Some(names) => Reset::Some(names),
            },
            stored,
            by: by.unwrap_or_default().to_owned(),
            ..Order::default()
        };
        for (name, value) in values.iter() {
            let Ok(name) = name.extract::<String>() else {
                return Err(wrong(
                    py,
                    &format!("the names of parameters are texts, not {name}"),
                ));
            };
            let value = from_python(&name, &value)?;
            order.set.insert(name, value);
        }
        Ok(Self(order))
    }

    /// Reads the order of another program. Raises `ParameterError`.
    #[staticmethod]
    fn read(py: Python<'_>, bytes: PyBackedBytes, encoding: &str) -> PyResult<Self> {
        let order = Order::read(&payload(bytes, encoding));
        order.map(Self).map_err(|reason| wrong(py, &reason))
    }

    /// Whether a second reply shall say when the values are stored.
    #[getter]
    fn stored(&self) -> bool {
        self.0.stored
    }

    /// Returns the request with the order.
    fn payload<'py>(&self, py: Python<'py>) -> Parts<'py> {
        parts(py, &to_cbor(&self.0))
    }
}

/// The parameters that get their defaults.
#[derive(FromPyObject)]
enum ResetArgument {
    All(bool),
    Some(Vec<String>),
}

/// Returns the topic of the values of a group.
#[pyfunction]
pub fn parameters_topic(group: &str) -> String {
    parameters::topic(group)
}

/// Returns the path of the file of a group, unless there is no folder for it.
#[pyfunction]
pub fn parameters_file(robot: &str, group: &str) -> Option<PathBuf> {
    file::path(robot, group, |name| std::env::var_os(name))
}

/// Returns the error that a robot has no such group of parameters.
#[pyfunction]
pub fn no_parameters(robot: &str, group: &str, available: Vec<String>) -> PyResult<String> {
    Ok(names::no_parameters(&name(robot)?, group, &available))
}

/// Converts a declaration of another program to Python objects.
pub fn declaration_parts<'py>(
    py: Python<'py>,
    declaration: &Declaration,
) -> PyResult<Vec<ParameterParts<'py>>> {
    let parameters = declaration.parameters().iter().cloned();
    let parts = parameters.map(|parameter| {
        let default = to_python(py, &parameter.default)?;
        let kind = kind_name(parameter.kind);
        Ok((
            parameter.name,
            Some(kind.to_owned()),
            default,
            parameter.min,
            parameter.max,
            parameter.choices,
            parameter.unit,
            parameter.about,
            parameter.read_only,
        ))
    });
    parts.collect()
}

fn parameter(parts: ParameterParts<'_>) -> PyResult<Parameter> {
    let (name, kind, default, min, max, choices, unit, about, read_only) = parts;
    let parameter = Parameter::new(&name, from_python(&name, &default)?);
    let kind = match kind {
        Some(kind) => kind_of(default.py(), &kind)?,
        None => parameter.kind,
    };
    Ok(Parameter {
        kind,
        min,
        max,
        choices,
        unit,
        about,
        read_only,
        ..parameter
    })
}

fn kind_of(py: Python<'_>, name: &str) -> PyResult<Kind> {
    let kind = Kind::deserialize(name.into_deserializer());
    kind.map_err(|error: serde::de::value::Error| wrong(py, &error.to_string()))
}

fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Bool => "bool",
        Kind::Integer => "integer",
        Kind::Number => "number",
        Kind::Text => "text",
        Kind::Choice => "choice",
        Kind::Numbers => "numbers",
    }
}

fn change_parts<'py>(py: Python<'py>, change: &Change) -> PyResult<ChangeParts<'py>> {
    let changed = change.changed.iter().map(|changed| {
        let (old, new) = (to_python(py, &changed.old)?, to_python(py, &changed.new)?);
        Ok((changed.name.clone(), old, new))
    });
    Ok((changed.collect::<PyResult<_>>()?, change.by.clone()))
}

/// Converts a value of Python, also one of numpy.
fn from_python(name: &str, value: &Bound<'_, PyAny>) -> PyResult<Value> {
    let converted = value::plain(value).ok().and_then(parameter_value);
    converted.ok_or_else(|| {
        let found = value.get_type().name().map(|name| name.to_string());
        let found = found.unwrap_or_default();
        let reason = format!(
            "{name} cannot be of the type {found}: use bool, int, float, str or a list of numbers"
        );
        wrong(value.py(), &reason)
    })
}

fn parameter_value(value: Plain) -> Option<Value> {
    Some(match value {
        Plain::Bool(truth) => Value::Bool(truth),
        Plain::Int(number) => Value::Integer(number),
        Plain::Float(number) => Value::Number(number),
        Plain::Text(text) => Value::Text(text),
        #[allow(clippy::cast_precision_loss)] // Nobody means more digits.
        Plain::List(items) => {
            let numbers = items.into_iter().map(|item| match item {
                Plain::Float(number) => Some(number),
                Plain::Int(number) => Some(number as f64),
                _ => None,
            });
            Value::Numbers(numbers.collect::<Option<_>>()?)
        }
        _ => return None,
    })
}

fn to_python<'py>(py: Python<'py>, value: &Value) -> PyResult<Bound<'py, PyAny>> {
    match value {
        Value::Bool(truth) => truth.into_bound_py_any(py),
        Value::Integer(number) => number.into_bound_py_any(py),
        Value::Number(number) => Ok(PyFloat::new(py, *number).into_any()),
        Value::Text(text) => text.into_bound_py_any(py),
        Value::Numbers(numbers) => numbers.into_bound_py_any(py),
    }
}

fn wrong(py: Python<'_>, reason: &str) -> PyErr {
    raised(py, "ParameterError", (reason,))
}
