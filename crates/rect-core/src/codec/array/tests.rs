//! Tests arrays of every type, and invalid ones.
use proptest::prelude::*;

use super::*;

fn raw(schema: &str, bytes: usize) -> Payload {
    let encoding = format!("application/octet-stream;{schema}");
    Payload::new(vec![0; bytes], Encoding::new(encoding))
}

fn round_trips<T: Number + PartialEq + std::fmt::Debug>(
    numbers: &[T],
    shape: &[usize],
    text: &str,
) {
    let array = Array::of(shape, numbers).expect("an array");
    let payload = array.to_payload().expect("written");
    assert_eq!(payload.encoding.schema(), Some(text));
    let back = payload.array(&Limits::default()).expect("read");
    assert_eq!((&back, back.shape()), (&array, shape));
    assert_eq!(back.numbers::<T>().as_deref(), Some(numbers));
}

#[test]
fn arrays_of_every_type_round_trip() {
    round_trips(&[1u8, 255], &[2], "array;u8;2");
    round_trips(&[-1i8, 5], &[2, 1], "array;i8;2x1");
    round_trips(&[65535u16, 5], &[1, 2], "array;u16;1x2");
    round_trips(
        &[-2i16],
        &[1, 1, 1, 1, 1, 1, 1, 1],
        "array;i16;1x1x1x1x1x1x1x1",
    );
    round_trips(&[u32::MAX], &[1], "array;u32;1");
    round_trips(&[i32::MIN], &[1], "array;i32;1");
    round_trips(&[i64::MIN, i64::MAX], &[2], "array;i64;2");
    round_trips(&[0.1f32, f32::INFINITY], &[2], "array;f32;2");
    round_trips(&[0.1f64; 6], &[3, 2], "array;f64;3x2");
    round_trips::<f64>(&[], &[0, 3], "array;f64;0x3");
    assert_eq!(Array::of(&[1], &[1u8]).expect("one").numbers::<i8>(), None);
    let little = Array::of(&[1], &[0x0102u16]).expect("one");
    assert_eq!(&little.bytes()[..], [2, 1], "little endian");
}

#[test]
fn shapes_that_do_not_match_are_rejected() {
    assert!(Array::of(&[], &[1u8]).is_err());
    assert!(Array::of(&[1; 9], &[1u8]).is_err());
    assert!(Array::of(&[3], &[1u8]).is_err());
    assert!(Array::of(&[usize::MAX, 2], &[1u8]).is_err());
    for schema in [
        "array;f32;2",
        "array;f16;1",
        "array;f32;",
        "array;f32",
        "array;f32;1x",
        "array;f32;-1",
        "array;u8;1x1x1x1x1x1x1x1x1",
        "array;f32;99999999999999999999999",
    ] {
        let error = raw(schema, 4).array(&Limits::default()).expect_err(schema);
        let damaged = matches!(error, PayloadError::Codec(CodecError::Damaged { .. }));
        assert!(damaged, "{schema}: {error}");
    }
    let long = format!("array;u8;{}", "1x".repeat(80));
    assert!(raw(&long, 1).array(&Limits::default()).is_err());
    for absurd in ["array;u8;4294967295x4294967295", "array;u8;0x4294967295"] {
        let error = raw(absurd, 0).array(&Limits::default()).expect_err(absurd);
        assert!(matches!(
            error,
            PayloadError::Codec(CodecError::TooLarge { .. })
        ));
    }
    for other in [
        raw("picture;rgb8;1x1", 3),
        Payload::new("[1]", Encoding::JSON),
    ] {
        let error = other.array(&Limits::default()).expect_err("no array");
        assert!(matches!(error, PayloadError::Mismatch { .. }));
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn arrays_of_any_shape_round_trip(shape in prop::collection::vec(0..5usize, 1..=8), element in 0..9usize) {
        let element = Element::ALL[element];
        let count: usize = shape.iter().product();
        let array = Array::new(element, &shape, vec![7; count * element.bytes()]).expect("an array");
        let payload = array.to_payload().expect("written");
        prop_assert_eq!(payload.array(&Limits::default()).expect("read"), array);
    }
}
