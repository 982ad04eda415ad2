//! Defines the declaration of parameters: their types, defaults and ranges, and which values they accept.
use serde::{Deserialize, Serialize};

use super::{
    is_name, Value, MAX_ABOUT, MAX_BYTES, MAX_NAME, MAX_NUMBERS, MAX_PARAMETERS, MAX_TEXT,
};
use crate::text::{display::is_harmful, names::in_words};

/// The maximum length of a unit, in characters.
const MAX_UNIT: usize = 20;
/// The maximum number of choices.
const MAX_CHOICES: usize = 64;
/// The largest integer that a floating-point number represents exactly, as JavaScript and JSON require.
const MAX_INTEGER: i64 = 1 << 53;

/// The type of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// Yes or no.
    Bool,
    /// An integer, between -2^53 and 2^53.
    Integer,
    /// A finite number.
    Number,
    /// A text of at most 4 kB.
    Text,
    /// One of a list of texts.
    Choice,
    /// A list of at most 256 finite numbers.
    Numbers,
}

/// The declaration of one parameter.
///
/// ```
/// use rect_core::parameters::Parameter;
/// let gain = Parameter::new("kp", 1.0).range(0.0, 10.0).unit("1/s").about("gain of the heading");
/// assert!(gain.accept(&11.0.into()).is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// The name.
    pub name: String,
    /// The type.
    #[serde(rename = "type")]
    pub kind: Kind,
    /// The value until somebody changes it.
    pub default: Value,
    /// The smallest number; `None`: any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min: Option<f64>,
    /// The largest number; `None`: any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub max: Option<f64>,
    /// The choices.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub choices: Vec<String>,
    /// The unit, such as `m/s`; empty if there is none.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
    /// Its purpose, in the program's words.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Whether only the program itself changes it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub read_only: bool,
}

/// The parameters of a group, which are valid.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Parameter>", into = "Vec<Parameter>")]
pub struct Declaration(Vec<Parameter>);

/// Why a declaration is invalid.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct DeclarationError(pub String);

impl Parameter {
    /// Declares a parameter with the type of its default. A text is not a choice until it has [`choices`](Self::choices).
    pub fn new(name: &str, default: impl Into<Value>) -> Self {
        let default = default.into();
        let kind = match &default {
            Value::Bool(_) => Kind::Bool,
            Value::Integer(_) => Kind::Integer,
            Value::Number(_) => Kind::Number,
            Value::Text(_) => Kind::Text,
            Value::Numbers(_) => Kind::Numbers,
        };
        Self {
            name: name.to_owned(),
            kind,
            default,
            min: None,
            max: None,
            choices: Vec::new(),
            unit: String::new(),
            about: String::new(),
            read_only: false,
        }
    }

    /// Sets the smallest and the largest value of a number, an integer, or each number of a list.
    #[must_use]
    pub fn range(self, min: impl Into<Option<f64>>, max: impl Into<Option<f64>>) -> Self {
        let (min, max) = (min.into(), max.into());
        Self { min, max, ..self }
    }

    /// Makes a text the choice from a list.
    #[must_use]
    pub fn choices<T: Into<String>>(self, choices: impl IntoIterator<Item = T>) -> Self {
        let choices = choices.into_iter().map(Into::into).collect();
        Self {
            kind: Kind::Choice,
            choices,
            ..self
        }
    }

    /// Sets the unit.
    #[must_use]
    pub fn unit(self, unit: &str) -> Self {
        let unit = unit.to_owned();
        Self { unit, ..self }
    }

    /// Sets the description: at most 200 characters.
    #[must_use]
    pub fn about(self, about: &str) -> Self {
        let about = about.to_owned();
        Self { about, ..self }
    }

    /// Lets only the program itself change it.
    #[must_use]
    pub fn read_only(self) -> Self {
        Self {
            read_only: true,
            ..self
        }
    }

    /// Returns the value as the type of the parameter: an integer where a number is required, and the other way round if nothing is
    /// lost.
    ///
    /// # Errors
    /// Returns why the parameter does not accept it.
    pub fn accept(&self, value: &Value) -> Result<Value, String> {
        let accepted = match (self.kind, value) {
            (Kind::Bool, Value::Bool(_)) => value.clone(),
            (Kind::Integer, Value::Integer(number)) => {
                if number.unsigned_abs() > MAX_INTEGER.unsigned_abs() {
                    return Err(self.refuse(value, "it must be between -2^53 and 2^53"));
                }
                #[allow(clippy::cast_precision_loss)] // It is exact up to 2^53.
                self.check_range(value, *number as f64)?;
                value.clone()
            }
            #[allow(clippy::cast_possible_truncation)]
            // The number is whole, and the range is checked.
            (Kind::Integer, Value::Number(number)) if number.fract() == 0.0 => {
                return self.accept(&Value::Integer(*number as i64));
            }
            (Kind::Number, Value::Number(number)) => {
                self.check_range(value, *number)?;
                value.clone()
            }
            #[allow(clippy::cast_precision_loss)] // Nobody means more digits.
            (Kind::Number, Value::Integer(number)) => {
                return self.accept(&Value::Number(*number as f64));
            }
            (Kind::Text, Value::Text(text)) => {
                if text.len() > MAX_TEXT {
                    let reason = format!(
                        "it has {} bytes, and at most {MAX_TEXT} are allowed",
                        text.len()
                    );
                    return Err(self.refuse(value, &reason));
                }
                value.clone()
            }
            (Kind::Choice, Value::Text(text)) => {
                if !self.choices.contains(text) {
                    let choices = self.choices.iter().map(String::as_str);
                    return Err(self.refuse(value, &in_words("choices", text, choices)));
                }
                value.clone()
            }
            (Kind::Numbers, Value::Numbers(numbers)) => {
                if numbers.len() > MAX_NUMBERS {
                    let reason = format!(
                        "it has {} numbers, and at most {MAX_NUMBERS} are allowed",
                        numbers.len()
                    );
                    return Err(self.refuse(value, &reason));
                }
                for number in numbers {
                    self.check_range(value, *number)?;
                }
                value.clone()
            }
            (kind, value) => {
                let expected = match kind {
                    Kind::Bool => "true or false",
                    Kind::Integer => "an integer",
                    Kind::Number => "a number",
                    Kind::Text => "a text",
                    Kind::Choice => "a text, one of the choices",
                    Kind::Numbers => "a list of numbers",
                };
                let found = value.type_name();
                return Err(self.refuse(value, &format!("it must be {expected}, not {found}")));
            }
        };
        Ok(accepted)
    }

    fn check_range(&self, value: &Value, number: f64) -> Result<(), String> {
        if !number.is_finite() {
            return Err(self.refuse(value, "it must be finite"));
        }
        let unit = match self.unit.as_str() {
            "" => String::new(),
            unit => format!(" {unit}"),
        };
        match (self.min, self.max) {
            (Some(min), _) if number < min => {
                Err(self.refuse(value, &format!("the minimum is {min}{unit}")))
            }
            (_, Some(max)) if number > max => {
                Err(self.refuse(value, &format!("the maximum is {max}{unit}")))
            }
            _ => Ok(()),
        }
    }

    fn refuse(&self, value: &Value, reason: &str) -> String {
        format!("{} cannot be {value}: {reason}", self.name)
    }

    fn check(&self) -> Result<(), DeclarationError> {
        let wrong = |reason: String| {
            let name: String = self.name.chars().take(MAX_NAME).collect();
            Err(DeclarationError(format!(
                "the parameter {name:?}: {reason}"
            )))
        };
        if !is_name(&self.name) {
            return wrong(format!(
                "a name has 1 to {MAX_NAME} letters, digits, `_`, `-` and `.`"
            ));
        }
        let is_longer = |text: &str, max: usize| text.chars().count() > max;
        if is_longer(&self.unit, MAX_UNIT) || is_longer(&self.about, MAX_ABOUT) {
            return wrong(format!(
                "a unit has at most {MAX_UNIT} characters, and a description {MAX_ABOUT}"
            ));
        }
        let texts = self.choices.iter().chain([&self.unit, &self.about]);
        if texts.flat_map(|text| text.chars()).any(is_harmful) {
            return wrong("a unit, description or choice has a control character".to_owned());
        }
        let limits = [self.min, self.max];
        if limits.iter().flatten().any(|limit| !limit.is_finite()) {
            return wrong("the minimum and the maximum are finite, or left out".to_owned());
        }
        if let (Some(min), Some(max)) = (self.min, self.max) {
            if min > max {
                return wrong(format!("the minimum {min} is above the maximum {max}"));
            }
        }
        let has_range = limits.iter().any(Option::is_some);
        if has_range && !matches!(self.kind, Kind::Integer | Kind::Number | Kind::Numbers) {
            return wrong("only numbers have a range".to_owned());
        }
        if (self.kind == Kind::Choice) == self.choices.is_empty()
            || self.choices.len() > MAX_CHOICES
        {
            return wrong(format!("a choice has 1 to {MAX_CHOICES} choices"));
        }
        if self
            .choices
            .iter()
            .any(|choice| is_longer(choice, MAX_NAME))
        {
            return wrong(format!("a choice has at most {MAX_NAME} characters"));
        }
        self.accept(&self.default)
            .map(drop)
            .map_err(|reason| DeclarationError(format!("the default: {reason}")))
    }
}

impl Declaration {
    /// Checks the parameters of a group.
    ///
    /// # Errors
    /// Returns what is invalid.
    pub fn new(parameters: Vec<Parameter>) -> Result<Self, DeclarationError> {
        if parameters.is_empty() || parameters.len() > MAX_PARAMETERS {
            return Err(DeclarationError(format!(
                "a group has 1 to {MAX_PARAMETERS} parameters, not {}",
                parameters.len()
            )));
        }
        let mut checked: Vec<Parameter> = Vec::with_capacity(parameters.len());
        for mut parameter in parameters {
            parameter.check()?;
            // An integer as the default of a number is a number.
            parameter.default = (parameter.accept(&parameter.default)).map_err(DeclarationError)?;
            if checked.iter().any(|other| other.name == parameter.name) {
                let name = parameter.name;
                return Err(DeclarationError(format!("{name} is declared twice")));
            }
            checked.push(parameter);
        }
        let sizes = checked.iter().map(|parameter| parameter.default.size());
        if sizes.sum::<usize>() > MAX_BYTES {
            return Err(DeclarationError(format!(
                "the defaults have more than {MAX_BYTES} bytes"
            )));
        }
        Ok(Self(checked))
    }

    /// Returns the parameters, in the order of their declaration.
    pub fn parameters(&self) -> &[Parameter] {
        &self.0
    }

    /// Returns the parameter of that name.
    ///
    /// # Errors
    /// Returns that the group has no such parameter, and which one may be meant.
    pub fn find(&self, name: &str) -> Result<&Parameter, String> {
        let found = self.0.iter().find(|parameter| parameter.name == name);
        found.ok_or_else(|| {
            let name: String = name.chars().take(MAX_NAME).collect();
            let names = self.0.iter().map(|parameter| parameter.name.as_str());
            format!(
                "there is no parameter {name:?}; {}",
                in_words("parameters", &name, names)
            )
        })
    }
}

// Its numbers are finite.
impl Eq for Declaration {}

impl TryFrom<Vec<Parameter>> for Declaration {
    type Error = DeclarationError;

    fn try_from(parameters: Vec<Parameter>) -> Result<Self, DeclarationError> {
        Self::new(parameters)
    }
}

impl From<Declaration> for Vec<Parameter> {
    fn from(Declaration(parameters): Declaration) -> Self {
        parameters
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_become_the_type_of_their_parameter_or_are_refused_with_a_reason() {
        let gain = Parameter::new("kp", 1.0).range(0.0, 10.0).unit("1/s");
        assert_eq!(gain.accept(&2.into()), Ok(Value::Number(2.0)));
        let steps = Parameter::new("steps", 3).range(None, 8.0);
        assert_eq!(steps.accept(&4.0.into()), Ok(Value::Integer(4)));
        let side = Parameter::new("side", "left").choices(["left", "right"]);
        let points = Parameter::new("points", vec![1.0]).range(0.0, None);
        for (parameter, value, reason) in [
            (
                &gain,
                Value::from(11.0),
                "kp cannot be 11: the maximum is 10 1/s",
            ),
            (&gain, (-1).into(), "the minimum is 0 1/s"),
            (&gain, f64::NAN.into(), "finite"),
            (&gain, f64::INFINITY.into(), "finite"),
            (&gain, "fast".into(), "it must be a number, not a text"),
            (&gain, true.into(), "not a bool"),
            (&steps, 2.5.into(), "an integer, not a number"),
            (&steps, i64::MIN.into(), "2^53"),
            (&steps, 1e300.into(), "2^53"),
            (&side, "lef".into(), "did you mean left?"),
            (&side, 1.into(), "one of the choices"),
            (&points, vec![-1.0].into(), "the minimum is 0"),
            (&points, vec![0.0; 257].into(), "at most 256"),
            (
                &Parameter::new("text", ""),
                "x".repeat(4097).into(),
                "at most 4096",
            ),
        ] {
            let refused = parameter.accept(&value).expect_err(reason);
            assert!(refused.contains(reason), "{refused}");
            assert!(refused.len() < 250, "{refused}");
        }
    }

    #[test]
    fn invalid_declarations_are_refused() {
        let gain = || Parameter::new("kp", 1.0);
        assert!(Declaration::new(vec![gain(), Parameter::new("k", 1)]).is_ok());
        for (parameters, reason) in [
            (vec![], "1 to 256"),
            (vec![gain(); 257], "1 to 256"),
            (vec![gain(), gain()], "twice"),
            (vec![Parameter::new("a b", 1)], "letters"),
            (vec![Parameter::new("..", 1)], "letters"),
            (vec![gain().range(2.0, 1.0)], "above the maximum"),
            (vec![gain().range(2.0, 3.0)], "the default: kp cannot be 1"),
            (vec![gain().range(f64::NAN, None)], "finite"),
            (vec![gain().about(&"x".repeat(201))], "200"),
            (vec![gain().unit("\u{202e}")], "control"),
            (vec![Parameter::new("a", true).range(0.0, None)], "range"),
            (vec![Parameter::new("a", "b").choices([""; 0])], "choices"),
            (vec![Parameter::new("a", "b").choices(["c"])], "the default"),
        ] {
            let refused = Declaration::new(parameters).expect_err(reason).to_string();
            assert!(refused.contains(reason), "{refused}");
        }
    }
}
