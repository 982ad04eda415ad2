//! Infers a JSON Schema from a JSON value, because viewers offer the fields that a schema lists.
use serde_json::{json, Map, Value};

use crate::picture::{self, Kind};

/// MCAP's name of the form.
const ENCODING: &str = "jsonschema";
/// How deeply nested values are described.
const MAX_DEPTH: usize = 8;
/// How many fields of one object are described.
const MAX_FIELDS: usize = 256;

/// A schema, as MCAP and viewers take it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Its name.
    pub name: String,
    /// MCAP's name of its form.
    pub encoding: &'static str,
    /// Its definition.
    pub text: Vec<u8>,
}

impl Schema {
    /// Returns the schema of a topic whose messages are like this value.
    pub fn of_value(topic: &str, value: &Value) -> Self {
        Self {
            name: topic.replace('/', "."),
            encoding: ENCODING,
            text: infer(value).to_string().into_bytes(),
        }
    }

    /// Returns the schema of pictures, or of frames of a video.
    pub fn of_picture(kind: Kind) -> Self {
        Self {
            name: kind.schema_name(),
            encoding: picture::PROTOBUF,
            text: picture::schema(kind),
        }
    }
}

/// Returns a schema that the value fulfils.
pub fn infer(value: &Value) -> Value {
    inferred(value, MAX_DEPTH)
}

fn inferred(value: &Value, depth: usize) -> Value {
    if depth == 0 {
        return json!({});
    }
    match value {
        // Another message may have a value there.
        Value::Null => json!({}),
        Value::Bool(_) => json!({"type": "boolean"}),
        // The next one may have a fraction.
        Value::Number(_) => json!({"type": "number"}),
        Value::String(_) => json!({"type": "string"}),
        Value::Array(items) => {
            let items = items
                .first()
                .map_or(json!({}), |first| inferred(first, depth - 1));
            json!({"type": "array", "items": items})
        }
        Value::Object(fields) => {
            let fields = fields.iter().take(MAX_FIELDS);
            let properties: Map<_, _> = fields
                .map(|(name, value)| (name.clone(), inferred(value, depth - 1)))
                .collect();
            json!({"type": "object", "properties": properties})
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_lists_fields_and_types() {
        let schema = infer(&json!({"volt": 11.9, "cells": [{"id": "a"}], "note": null}));
        let cell = json!({"type": "object", "properties": {"id": {"type": "string"}}});
        assert_eq!(
            schema,
            json!({"type": "object", "properties": {
                "volt": {"type": "number"},
                "cells": {"type": "array", "items": cell},
                "note": {},
            }})
        );
    }

    #[test]
    fn depth_is_limited() {
        let mut value = json!(1);
        for _ in 0..100 {
            value = json!([value]);
        }
        assert!(infer(&value).to_string().len() < 1000);
    }
}
