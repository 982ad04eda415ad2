//! Converts the values of parameters between C and the library.
use std::{
    collections::BTreeMap,
    ffi::{c_char, CStr},
    sync::Arc,
};

use rect::ParameterValue as Value;
use rect_core::parameters::Declaration;

use crate::{
    argument::{items, utf8},
    failure::Failure,
    handle::{self, Object},
    text::{choice, Text},
};

/// The type of the value of a parameter.
#[repr(C)]
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum ParameterType {
    /// Yes or no.
    Bool = 0,
    /// An integer.
    Integer = 1,
    /// A finite number.
    Number = 2,
    /// A text, or the choice from a list of texts.
    Text = 3,
    /// A list of finite numbers.
    Numbers = 4,
}

const TYPES: [(u32, ParameterType); 5] = [
    (ParameterType::Bool as u32, ParameterType::Bool),
    (ParameterType::Integer as u32, ParameterType::Integer),
    (ParameterType::Number as u32, ParameterType::Number),
    (ParameterType::Text as u32, ParameterType::Text),
    (ParameterType::Numbers as u32, ParameterType::Numbers),
];

/// The name and the value of a parameter. `rect_parameter_number("kp", 2.0)` makes one of a number, and similar functions of the other
/// types.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ParameterValue {
    /// The name of the parameter.
    pub name: Text,
    /// The type of the value: a `rect_parameter_type`.
    pub kind: u32,
    /// The value of a bool.
    pub boolean: bool,
    /// The value of an integer.
    pub integer: i64,
    /// The value of a number or an integer.
    pub number: f64,
    /// The value of a text or a choice.
    pub text: Text,
    /// The first number of a list.
    pub numbers: *const f64,
    /// Number of elements of the list.
    pub numbers_len: usize,
}

/// The values of parameters. Those that a function returns have an `id`, and are valid until `rect_drop(&values.id, ..)`. Those that are
/// passed to a callback have no `id`, and are valid until the callback returns. `rect_parameter_find` finds one.
#[repr(C)]
pub struct ParameterValues {
    /// The handle; 0 in a callback.
    pub id: u64,
    /// The first value.
    pub items: *const ParameterValue,
    /// Number of values.
    pub len: usize,
}

struct OwnedValues {
    _values: Arc<BTreeMap<String, Value>>,
    _views: Vec<ParameterValue>,
}

// SAFETY: the views point into the values stored next to them, which never change.
unsafe impl Send for OwnedValues {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedValues {}

impl Object for OwnedValues {
    const KIND: &'static str = "values of parameters";
}

impl ParameterValue {
    const NONE: Self = Self {
        name: Text::NONE,
        kind: ParameterType::Bool as u32,
        boolean: false,
        integer: 0,
        number: 0.0,
        text: Text::NONE,
        numbers: std::ptr::null(),
        numbers_len: 0,
    };

    /// Points to a value, which must outlive the result.
    pub fn of(name: &str, value: &Value) -> Self {
        let none = Self {
            name: Text::of(name),
            ..Self::NONE
        };
        match value {
            Value::Bool(boolean) => none.with_bool(*boolean),
            Value::Integer(integer) => none.with_integer(*integer),
            Value::Number(number) => none.with_number(*number),
            Value::Text(text) => none.with_text(Text::of(text)),
            Value::Numbers(numbers) => none.with_numbers(numbers.as_ptr(), numbers.len()),
        }
    }

    fn with_bool(self, boolean: bool) -> Self {
        let kind = ParameterType::Bool as u32;
        Self {
            kind,
            boolean,
            ..self
        }
    }

    fn with_integer(self, integer: i64) -> Self {
        Self {
            kind: ParameterType::Integer as u32,
            integer,
            number: integer as f64,
            ..self
        }
    }

    fn with_number(self, number: f64) -> Self {
        let kind = ParameterType::Number as u32;
        Self {
            kind,
            number,
            ..self
        }
    }

    fn with_text(self, text: Text) -> Self {
        let kind = ParameterType::Text as u32;
        Self { kind, text, ..self }
    }

    fn with_numbers(self, numbers: *const f64, numbers_len: usize) -> Self {
        Self {
            kind: ParameterType::Numbers as u32,
            numbers,
            numbers_len,
            ..self
        }
    }

    /// Copies the name and the value for the library.
    ///
    /// # Safety
    /// The pointers follow the rules of rect.h.
    unsafe fn read(&self) -> Result<(String, Value), Failure> {
        let kind = choice("values.kind", &TYPES, self.kind)?;
        // SAFETY: guaranteed by this function's caller.
        unsafe {
            let value = match kind {
                ParameterType::Bool => Value::Bool(self.boolean),
                ParameterType::Integer => Value::Integer(self.integer),
                ParameterType::Number => Value::Number(self.number),
                ParameterType::Text => Value::Text(owned("values.text", self.text)?),
                ParameterType::Numbers => {
                    let numbers = items("values.numbers", self.numbers, self.numbers_len)?;
                    Value::Numbers(numbers.to_vec())
                }
            };
            Ok((owned("values.name", self.name)?, value))
        }
    }
}

/// Copies a text.
///
/// # Safety
/// The text follows the rules of rect.h.
unsafe fn owned(name: &'static str, text: Text) -> Result<String, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let bytes = unsafe { items(name, text.data, text.len) }?;
    Ok(utf8(name, bytes)?.to_owned())
}

impl ParameterValues {
    /// Points to values, which must outlive the result, for a callback.
    pub fn of(views: &[ParameterValue]) -> Self {
        Self {
            id: 0,
            items: views.as_ptr(),
            len: views.len(),
        }
    }
}

/// Points to the values of a group, in the order of its declaration.
pub fn views(declaration: &Declaration, values: &BTreeMap<String, Value>) -> Vec<ParameterValue> {
    let parameters = declaration.parameters().iter();
    let found = parameters.filter_map(|parameter| values.get_key_value(&parameter.name));
    found
        .map(|(name, value)| ParameterValue::of(name, value))
        .collect()
}

/// Moves values into the handle table and returns their C form, in the order of the declaration if there is one.
pub fn into_c(
    values: Arc<BTreeMap<String, Value>>,
    declaration: Option<&Declaration>,
) -> ParameterValues {
    let views = match declaration {
        Some(declaration) => views(declaration, &values),
        None => values
            .iter()
            .map(|(name, value)| ParameterValue::of(name, value))
            .collect(),
    };
    let view = ParameterValues::of(&views);
    let id = handle::insert(OwnedValues {
        _values: values,
        _views: views,
    });
    ParameterValues { id, ..view }
}

/// Copies values for the library.
///
/// # Safety
/// `first` is NULL, or points to `len` values that follow the rules of rect.h.
pub unsafe fn read(
    first: *const ParameterValue,
    len: usize,
) -> Result<Vec<(String, Value)>, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let values = unsafe { items("values", first, len) }?;
    // SAFETY: as above.
    values.iter().map(|value| unsafe { value.read() }).collect()
}

/// Points to a text with a terminating zero byte.
///
/// # Safety
/// `text` is NULL, or such a text.
unsafe fn of_c(text: *const c_char) -> Text {
    if text.is_null() {
        return Text::NONE;
    }
    // SAFETY: the pointer is not NULL, and this function's caller guarantees the rest.
    let len = unsafe { CStr::from_ptr(text) }.count_bytes();
    Text {
        data: text.cast(),
        len,
    }
}

/// # Safety
/// The same as for [`of_c`].
unsafe fn named(name: *const c_char) -> ParameterValue {
    ParameterValue {
        // SAFETY: guaranteed by this function's caller.
        name: unsafe { of_c(name) },
        ..ParameterValue::NONE
    }
}

/// Makes the value of a parameter that is a bool. It points to `name`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_bool(name: *const c_char, value: bool) -> ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { named(name) }.with_bool(value)
}

/// Makes the value of a parameter that is an integer. It points to `name`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_integer(name: *const c_char, value: i64) -> ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { named(name) }.with_integer(value)
}

/// Makes the value of a parameter that is a number. It points to `name`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_number(name: *const c_char, value: f64) -> ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { named(name) }.with_number(value)
}

/// Makes the value of a parameter that is a text or a choice. It points to `name` and `value`, which must outlive it. NULL is an empty
/// text.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_text(
    name: *const c_char,
    value: *const c_char,
) -> ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { named(name).with_text(of_c(value)) }
}

/// Makes the value of a parameter that is a list of `len` numbers. It points to `name` and `numbers`, which must outlive it.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_numbers(
    name: *const c_char,
    numbers: *const f64,
    len: usize,
) -> ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { named(name) }.with_numbers(numbers, len)
}

/// Returns the value of that name, which belongs to `values`; NULL if there is none.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_find(
    values: Option<&ParameterValues>,
    name: *const c_char,
) -> *const ParameterValue {
    // SAFETY: the caller follows the rules of rect.h.
    let found = unsafe { find(values, name) };
    found.map_or(std::ptr::null(), std::ptr::from_ref)
}

/// # Safety
/// The pointers follow the rules of rect.h.
unsafe fn find(values: Option<&ParameterValues>, name: *const c_char) -> Option<&ParameterValue> {
    // SAFETY: guaranteed by this function's caller.
    unsafe {
        let values = values?;
        let name = of_c(name);
        let name = items("name", name.data, name.len).ok()?;
        let mut all = items("values", values.items, values.len).ok()?.iter();
        all.find(|value| items("name", value.name.data, value.name.len).ok() == Some(name))
    }
}
