//! Infers a JSON Schema from the JSON objects of a topic, because viewers offer the fields that a schema lists.
//!
//! Foxglove and Lichtblick refuse a topic whose schema is not that of an object, or has a field without a type, a list without the
//! type of its items, or a list of lists. Fields that cannot be described are left out: the messages are shown nevertheless.
use std::{collections::BTreeMap, fmt};

use rect_core::codec::json::NON_FINITE;
use serde::de::{DeserializeSeed, Deserializer, IgnoredAny, MapAccess, SeqAccess, Visitor};
use serde_json::{json, Value};

use crate::schema::Schema;

/// MCAP's name of the form.
const ENCODING: &str = "jsonschema";
/// How deeply nested values are described.
const MAX_DEPTH: usize = 8;
/// How many fields of one object are described.
const MAX_FIELDS: usize = 256;
/// How many items of a list are looked at.
const MAX_ITEMS: usize = 32;
/// How often the schema of a topic changes at most, because each change requires a new channel.
const MAX_CHANGES: u8 = 16;

/// The common shape of the objects of a topic.
#[derive(Clone, Debug, Default)]
pub struct Inferred {
    shape: Shape,
    changes: u8,
}

impl Inferred {
    /// Takes an object into account, given its text. Returns how often the schema has changed so far.
    pub fn add(&mut self, object: &[u8]) -> u8 {
        if self.changes < MAX_CHANGES {
            let seen = Seen {
                shape: &mut self.shape,
                depth: MAX_DEPTH,
                is_item: false,
            };
            let changed = seen.deserialize(&mut serde_json::Deserializer::from_slice(object));
            self.changes += u8::from(changed.unwrap_or(false));
        }
        self.changes
    }

    /// Returns the schema of the topic.
    pub fn schema(&self, topic: &str) -> Schema {
        let empty = || json!({"type": "object", "properties": {}});
        let definition = self.shape.definition().unwrap_or_else(empty);
        Schema {
            // Viewers append `.<field>` to name the type of a field, which must not be the name of another topic.
            name: topic.to_owned(),
            encoding: ENCODING.into(),
            text: definition.to_string().into_bytes(),
        }
    }
}

/// The common shape of the values of a field.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
enum Shape {
    /// There was none, or only null.
    #[default]
    Unknown,
    Truth,
    Number,
    Text,
    List(Box<Shape>),
    Object(BTreeMap<String, Shape>),
    /// It cannot be described: values of different structure, a list of lists, or nested too deeply.
    Other,
}

impl Shape {
    /// Takes a value without parts into account. Returns whether the definition has changed.
    fn add_scalar(&mut self, found: Self) -> bool {
        match self {
            Self::Unknown => {
                *self = found;
                true
            }
            // A viewer shows a text in a field of numbers as well.
            Self::Truth | Self::Number | Self::Text => false,
            Self::List(_) | Self::Object(_) | Self::Other => self.replace(Self::Other),
        }
    }

    fn replace(&mut self, other: Self) -> bool {
        let had_definition = self.definition().is_some();
        *self = other;
        had_definition
    }

    /// Returns the definition; `None` if there is none that viewers accept.
    fn definition(&self) -> Option<Value> {
        Some(match self {
            Self::Unknown | Self::Other => return None,
            Self::Truth => json!({"type": "boolean"}),
            // Never an integer: the next one may have a fraction.
            Self::Number => json!({"type": "number"}),
            Self::Text => json!({"type": "string"}),
            Self::List(items) => json!({"type": "array", "items": items.definition()?}),
            Self::Object(fields) => {
                let known = fields
                    .iter()
                    .filter_map(|(name, field)| Some((name.clone(), field.definition()?)));
                let properties: serde_json::Map<_, _> = known.collect();
                json!({"type": "object", "properties": properties})
            }
        })
    }
}

/// Takes a value into account while it is parsed. The result is whether the definition has changed.
struct Seen<'a> {
    shape: &'a mut Shape,
    depth: usize,
    /// Whether the value is an item of a list.
    is_item: bool,
}

impl<'de> DeserializeSeed<'de> for Seen<'_> {
    type Value = bool;

    fn deserialize<D: Deserializer<'de>>(self, value: D) -> Result<bool, D::Error> {
        value.deserialize_any(self)
    }
}

impl<'de> Visitor<'de> for Seen<'_> {
    type Value = bool;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value")
    }

    fn visit_unit<E>(self) -> Result<bool, E> {
        Ok(false)
    }

    fn visit_bool<E>(self, _: bool) -> Result<bool, E> {
        Ok(self.shape.add_scalar(Shape::Truth))
    }

    fn visit_i64<E>(self, _: i64) -> Result<bool, E> {
        Ok(self.shape.add_scalar(Shape::Number))
    }

    fn visit_u64<E>(self, _: u64) -> Result<bool, E> {
        Ok(self.shape.add_scalar(Shape::Number))
    }

    fn visit_f64<E>(self, _: f64) -> Result<bool, E> {
        Ok(self.shape.add_scalar(Shape::Number))
    }

    fn visit_str<E>(self, text: &str) -> Result<bool, E> {
        Ok(self.shape.add_scalar(match NON_FINITE.contains(&text) {
            true => Shape::Number,
            false => Shape::Text,
        }))
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<bool, A::Error> {
        if *self.shape == Shape::Unknown {
            *self.shape = Shape::List(Box::default());
        }
        let mut changed = false;
        match self.shape {
            Shape::List(items) if self.depth > 0 && !self.is_item => {
                for _ in 0..MAX_ITEMS {
                    let item = list.next_element_seed(Seen {
                        shape: items,
                        depth: self.depth - 1,
                        is_item: true,
                    })?;
                    match item {
                        Some(item) => changed |= item,
                        None => return Ok(changed),
                    }
                }
            }
            shape => changed = shape.replace(Shape::Other),
        }
        while list.next_element::<IgnoredAny>()?.is_some() {}
        Ok(changed)
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<bool, A::Error> {
        let mut changed = false;
        if *self.shape == Shape::Unknown {
            *self.shape = Shape::Object(BTreeMap::new());
            changed = true;
        }
        match self.shape {
            Shape::Object(fields) if self.depth > 0 => {
                while let Some(field) = map.next_key_seed(Named(fields))? {
                    let Some(shape) = field else {
                        map.next_value::<IgnoredAny>()?;
                        continue;
                    };
                    changed |= map.next_value_seed(Seen {
                        shape,
                        depth: self.depth - 1,
                        is_item: false,
                    })?;
                }
            }
            shape => {
                // One that is too deep was not described before.
                changed = shape.replace(Shape::Other) && !changed;
                while map.next_entry::<IgnoredAny, IgnoredAny>()?.is_some() {}
            }
        }
        Ok(changed)
    }
}

/// The field of an object that has the parsed name; `None` if there are too many.
struct Named<'a>(&'a mut BTreeMap<String, Shape>);

impl<'de, 'a> DeserializeSeed<'de> for Named<'a> {
    type Value = Option<&'a mut Shape>;

    fn deserialize<D: Deserializer<'de>>(self, name: D) -> Result<Self::Value, D::Error> {
        name.deserialize_str(self)
    }
}

impl<'a> Visitor<'_> for Named<'a> {
    type Value = Option<&'a mut Shape>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a name")
    }

    fn visit_str<E>(self, name: &str) -> Result<Self::Value, E> {
        if self.0.len() < MAX_FIELDS && !self.0.contains_key(name) {
            self.0.insert(name.to_owned(), Shape::Unknown);
        }
        Ok(self.0.get_mut(name))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn inferred(objects: &[Value]) -> (Value, u8) {
        let mut inferred = Inferred::default();
        let texts = objects.iter().map(Value::to_string);
        let changes = texts.map(|text| inferred.add(text.as_bytes())).last();
        let schema = inferred.schema("a/x");
        let definition = serde_json::from_slice(&schema.text).expect("JSON");
        (definition, changes.unwrap_or(0))
    }

    fn object(properties: Value) -> Value {
        json!({"type": "object", "properties": properties})
    }

    #[test]
    fn schema_lists_fields_of_known_type() {
        let value = json!({
            "volt": 11.9, "is_on": true, "range": "Infinity", "cells": [{"id": "a"}, {"volt": null, "n": 2}],
            "note": null, "empty": [], "table": [[1, 2]], "mixed": [1, {"x": 1}], "nothing": {},
        });
        let number = || json!({"type": "number"});
        let cell = object(json!({"id": {"type": "string"}, "n": number()}));
        let expected = object(json!({
            "volt": number(), "is_on": {"type": "boolean"}, "range": number(),
            "cells": {"type": "array", "items": cell}, "nothing": object(json!({})),
        }));
        assert_eq!(inferred(&[value]), (expected, 1));
    }

    #[test]
    fn schema_grows_with_the_values() {
        let number = || json!({"type": "number"});
        let point = object(json!({"x": number()}));
        let list = object(json!({"detections": {"type": "array", "items": point}}));
        let values = [
            json!({"detections": []}),
            json!({"detections": [{"x": 1}]}),
            json!({"detections": null}),
            json!({"detections": [{"x": "near"}]}),
        ];
        assert_eq!(inferred(&values), (list, 2));
        assert_eq!(inferred(&[json!({"a": 1}), json!({"a": "text"})]).1, 1);
    }

    #[test]
    fn field_that_changes_its_structure_is_left_out() {
        let b = object(json!({"b": {"type": "boolean"}}));
        for (one, other) in [
            (json!(1), json!({"x": 1})),
            (json!({"x": 1}), json!([1])),
            (json!([1]), json!([[1]])),
            (json!([{"x": 1}]), json!(["x"])),
        ] {
            let values = [&one, &other, &one].map(|a| json!({"a": a, "b": true}));
            assert_eq!(inferred(&values), (b.clone(), 2), "{one} {other}");
        }
    }

    #[test]
    fn depth_fields_and_changes_are_limited() {
        let mut value = json!(1);
        for _ in 0..100 {
            value = json!({"x": value, "y": [{"z": 1}]});
        }
        assert!(inferred(&[value]).0.to_string().len() < 2000);
        let many = (0..10_000).map(|n| (n.to_string(), json!(n))).collect();
        assert!(inferred(&[Value::Object(many)]).0.to_string().len() < 10_000);
        let growing: Vec<_> = (0..100).map(|n| json!({ n.to_string(): n })).collect();
        assert_eq!(inferred(&growing).1, MAX_CHANGES);
    }
}
