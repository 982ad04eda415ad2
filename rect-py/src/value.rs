//! Converts Python values (dicts, lists, dataclasses and so on) to JSON or CBOR, and back.
use std::{collections::HashSet, fmt};

use pyo3::{
    exceptions::PyTypeError,
    prelude::*,
    pybacked::PyBackedBytes,
    types::{
        PyBool, PyByteArray, PyBytes, PyDate, PyDelta, PyDict, PyFloat, PyFrozenSet, PyInt, PyList,
        PySet, PyString, PyTime, PyTuple,
    },
};
use rect_core::{
    cause::Cause,
    message::{
        encoding::EncodingKind,
        payload::{Cbor, Json, PayloadError, ToPayload, MAX_DEPTH},
    },
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
#[derive(Clone)]
pub enum Value {
    Null,
    Bool(bool),
    Int(i64),
    Unsigned(u64),
    /// An integer of more than 64 bits, which only CBOR has.
    Big(i128),
    /// One that needs all 128 bits.
    Huge(u128),
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
    let payload = payload(bytes, encoding);
    let value: Value = payload.value().or_raise()?;
    if payload.encoding.kind() == EncodingKind::Json && value.is_rounded(&payload.bytes) {
        return exact(py, &payload.bytes);
    }
    value.into_python(py)
}

/// Decodes JSON with integers of more than 64 bits, which are valid. Python's own parser keeps all their digits, but takes longer.
fn exact<'py>(py: Python<'py>, json: &[u8]) -> PyResult<Bound<'py, PyAny>> {
    let loads = PyModule::import(py, "json")?.getattr("loads")?;
    loads.call1((PyBytes::new(py, json),)).map_err(|error| {
        let reason = Cause::new(error.value(py).to_string());
        let format = Form::Json.name();
        let error = PayloadError::Read { format, reason };
        raised(py, "PayloadError", (error.to_string(), "read"))
    })
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
        return read_integer(value, form, path);
    }
    if let Ok(map) = value.cast::<PyDict>() {
        return read_map(map, form, path);
    }
    if let Ok(list) = value.cast::<PyList>() {
        return read_list(list.iter(), form, path);
    }
    if let Ok(tuple) = value.cast::<PyTuple>() {
        return read_list(tuple.iter(), form, path);
    }
    read_other(value, form, path)
}

fn read_integer<'py>(
    value: &Bound<'py, PyAny>,
    form: Form,
    path: &mut Path<'py>,
) -> PyResult<Value> {
    let short = value.extract().map(Value::Int);
    let short = short.or_else(|_| value.extract().map(Value::Unsigned));
    short.or_else(|_| match form {
        Form::Json => {
            let reason = "is an integer of more than 64 bits, which most programs cannot read in JSON: send it as text, or use rect.Cbor";
            Err(path.error(value.py(), form, reason))
        }
        Form::Cbor => {
            let long = value.extract().map(Value::Big);
            let long = long.or_else(|_| value.extract().map(Value::Huge));
            let reason = "is an integer of more than 128 bits: send it as text";
            long.map_err(|_| path.error(value.py(), form, reason))
        }
    })
}

fn read_map<'py>(map: &Bound<'py, PyDict>, form: Form, path: &mut Path<'py>) -> PyResult<Value> {
    let mut all = Vec::with_capacity(map.len());
    let mut is_text = true;
    for (key, item) in map.iter() {
        let name = read_key(&key, form, path)?;
        is_text &= key.is_instance_of::<PyString>();
        path.0.push(Step::Key(key));
        all.push((name, read(&item, form, path)?));
        path.0.pop();
    }
    // JSON has only texts as keys.
    if form == Form::Json && !is_text {
        let mut seen = HashSet::new();
        let names = all.iter().map(|(name, _)| name.as_key());
        if let Some(twice) = names.into_iter().find(|name| !seen.insert(name.clone())) {
            let reason =
                format!("has the key {twice} twice, as text and as another type: use rect.Cbor");
            return Err(path.error(map.py(), form, reason));
        }
    }
    Ok(Value::Map(all))
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
    if value.is_instance_of::<PyDate>() || value.is_instance_of::<PyTime>() {
        return read_time(&value.call_method0("isoformat")?, form, path);
    }
    if value.is_instance_of::<PyDelta>() {
        let reason = "is a duration: send a number, such as value.total_seconds()";
        return Err(path.error(py, form, reason));
    }
    if value.is_instance_of::<PySet>() || value.is_instance_of::<PyFrozenSet>() {
        let items = value.try_iter()?.collect::<PyResult<Vec<_>>>()?;
        return read_list(items.into_iter(), form, path);
    }
    let is_numpy = value.hasattr("dtype")? && value.hasattr("tolist")?;
    if is_numpy {
        if let Some(read) = read_by_dtype(value, form, path)? {
            return Ok(read);
        }
        let plain = value.call_method0("tolist")?;
        if !plain.get_type().is(&class) {
            return read(&plain, form, path);
        }
    }
    let reason = format!(
        "is of the type {}; possible types: dict, list, tuple, set, str, int, float, bool, None, datetime, date, time, Enum, dataclasses, and models of pydantic and msgspec",
        class.name()?
    );
    Err(path.error(py, form, reason))
}

/// Converts what `tolist` of numpy would change: records, which would lose the names of their fields, and times, which would lose
/// their unit. Returns `None` for everything else.
fn read_by_dtype<'py>(
    value: &Bound<'py, PyAny>,
    form: Form,
    path: &mut Path<'py>,
) -> PyResult<Option<Value>> {
    let py = value.py();
    let dtype = value.getattr("dtype")?;
    let names = dtype.getattr_opt("names")?.filter(|names| !names.is_none());
    let kind = match dtype.getattr_opt("kind")? {
        Some(kind) => kind.str()?.to_string(),
        None => String::new(),
    };
    let is_time = kind == "M" || kind == "m";
    if names.is_none() && !is_time {
        return Ok(None);
    }
    let dimensions: usize = match value.getattr_opt("ndim")? {
        Some(dimensions) => dimensions.extract()?,
        None => 0,
    };
    if dimensions > 0 {
        let items = value.try_iter()?.collect::<PyResult<Vec<_>>>()?;
        return read_list(items.into_iter(), form, path).map(Some);
    }
    let Some(names) = names else {
        if kind == "m" {
            let reason = "is a duration: send a number, such as value / numpy.timedelta64(1, 's')";
            return Err(path.error(py, form, reason));
        }
        return read_time(value.str()?.as_any(), form, path).map(Some);
    };
    let mut all = Vec::new();
    for name in names.try_iter()? {
        let name = name?;
        let item = value.get_item(&name)?;
        let key = read(&name, form, path)?;
        path.0.push(Step::Key(name));
        all.push((key, read(&item, form, path)?));
        path.0.pop();
    }
    Ok(Some(Value::Map(all)))
}

/// Converts the text of a time, according to ISO 8601.
fn read_time<'py>(text: &Bound<'py, PyAny>, form: Form, path: &mut Path<'py>) -> PyResult<Value> {
    match read(text, form, path)? {
        Value::Text(time) if time == "NaT" => {
            Err(path.error(text.py(), form, "is NaT, which is not a time: send None"))
        }
        time => Ok(time),
    }
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
    let name = read(key, form, path);
    let possible = match (form, &name) {
        (_, Ok(Value::Text(_) | Value::Int(_) | Value::Unsigned(_))) => return name,
        (Form::Cbor, Ok(name)) if name.is_hashable() => return Ok(name.clone()),
        (Form::Json, _) => "str or int in JSON",
        (Form::Cbor, _) => "values without a dict in CBOR",
    };
    let reason = format!("has the key {}; keys must be {possible}", shown(key));
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
            Self::Big(number) => number.into_pyobject(py)?.into_any(),
            Self::Huge(number) => number.into_pyobject(py)?.into_any(),
            Self::Float(number) => PyFloat::new(py, number).into_any(),
            Self::Text(text) => PyString::new(py, &text).into_any(),
            Self::Bytes(bytes) => PyBytes::new(py, &bytes).into_any(),
            Self::List(items) => {
                let items = items.into_iter().map(|item| item.into_python(py));
                PyList::new(py, items.collect::<PyResult<Vec<_>>>()?)?.into_any()
            }
            Self::Map(items) => {
                let map = PyDict::new(py);
                let length = items.len();
                let is_text = items.iter().all(|(key, _)| matches!(key, Self::Text(_)));
                for (key, item) in items {
                    let key = key.into_key(py)?;
                    map.set_item(&key, item.into_python(py)?)
                        .map_err(|error| unhashable(py, &key, error))?;
                }
                // For Python, 1, 1.0 and True are one key.
                if !is_text && map.len() < length {
                    let reason = "keys of a map are equal";
                    return Err(unread(py, reason.to_owned()));
                }
                map.into_any()
            }
        })
    }

    /// Converts a key of a map: a list becomes a tuple, since a dict cannot have a list as a key.
    fn into_key(self, py: Python<'_>) -> PyResult<Bound<'_, PyAny>> {
        let Self::List(items) = self else {
            return self.into_python(py);
        };
        let items = items.into_iter().map(|item| item.into_key(py));
        Ok(PyTuple::new(py, items.collect::<PyResult<Vec<_>>>()?)?.into_any())
    }

    /// Returns whether a dict of Python can have this key.
    fn is_hashable(&self) -> bool {
        match self {
            Self::Map(_) => false,
            Self::List(items) => items.iter().all(Self::is_hashable),
            _ => true,
        }
    }

    /// Returns the key as JSON has it.
    fn as_key(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Int(number) => number.to_string(),
            Self::Unsigned(number) => number.to_string(),
            _ => String::new(),
        }
    }

    /// Returns whether a number of this value may be an integer of more than 64 bits, of which digits are lost.
    fn is_rounded(&self, json: &[u8]) -> bool {
        self.has_large()
            && json
                .windows(DIGITS)
                .any(|run| run.iter().all(u8::is_ascii_digit))
    }

    fn has_large(&self) -> bool {
        match self {
            Self::Float(number) => number.abs() >= i64::MAX as f64,
            Self::List(items) => items.iter().any(Self::has_large),
            Self::Map(items) => items.iter().any(|(_, item)| item.has_large()),
            _ => false,
        }
    }
}

/// The number of digits of the smallest integer that 64 bits cannot hold.
const DIGITS: usize = 19;

/// Replaces the `TypeError` for a key that a dict cannot have, such as a list.
fn unhashable(py: Python<'_>, key: &Bound<'_, PyAny>, error: PyErr) -> PyErr {
    if !error.is_instance_of::<PyTypeError>(py) {
        return error;
    }
    unread(py, format!("the key {} is not hashable", shown(key)))
}

fn unread(py: Python<'_>, reason: String) -> PyErr {
    let error = PayloadError::Read {
        format: Form::Cbor.name(),
        reason: Cause::new(reason),
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
            Self::Big(number) => serializer.serialize_i128(*number),
            Self::Huge(number) => serializer.serialize_u128(*number),
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

    fn visit_i128<E>(self, number: i128) -> Result<Value, E> {
        Ok(Value::Big(number))
    }

    fn visit_u128<E>(self, number: u128) -> Result<Value, E> {
        Ok(Value::Huge(number))
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
