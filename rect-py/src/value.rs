//! Converts Python values (dicts, lists, dataclasses and so on) to JSON or CBOR, and back.
use std::fmt;

use pyo3::{
    exceptions::PyTypeError,
    prelude::*,
    pybacked::PyBackedBytes,
    types::{
        PyBool, PyByteArray, PyBytes, PyDateTime, PyDict, PyFloat, PyFrozenSet, PyInt, PyList,
        PySet, PyString, PyTuple,
    },
};
use rect_core::{
    cause::Cause,
    message::payload::{Cbor, Json, PayloadError, ToPayload, MAX_DEPTH},
};
use serde::{
    de::{MapAccess, SeqAccess, Visitor},
    ser::{SerializeMap, SerializeSeq},
    Deserialize, Deserializer, Serialize, Serializer,
};

use crate::{
    codec::{parts, payload, Parts},
    errors::{raised, OrRaise},
};

/// A value of JSON or CBOR.
pub enum Value {
    Null,
    Bool(bool),
    Int(i64),
    Unsigned(u64),
    Float(f64),
    Text(String),
    Bytes(Vec<u8>),
    List(Vec<Value>),
    Map(Vec<(Value, Value)>),
}

/// The format of a value.
#[derive(Clone, Copy, PartialEq)]
enum Form {
    Json,
    Cbor,
}

impl Form {
    fn name(self) -> &'static str {
        match self {
            Self::Json => "JSON",
            Self::Cbor => "CBOR",
        }
    }
}

/// Encodes a value as JSON or CBOR. Returns the bytes and the encoding. Raises `PayloadError`.
#[pyfunction]
#[pyo3(signature = (value, cbor=false))]
pub fn write_value<'py>(value: &Bound<'py, PyAny>, cbor: bool) -> PyResult<Parts<'py>> {
    let form = if cbor { Form::Cbor } else { Form::Json };
    let mut path = Path::default();
    let converted = read(value, form, &mut path)?;
    let payload = match form {
        Form::Json => Json(&converted).to_payload(),
        Form::Cbor => Cbor(&converted).to_payload(),
    };
    Ok(parts(value.py(), &payload.or_raise()?))
}

/// Decodes a value from JSON or CBOR, according to its encoding. Raises `PayloadError`.
#[pyfunction]
pub fn read_value<'py>(
    py: Python<'py>,
    bytes: PyBackedBytes,
    encoding: &str,
) -> PyResult<Bound<'py, PyAny>> {
    let value: Value = payload(bytes, encoding).value().or_raise()?;
    value.into_python(py)
}

/// Converts a value of Python. Raises `PayloadError`.
pub fn plain(value: &Bound<'_, PyAny>) -> PyResult<Value> {
    read(value, Form::Cbor, &mut Path::default())
}

/// The path to a part of a value, for error messages: `reading.angles[2]`.
#[derive(Default)]
struct Path<'py>(Vec<Step<'py>>);

enum Step<'py> {
    Key(Bound<'py, PyAny>),
    Item(usize),
}

impl Path<'_> {
    fn error(&self, py: Python<'_>, form: Form, reason: impl fmt::Display) -> PyErr {
        let steps = self.0.iter().map(|step| match step {
            Step::Key(key) => format!(".{}", shown(key)),
            Step::Item(n) => format!("[{n}]"),
        });
        let at = match steps.collect::<String>() {
            at if at.is_empty() => "the value".to_owned(),
            at => format!("its field {}", at.trim_start_matches('.')),
        };
        let error = PayloadError::Write {
            format: form.name(),
            reason: Cause::new(format!("{at} {reason}")),
        };
        raised(py, "PayloadError", (error.to_string(), "write"))
    }
}

fn read<'py>(value: &Bound<'py, PyAny>, form: Form, path: &mut Path<'py>) -> PyResult<Value> {
    if path.0.len() >= MAX_DEPTH {
        path.0.truncate(3);
        return Err(path.error(value.py(), form, "is nested too deeply, or contains itself"));
    }
    if value.is_none() {
        return Ok(Value::Null);
    }
    if let Ok(text) = value.cast::<PyString>() {
        let text = text.to_cow();
        let text = text.map_err(|_| path.error(value.py(), form, "is text that is not UTF-8"))?;
        return Ok(Value::Text(text.into_owned()));
    }
    if let Ok(truth) = value.cast::<PyBool>() {
        return Ok(Value::Bool(truth.is_true()));
    }
    if value.is_instance_of::<PyFloat>() {
        let number: f64 = value.extract()?;
        if form == Form::Json && !number.is_finite() {
            let reason =
                format!("is {number}, which JSON cannot represent: send None, or use rect.Cbor");
            return Err(path.error(value.py(), form, reason));
        }
        return Ok(Value::Float(number));
    }
    if value.is_instance_of::<PyInt>() {
        return value
            .extract()
            .map(Value::Int)
            .or_else(|_| value.extract().map(Value::Unsigned))
            .map_err(|_| path.error(value.py(), form, "is an integer of more than 64 bits"));
    }
    if let Ok(map) = value.cast::<PyDict>() {
        let mut all = Vec::with_capacity(map.len());
        for (key, item) in map.iter() {
            let name = read_key(&key, form, path)?;
            path.0.push(Step::Key(key));
            all.push((name, read(&item, form, path)?));
            path.0.pop();
        }
        return Ok(Value::Map(all));
    }
    if let Ok(list) = value.cast::<PyList>() {
        return read_list(list.iter(), form, path);
    }
    if let Ok(tuple) = value.cast::<PyTuple>() {
        return read_list(tuple.iter(), form, path);
    }
    read_other(value, form, path)
}

/// Converts less common values: bytes, dataclasses, models, members of an Enum, times, sets, and numbers and arrays of numpy.
fn read_other<'py>(value: &Bound<'py, PyAny>, form: Form, path: &mut Path<'py>) -> PyResult<Value> {
    let py = value.py();
    let bytes = if let Ok(bytes) = value.cast::<PyBytes>() {
        Some(bytes.as_bytes().to_vec())
    } else if let Ok(bytes) = value.cast::<PyByteArray>() {
        Some(bytes.to_vec())
    } else {
        None
    };
    if let Some(bytes) = bytes {
        return match form {
            Form::Cbor => Ok(Value::Bytes(bytes)),
            Form::Json => {
                let reason = "is bytes, which JSON cannot represent: use rect.Cbor";
                Err(path.error(py, form, reason))
            }
        };
    }
    let class = value.get_type();
    if let Ok(fields) = class.getattr("__dataclass_fields__") {
        return read_fields(
            value,
            fields.cast_into::<PyDict>()?.keys().iter(),
            form,
            path,
        );
    }
    // Models of msgspec and pydantic, members of an Enum, and times.
    if let Ok(fields) = class.getattr("__struct_fields__") {
        return read_fields(value, fields.cast_into::<PyTuple>()?.iter(), form, path);
    }
    if class.hasattr("model_dump")? {
        return read(&value.call_method0("model_dump")?, form, path);
    }
    if class.hasattr("__members__")? {
        return read(&value.getattr("value")?, form, path);
    }
    if value.is_instance_of::<PyDateTime>() {
        return read(&value.call_method0("isoformat")?, form, path);
    }
    if value.is_instance_of::<PySet>() || value.is_instance_of::<PyFrozenSet>() {
        let items = value.try_iter()?.collect::<PyResult<Vec<_>>>()?;
        return read_list(items.into_iter(), form, path);
    }
    let is_numpy = value.hasattr("dtype")? && value.hasattr("tolist")?;
    if is_numpy {
        let plain = value.call_method0("tolist")?;
        if !plain.get_type().is(&class) {
            return read(&plain, form, path);
        }
    }
    let reason = format!(
        "is of the type {}; possible types: dict, list, tuple, set, str, int, float, bool, None, datetime, Enum, dataclasses, and models of pydantic and msgspec",
        class.name()?
    );
    Err(path.error(py, form, reason))
}

/// Converts an object with fields of these names.
fn read_fields<'py>(
    value: &Bound<'py, PyAny>,
    names: impl Iterator<Item = Bound<'py, PyAny>>,
    form: Form,
    path: &mut Path<'py>,
) -> PyResult<Value> {
    let mut all = Vec::new();
    for name in names {
        let name = name.cast_into::<PyString>()?;
        // Class variables of a dataclass are listed, too, but the instance may lack them.
        let Ok(item) = value.getattr(&name) else {
            continue;
        };
        let key = Value::Text(name.to_string());
        path.0.push(Step::Key(name.into_any()));
        all.push((key, read(&item, form, path)?));
        path.0.pop();
    }
    Ok(Value::Map(all))
}

fn read_list<'py>(
    items: impl Iterator<Item = Bound<'py, PyAny>>,
    form: Form,
    path: &mut Path<'py>,
) -> PyResult<Value> {
    let mut all = Vec::new();
    for (n, item) in items.enumerate() {
        path.0.push(Step::Item(n));
        all.push(read(&item, form, path)?);
        path.0.pop();
    }
    Ok(Value::List(all))
}

fn read_key<'py>(key: &Bound<'py, PyAny>, form: Form, path: &mut Path<'py>) -> PyResult<Value> {
    let is_text = key.is_instance_of::<PyString>();
    let is_number = key.is_instance_of::<PyInt>() && !key.is_instance_of::<PyBool>();
    if is_text || is_number || form == Form::Cbor {
        return read(key, form, path);
    }
    let reason = format!(
        "has the key {}; keys must be str or int in JSON",
        shown(key)
    );
    Err(path.error(key.py(), form, reason))
}

fn shown(key: &Bound<'_, PyAny>) -> String {
    let text = key.str().map(|text| text.to_string());
    text.unwrap_or_default().chars().take(60).collect()
}

impl Value {
    fn into_python(self, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        Ok(match self {
            Self::Null => py.None().into_bound(py),
            Self::Bool(truth) => PyBool::new(py, truth).to_owned().into_any(),
            Self::Int(number) => number.into_pyobject(py)?.into_any(),
            Self::Unsigned(number) => number.into_pyobject(py)?.into_any(),
            Self::Float(number) => PyFloat::new(py, number).into_any(),
            Self::Text(text) => PyString::new(py, &text).into_any(),
            Self::Bytes(bytes) => PyBytes::new(py, &bytes).into_any(),
            Self::List(items) => {
                let items = items.into_iter().map(|item| item.into_python(py));
                PyList::new(py, items.collect::<PyResult<Vec<_>>>()?)?.into_any()
            }
            Self::Map(items) => {
                let map = PyDict::new(py);
                for (key, item) in items {
                    let key = key.into_python(py)?;
                    map.set_item(&key, item.into_python(py)?)
                        .map_err(|error| unhashable(py, &key, error))?;
                }
                map.into_any()
            }
        })
    }
}

/// Replaces the `TypeError` for a key that a dict cannot have, such as a list.
fn unhashable(py: Python<'_>, key: &Bound<'_, PyAny>, error: PyErr) -> PyErr {
    if !error.is_instance_of::<PyTypeError>(py) {
        return error;
    }
    let error = PayloadError::Read {
        format: "CBOR",
        reason: Cause::new(format!("the key {} is not hashable", shown(key))),
    };
    raised(py, "PayloadError", (error.to_string(), "read"))
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Null => serializer.serialize_unit(),
            Self::Bool(truth) => serializer.serialize_bool(*truth),
            Self::Int(number) => serializer.serialize_i64(*number),
            Self::Unsigned(number) => serializer.serialize_u64(*number),
            Self::Float(number) => serializer.serialize_f64(*number),
            Self::Text(text) => serializer.serialize_str(text),
            Self::Bytes(bytes) => serializer.serialize_bytes(bytes),
            Self::List(items) => {
                let mut list = serializer.serialize_seq(Some(items.len()))?;
                items
                    .iter()
                    .try_for_each(|item| list.serialize_element(item))?;
                list.end()
            }
            Self::Map(items) => {
                let mut map = serializer.serialize_map(Some(items.len()))?;
                let mut items = items.iter();
                items.try_for_each(|(key, item)| map.serialize_entry(key, item))?;
                map.end()
            }
        }
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Reading)
    }
}

struct Reading;

impl<'de> Visitor<'de> for Reading {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_none<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        Value::deserialize(deserializer)
    }

    fn visit_bool<E>(self, truth: bool) -> Result<Value, E> {
        Ok(Value::Bool(truth))
    }

    fn visit_i64<E>(self, number: i64) -> Result<Value, E> {
        Ok(Value::Int(number))
    }

    fn visit_u64<E>(self, number: u64) -> Result<Value, E> {
        Ok(Value::Unsigned(number))
    }

    fn visit_f64<E>(self, number: f64) -> Result<Value, E> {
        Ok(Value::Float(number))
    }

    fn visit_str<E>(self, text: &str) -> Result<Value, E> {
        Ok(Value::Text(text.to_owned()))
    }

    fn visit_string<E>(self, text: String) -> Result<Value, E> {
        Ok(Value::Text(text))
    }

    fn visit_bytes<E>(self, bytes: &[u8]) -> Result<Value, E> {
        Ok(Value::Bytes(bytes.to_vec()))
    }

    fn visit_byte_buf<E>(self, bytes: Vec<u8>) -> Result<Value, E> {
        Ok(Value::Bytes(bytes))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut all = Vec::new();
        while let Some(item) = items.next_element()? {
            all.push(item);
        }
        Ok(Value::List(all))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut items: A) -> Result<Value, A::Error> {
        let mut all = Vec::new();
        while let Some(item) = items.next_entry()? {
            all.push(item);
        }
        Ok(Value::Map(all))
    }
}
