//! Defines how a program declares a group of parameters.
use std::{collections::BTreeMap, fmt, path::PathBuf, sync::Arc};

use rect_core::parameters::{Change, Declaration, Parameter, Value, Values};

/// A type whose fields are parameters: derive it with [`#[derive(rect::Parameters)]`](rect_derive::Parameters).
pub trait Parameters: Send + Sync + 'static {
    /// Returns the declarations of the fields, in their order.
    fn parameters() -> Vec<Parameter>;

    /// Returns the type with these values, which are in the order of the fields and fit their declarations.
    fn from_values<'a>(values: impl Iterator<Item = &'a Value>) -> Self;
}

/// The type of a field that is a parameter: `bool`, integers, `f64`, `f32`, `String` and `Vec<f64>`.
pub trait ParameterField: Default {
    /// Returns the declaration of a parameter of the type.
    fn parameter(name: &str, default: Self) -> Parameter;

    /// Returns a value that fits the declaration.
    fn from_value(value: &Value) -> Self;
}

/// A group of parameters that a program declares with [`Robot::parameters`](crate::Robot::parameters).
///
/// `T` is a type that derives [`Parameters`], or a map of values for parameters that are known only when the program runs.
pub struct GroupOptions<T = BTreeMap<String, Value>> {
    pub(super) group: String,
    pub(super) about: String,
    pub(super) parameters: Vec<Parameter>,
    pub(super) read: Box<Read<T>>,
    pub(super) check: Option<Box<Check<T>>>,
    pub(super) on_change: Option<Box<OnChange<T>>>,
    pub(super) file: File,
}

pub(super) type Read<T> = dyn Fn(&Declaration, &Values) -> T + Send + Sync;
pub(super) type Check<T> = dyn Fn(&T) -> Result<(), String> + Send + Sync;
pub(super) type OnChange<T> = dyn Fn(&Arc<T>, &Change) + Send + Sync;

/// Where the values are kept.
pub(super) enum File {
    Default,
    At(PathBuf),
    None,
}

impl<T: Parameters> GroupOptions<T> {
    /// Describes a group with the fields of `T`.
    pub fn new(group: &str) -> Self {
        Self::of(
            group,
            T::parameters(),
            Box::new(|_, values| T::from_values(values.iter())),
        )
    }
}

impl GroupOptions {
    /// Describes a group with these parameters.
    pub fn with(group: &str, parameters: Vec<Parameter>) -> Self {
        let read = |declaration: &Declaration, values: &Values| {
            let pairs = values.of(declaration);
            pairs
                .map(|(parameter, value)| (parameter.name.clone(), value.clone()))
                .collect()
        };
        Self::of(group, parameters, Box::new(read))
    }
}

impl<T> GroupOptions<T> {
    fn of(group: &str, parameters: Vec<Parameter>, read: Box<Read<T>>) -> Self {
        Self {
            group: group.to_owned(),
            about: String::new(),
            parameters,
            read,
            check: None,
            on_change: None,
            file: File::Default,
        }
    }

    /// Sets the purpose of the group: at most 200 characters.
    #[must_use]
    pub fn about(self, about: &str) -> Self {
        let about = about.to_owned();
        Self { about, ..self }
    }

    /// Calls `check` with the values as they would be before each change, which it refuses with a reason. It must not change parameters
    /// itself, and if it panics, the change is refused.
    #[must_use]
    pub fn check(self, check: impl Fn(&T) -> Result<(), String> + Send + Sync + 'static) -> Self {
        let check: Option<Box<Check<T>>> = Some(Box::new(check));
        Self { check, ..self }
    }

    /// Calls `on_change` after each change, with the new values and what has changed, one call at a time and in order. Parameters that
    /// are changed together are one change.
    #[must_use]
    pub fn on_change(self, on_change: impl Fn(&Arc<T>, &Change) + Send + Sync + 'static) -> Self {
        let on_change: Option<Box<OnChange<T>>> = Some(Box::new(on_change));
        Self { on_change, ..self }
    }

    /// Keeps the values in this file. Default: `<folder>/<robot>/<group>.json`, in the folder of the environment variable
    /// `RECT_PARAMETERS`, or `~/.local/state/rect/parameters`.
    #[must_use]
    pub fn file(self, path: impl Into<PathBuf>) -> Self {
        let file = File::At(path.into());
        Self { file, ..self }
    }

    /// Begins with the defaults at each start of the program: keeps the values in no file.
    #[must_use]
    pub fn without_file(self) -> Self {
        let file = File::None;
        Self { file, ..self }
    }
}

impl<T: Parameters> From<&str> for GroupOptions<T> {
    fn from(group: &str) -> Self {
        Self::new(group)
    }
}

impl<T> fmt::Debug for GroupOptions<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GroupOptions")
            .field("group", &self.group)
            .field("parameters", &self.parameters)
            .finish_non_exhaustive()
    }
}

impl ParameterField for bool {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, default)
    }

    fn from_value(value: &Value) -> Self {
        *value == Value::Bool(true)
    }
}

impl ParameterField for String {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, default)
    }

    fn from_value(value: &Value) -> Self {
        match value {
            Value::Text(text) => text.clone(),
            _ => Self::new(),
        }
    }
}

impl ParameterField for Vec<f64> {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, default)
    }

    fn from_value(value: &Value) -> Self {
        match value {
            Value::Numbers(numbers) => numbers.clone(),
            _ => Self::new(),
        }
    }
}

impl ParameterField for f64 {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, default)
    }

    fn from_value(value: &Value) -> Self {
        match value {
            Value::Number(number) => *number,
            _ => 0.0,
        }
    }
}

impl ParameterField for f32 {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, f64::from(default))
    }

    #[allow(clippy::cast_possible_truncation)] // The type has fewer digits.
    fn from_value(value: &Value) -> Self {
        f64::from_value(value) as Self
    }
}

impl ParameterField for i64 {
    fn parameter(name: &str, default: Self) -> Parameter {
        Parameter::new(name, default)
    }

    fn from_value(value: &Value) -> Self {
        match value {
            Value::Integer(number) => *number,
            _ => 0,
        }
    }
}

/// Implements the trait for an integer type, whose range is that of the parameter.
macro_rules! integer {
    ($($integer:ty),*) => {$(
        impl ParameterField for $integer {
            fn parameter(name: &str, default: Self) -> Parameter {
                let range = (f64::from(Self::MIN), f64::from(Self::MAX));
                Parameter::new(name, i64::from(default)).range(range.0, range.1)
            }

            fn from_value(value: &Value) -> Self {
                Self::try_from(i64::from_value(value)).unwrap_or_default()
            }
        }
    )*};
}

integer!(u8, i8, u16, i16, u32, i32);
