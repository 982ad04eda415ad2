//! Shows payloads as JSON, also what JSON cannot express.
use ciborium::value::{Integer, Value as Cbor};
use serde_json::{json, Number as JsonNumber, Value};

use super::{
    array::{Array, Element, Number},
    Limits,
};
use crate::message::{encoding::EncodingKind, payload::Payload};

/// The number of digits of the smallest integer that 64 bits cannot hold.
const DIGITS: usize = 19;
/// The texts for numbers that JSON cannot express. Some programs write them into JSON, without quotes.
pub const NON_FINITE: [&str; 3] = ["NaN", "Infinity", "-Infinity"];

impl Payload {
    /// Returns the value of the payload as JSON, for people and viewers: JSON, CBOR, text, or an array of numbers as nested
    /// lists. NaN and infinities become the texts `NaN`, `Infinity` and `-Infinity`, integers of more than 64 bits their digits as text, other keys than texts become texts, and
    /// bytes in CBOR become `{"bytes": <their number>}`.
    ///
    /// Returns `None` if the payload has no value, is damaged, or is an array that is larger than `limits` allow.
    pub fn to_json(&self, limits: &Limits) -> Option<Value> {
        match self.encoding.kind() {
            EncodingKind::Json => json(&self.bytes),
            EncodingKind::Cbor => self.value().ok().map(of_cbor),
            EncodingKind::Raw => self.array(limits).ok().map(|array| of_array(&array)),
            _ => self.text().ok().map(Value::from),
        }
    }
}

fn json(bytes: &[u8]) -> Option<Value> {
    let value = serde_json::from_slice(bytes).ok();
    let is_long = |run: &[u8]| run.iter().all(u8::is_ascii_digit);
    if value.is_some() && !bytes.windows(DIGITS).any(is_long) {
        return value;
    }
    let quoted = || {
        let quoted = with_quotes(std::str::from_utf8(bytes).ok()?)?;
        serde_json::from_str(&quoted).ok()
    };
    quoted().or(value)
}

/// Returns the length of an integer at the beginning of a text if it has more than 64 bits.
fn large_integer(text: &str) -> Option<usize> {
    let sign = usize::from(text.starts_with('-'));
    let number = &text[sign..];
    let end = number
        .find(|c: char| !c.is_ascii_digit())
        .unwrap_or(number.len());
    let is_fraction = number[end..].starts_with(['.', 'e', 'E']);
    let integer = &text[..sign + end];
    let fits = integer.parse::<i64>().is_ok() || integer.parse::<u64>().is_ok();
    (end >= DIGITS && !is_fraction && !fits).then_some(integer.len())
}

/// Puts quotes around the numbers that JSON cannot express. Returns `None` if there are none.
fn with_quotes(json: &str) -> Option<String> {
    let mut quoted = String::with_capacity(json.len());
    let (mut is_text, mut is_found) = (false, false);
    let mut rest = json;
    let mut before = ' ';
    while let Some(next) = rest.chars().next() {
        let name = NON_FINITE.iter().find(|name| rest.starts_with(**name));
        // Within a number, digits and the point continue it.
        let is_number = before.is_ascii_alphanumeric() || matches!(before, '.' | '-' | '+');
        let number = name.map(|name| name.len());
        let number = number.or_else(|| (!is_number && !is_text).then(|| large_integer(rest))?);
        let length = match number {
            Some(length) if !is_text => {
                is_found = true;
                quoted.extend(["\"", &rest[..length], "\""]);
                length
            }
            // The character behind it does not end the text.
            _ if is_text && next == '\\' => {
                let escaped = rest.chars().nth(1).map_or(0, char::len_utf8);
                quoted.push_str(&rest[..1 + escaped]);
                1 + escaped
            }
            _ => {
                is_text ^= next == '"';
                quoted.push(next);
                next.len_utf8()
            }
        };
        before = rest[..length].chars().next_back().unwrap_or(before);
        rest = &rest[length..];
    }
    is_found.then_some(quoted)
}

fn of_cbor(value: Cbor) -> Value {
    match value {
        Cbor::Bool(truth) => truth.into(),
        Cbor::Integer(number) => of_integer(number),
        Cbor::Float(number) => of_float(number),
        Cbor::Text(text) => text.into(),
        Cbor::Bytes(bytes) => json!({ "bytes": bytes.len() }),
        Cbor::Tag(tag @ (2 | 3), value) => {
            bignum(tag == 3, &value).unwrap_or_else(|| of_cbor(*value))
        }
        Cbor::Tag(_, value) => of_cbor(*value),
        Cbor::Array(items) => items.into_iter().map(of_cbor).collect(),
        Cbor::Map(fields) => {
            let fields = fields.into_iter();
            Value::Object(
                fields
                    .map(|(name, value)| (key(name), of_cbor(value)))
                    .collect(),
            )
        }
        _ => Value::Null,
    }
}

/// Returns the digits of an integer of more than 64 bits (RFC 8949, section 3.4.3), if it has at most 128.
fn bignum(is_negative: bool, value: &Cbor) -> Option<Value> {
    let bytes = value.as_bytes()?;
    let mut number = [0; 16];
    number[16_usize.checked_sub(bytes.len())?..].copy_from_slice(bytes);
    let number = u128::from_be_bytes(number);
    let text = match is_negative {
        true => format!("-{}", number.checked_add(1)?),
        false => number.to_string(),
    };
    Some(text.into())
}

fn key(name: Cbor) -> String {
    match of_cbor(name) {
        Value::String(text) => text,
        other => other.to_string(),
    }
}

fn of_integer(number: Integer) -> Value {
    let number = i128::from(number);
    let signed = i64::try_from(number).ok().map(Value::from);
    let unsigned = || u64::try_from(number).ok().map(Value::from);
    signed
        .or_else(unsigned)
        .unwrap_or_else(|| number.to_string().into())
}

fn of_float(number: f64) -> Value {
    let [nan, infinity, negative] = NON_FINITE;
    match JsonNumber::from_f64(number) {
        Some(number) => Value::Number(number),
        None if number.is_nan() => nan.into(),
        None if number > 0.0 => infinity.into(),
        None => negative.into(),
    }
}

fn of_array(array: &Array) -> Value {
    let numbers = match array.element() {
        Element::U8 => values(array, |number: u8| number.into()),
        Element::I8 => values(array, |number: i8| number.into()),
        Element::U16 => values(array, |number: u16| number.into()),
        Element::I16 => values(array, |number: i16| number.into()),
        Element::U32 => values(array, |number: u32| number.into()),
        Element::I32 => values(array, |number: i32| number.into()),
        Element::I64 => values(array, |number: i64| number.into()),
        // With the digits of an `f32`: 0.1 rather than 0.10000000149011612.
        Element::F32 => values(array, |number: f32| {
            of_float(number.to_string().parse().unwrap_or(f64::NAN))
        }),
        Element::F64 => values(array, of_float),
    };
    nested(&mut numbers.into_iter(), array.shape())
}

fn values<T: Number>(array: &Array, value: impl Fn(T) -> Value) -> Vec<Value> {
    let numbers = array.numbers::<T>().unwrap_or_default();
    numbers.into_iter().map(value).collect()
}

fn nested(numbers: &mut std::vec::IntoIter<Value>, shape: &[usize]) -> Value {
    match shape {
        [] => numbers.next().unwrap_or_default(),
        [length, rest @ ..] => (0..*length).map(|_| nested(numbers, rest)).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        codec::{quantised::Quantised, Codec},
        message::{encoding::Encoding, payload::ToPayload},
    };

    fn shown(bytes: impl Into<bytes::Bytes>, encoding: Encoding) -> Option<Value> {
        Payload::new(bytes, encoding).to_json(&Limits::default())
    }

    fn cbor(value: &Cbor) -> Option<Value> {
        let mut bytes = Vec::new();
        ciborium::into_writer(value, &mut bytes).expect("written");
        shown(bytes, Encoding::CBOR)
    }

    #[test]
    fn numbers_that_json_cannot_express_become_texts() {
        let json = r#"{"a": NaN, "b": [-Infinity, Infinity], "NaN": "\"NaN, \\", "é": NaN}"#;
        let expected =
            json!({"a": "NaN", "b": ["-Infinity", "Infinity"], "NaN": "\"NaN, \\", "é": "NaN"});
        assert_eq!(shown(json, Encoding::JSON), Some(expected.clone()));
        assert_eq!(shown(json, Encoding::new("text/json")), Some(expected));
        for damaged in ["{", "NaNa", "\"NaN", "\\", "", "1e999"] {
            assert_eq!(shown(damaged, Encoding::JSON), None, "{damaged}");
        }
        let floats = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1.5].map(Cbor::Float);
        assert_eq!(
            cbor(&Cbor::Array(floats.into())),
            Some(json!(["NaN", "Infinity", "-Infinity", 1.5]))
        );
    }

    #[test]
    fn integers_of_more_than_64_bits_keep_their_digits_as_text() {
        let json = r#"[18446744073709551616, -9223372036854775809, 18446744073709551615,
            {"n":123456789012345678901234567890}, "18446744073709551616", 1.23456789012345678901, 12345678901234567890e2, 3.0]"#;
        let expected = json!([
            "18446744073709551616", "-9223372036854775809", u64::MAX,
            {"n": "123456789012345678901234567890"}, "18446744073709551616",
            1.234_567_890_123_456_8, 1.234_567_890_123_456_8e21, 3.0
        ]);
        assert_eq!(shown(json, Encoding::JSON), Some(expected));
        let large = Integer::try_from(-(i128::from(u64::MAX))).expect("an integer");
        let text = (-(i128::from(u64::MAX))).to_string();
        assert_eq!(cbor(&Cbor::Integer(large)), Some(json!(text)));
        for (number, text) in [
            (1_i128 << 70, "1180591620717411303424"),
            (-(1 << 70), "-1180591620717411303424"),
        ] {
            let mut bytes = Vec::new();
            ciborium::into_writer(&number, &mut bytes).expect("written");
            assert_eq!(shown(bytes, Encoding::CBOR), Some(json!(text)));
        }
    }

    #[test]
    fn keys_and_bytes_of_cbor_are_shown() {
        let value = Cbor::Map(vec![
            (Cbor::Integer(1.into()), Cbor::Text("one".to_owned())),
            (Cbor::Bool(true), Cbor::Integer(u64::MAX.into())),
            (Cbor::Text("blob".to_owned()), Cbor::Bytes(vec![0; 5])),
            (
                Cbor::Array(vec![Cbor::Integer((-1).into())]),
                Cbor::Tag(1, Box::new(Cbor::Float(0.5))),
            ),
        ]);
        let expected = json!({"1": "one", "true": u64::MAX, "blob": {"bytes": 5}, "[-1]": 0.5});
        assert_eq!(cbor(&value), Some(expected));
        assert_eq!(shown(vec![0xa1], Encoding::CBOR), None);
        assert_eq!(
            shown(vec![0x01], Encoding::new("application/cbor;x")),
            Some(json!(1))
        );
    }

    #[test]
    fn arrays_become_nested_lists() {
        let array = |shape: &[usize], numbers: &[f32]| {
            let array = Array::of(shape, numbers).expect("an array");
            array.to_payload().expect("a payload")
        };
        let flat = array(&[3], &[0.1, f32::NAN, -2.0]);
        assert_eq!(
            flat.to_json(&Limits::default()),
            Some(json!([0.1, "NaN", -2.0]))
        );
        let small = Limits {
            max_bytes: 11,
            ..Limits::default()
        };
        assert_eq!(flat.to_json(&small), None);
        let table = array(&[2, 2], &[1.0, 2.0, 3.0, 4.0]);
        let expected = Some(json!([[1.0, 2.0], [3.0, 4.0]]));
        assert_eq!(table.to_json(&Limits::default()), expected);
        let codec = Quantised::new(0.01).expect("a codec");
        let quantised = codec.encode(&table).expect("encoded");
        let shown = quantised.to_json(&Limits::default()).expect("a list");
        assert!((shown[1][0].as_f64().expect("a number") - 3.0).abs() <= 0.01);
        let empty = array(&[2, 0], &[]);
        assert_eq!(empty.to_json(&Limits::default()), Some(json!([[], []])));
        let whole = Array::of(&[2], &[i64::MIN, i64::MAX]).expect("an array");
        let whole = whole.to_payload().expect("a payload");
        assert_eq!(
            whole.to_json(&Limits::default()),
            Some(json!([i64::MIN, i64::MAX]))
        );
    }

    #[test]
    fn text_is_a_value_and_bytes_are_none() {
        assert_eq!(shown("hä", Encoding::TEXT), Some(json!("hä")));
        assert_eq!(shown(vec![0xff], Encoding::TEXT), None);
        assert_eq!(shown(vec![1], Encoding::BYTES), None);
        assert_eq!(shown(vec![1], Encoding::JPEG), None);
        assert_eq!(
            shown(
                vec![1],
                Encoding::new("application/octet-stream;array;f32;1")
            ),
            None
        );
    }
}
