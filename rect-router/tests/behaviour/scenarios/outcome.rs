//! Compares the outcome of a call with what the scenario expects.
use rect::{Encoding, Error, Payload};
use rect_core::{message::payload::PayloadError, name::topic::TopicError};
use serde_json::Value;

/// Panics unless the outcome of `call` is the expected one.
pub fn check(call: &Value, expected: &Value, outcome: Result<Value, Error>) {
    let error = match outcome {
        Ok(found) => return assert_eq!(found, *expected, "{call}"),
        Err(error) => error,
    };
    let text = error.to_string();
    assert_eq!(expected["error"], kind(&error), "{call}: {text}");
    for part in expected["text"].as_array().into_iter().flatten() {
        let part = part.as_str().expect("text");
        assert!(
            text.contains(part),
            "{call}: {text:?} does not contain {part:?}"
        );
    }
    if let (Some(expected), Error::Service { payload, .. }) = (expected.get("payload"), &error) {
        assert_eq!(value(payload).expect("a value"), *expected, "{call}");
    }
}

/// Returns the kind of an error as the scenarios name it.
fn kind(error: &Error) -> &'static str {
    match error {
        Error::Closed => "closed",
        Error::Dictionary(_) => "dictionary",
        Error::Name(_) | Error::Topic(TopicError::Robot(_)) => "name",
        Error::NotReachable { .. } => "not_reachable",
        Error::NoService { .. } => "no_service",
        Error::Option { .. } => "option",
        Error::Service { .. } => "service",
        Error::TimedOut { .. } => "timed_out",
        Error::Topic(_) => "topic",
        Error::TransferRefused { .. } => "transfer_refused",
        _ => "another",
    }
}

/// Returns the value of a payload: text, or JSON.
pub fn value(payload: &Payload) -> Result<Value, PayloadError> {
    if payload.encoding == Encoding::TEXT {
        return payload.text().map(Value::from);
    }
    payload.value()
}
