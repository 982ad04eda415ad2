//! Converts the values of parameters for viewers, and back.
use foxglove::websocket::{Parameter, ParameterValue};
use rect::ParameterValue as Value;

/// Returns a parameter with its value.
pub fn parameter(name: String, value: &Value) -> Parameter {
    match value {
        Value::Bool(value) => Parameter::bool(name, *value),
        Value::Integer(value) => Parameter::integer(name, *value),
        Value::Number(value) => Parameter::float64(name, *value),
        Value::Text(value) => Parameter::string(name, value),
        Value::Numbers(values) => Parameter::float64_array(name, values.iter().copied()),
    }
}

/// Returns the value that a viewer has sent.
///
/// # Errors
/// Returns why no parameter can have it.
pub fn read(value: Option<&ParameterValue>) -> Result<Value, String> {
    match value {
        Some(ParameterValue::Bool(value)) => Ok((*value).into()),
        Some(ParameterValue::Integer(value)) => Ok((*value).into()),
        Some(ParameterValue::Float64(value)) => Ok((*value).into()),
        Some(ParameterValue::String(value)) => Ok(value.as_str().into()),
        Some(ParameterValue::Array(values)) => {
            let numbers = values.iter().map(number).collect::<Option<Vec<_>>>();
            let numbers = numbers.ok_or("a list contains only numbers")?;
            Ok(numbers.into())
        }
        Some(ParameterValue::Dict(_)) => Err("an object cannot be a value".to_owned()),
        None => Err("a parameter cannot be removed".to_owned()),
    }
}

#[allow(clippy::cast_precision_loss)] // The numbers of a list have no more digits.
fn number(value: &ParameterValue) -> Option<f64> {
    match value {
        ParameterValue::Integer(value) => Some(*value as f64),
        ParameterValue::Float64(value) => Some(*value),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_round_trip() {
        for value in [
            Value::from(true),
            3.into(),
            2.0.into(),
            "left".into(),
            vec![1.0, 2.5].into(),
            Vec::<f64>::new().into(),
        ] {
            let shown = parameter("a/b/c".to_owned(), &value);
            assert_eq!(read(shown.value.as_ref()), Ok(value));
        }
    }

    #[test]
    fn other_values_are_rejected() {
        let object = ParameterValue::Dict([].into());
        let mixed = ParameterValue::Array(vec![ParameterValue::Bool(true)]);
        for (value, reason) in [
            (Some(&object), "an object"),
            (Some(&mixed), "only numbers"),
            (None, "removed"),
        ] {
            let error = read(value).expect_err(reason);
            assert!(error.contains(reason), "{error}");
        }
    }
}
