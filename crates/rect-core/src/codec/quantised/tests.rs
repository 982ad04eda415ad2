//! Tests that the error bound holds for every number, and that the encoded arrays are small.
use proptest::prelude::*;

use super::*;
use crate::message::payload::ToPayload;

const LIMITS: Limits = Limits {
    max_bytes: 1 << 20,
    max_pixels: 1,
};

fn round_trip<T: Float>(error: f64, shape: &[usize], numbers: &[T]) -> (usize, Vec<T>) {
    let array = Array::of(shape, numbers).expect("an array").payload();
    let codec = Quantised::new(error).expect("an error");
    let small = codec.encode(&array).expect("written");
    assert_eq!(small.encoding.as_str(), ENCODING);
    let back = small.array(&LIMITS).expect("read");
    assert_eq!(back.shape(), shape);
    let again = codec.decode(&small, &LIMITS).expect("read");
    assert_eq!(again, back.to_payload().expect("written"));
    (small.bytes.len(), back.numbers().expect("the same type"))
}

fn near<T: Float>(a: T, b: T, error: f64) -> bool {
    let (a, b) = (a.wide(), b.wide());
    (a.is_nan() && b.is_nan()) || a == b || (a - b).abs() <= error
}

fn all_near<T: Float>(error: f64, shape: &[usize], numbers: &[T]) -> usize {
    let (bytes, back) = round_trip(error, shape, numbers);
    for (n, (&a, &b)) in numbers.iter().zip(&back).enumerate() {
        assert!(near(a, b, error), "{n}: {} became {}", a.wide(), b.wide());
    }
    assert_eq!(numbers.len(), back.len());
    bytes
}

#[test]
fn smooth_data_takes_less_than_a_byte_per_number() {
    let n = 3000;
    let wave: Vec<f32> = (0..n).map(|i| (i as f32 / 60.0).sin() * 9.81).collect();
    let bytes = all_near(0.01, &[n], &wave);
    assert!(bytes < n, "{bytes} bytes for {n} numbers");
    // Three interleaved channels: the distance is the length of a row.
    let turns: Vec<f64> = (0..n)
        .map(|i| (i as f64 / 90.0).sin() + [0.0, 9.81, -40.0][i % 3])
        .collect();
    let bytes = all_near(0.001, &[n / 3, 3], &turns);
    assert!(bytes < n, "{bytes} bytes for {n} numbers");
}

#[test]
fn few_numbers_take_no_more_than_raw_ones_and_the_header() {
    let bytes = all_near(0.01, &[6], &[1.5f32, -2.0, 0.0, 90.0, 45.25, 3.0]);
    assert!(bytes <= 3 + 24, "{bytes}");
    assert_eq!(all_near(0.01, &[0], &[0f32; 0]), 3, "an empty one");
}

#[test]
fn exceptions_are_exact() {
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        f64::MIN_POSITIVE,
        1e300,
        -0.0,
        0.1,
    ];
    for error in [1e-30, 1e-9, 0.5, 1e30] {
        all_near(error, &[8], &odd);
        all_near(error, &[2, 4], &odd);
        let (_, back) = round_trip(error, &[8], &odd);
        assert_eq!(back[5], 1e300, "beyond all levels");
        all_near(error, &[8], &odd.map(|wide| wide as f32));
    }
    // Many exceptions in smooth data, like a laser scanner without echoes in some directions.
    let scan: Vec<f32> = (0..720)
        .map(|i| {
            if i % 9 < 2 {
                f32::INFINITY
            } else {
                2.0 + i as f32 / 500.0
            }
        })
        .collect();
    let bytes = all_near(0.005, &[720], &scan);
    assert!(bytes < 720, "{bytes}");
}

/// A regression found by fuzzing: all residuals take more bytes than the numbers.
#[test]
fn arrays_that_do_not_shrink_are_stored_raw() {
    let far: Vec<f32> = (0..120)
        .map(|n| if n % 2 == 0 { 4e9 } else { -4e9 })
        .collect();
    let bytes = all_near(0.01, &[120], &far);
    assert_eq!(bytes, 3 + 480);
}

#[test]
fn truncated_arrays_are_errors_that_name_the_format() {
    let numbers: Vec<f32> = (0..8)
        .map(|i| if i == 7 { f32::NAN } else { (i * i) as f32 })
        .collect();
    let array = Array::of(&[2, 4], &numbers).expect("an array").payload();
    let noise: Vec<f32> = (0..40).map(|i| (i as f32 * 1e9).sin() * 1e30).collect();
    let noise = Array::of(&[40], &noise).expect("an array").payload();
    let long: Vec<f64> = (0..1000).map(f64::from).collect();
    let long = Array::of(&[1000], &long).expect("an array").payload();
    for (array, kind) in [(array, PLAIN), (noise, RAW), (long, COMPRESSED)] {
        let small = Quantised::new(0.1)
            .expect("an error")
            .encode(&array)
            .expect("written");
        assert_eq!(small.bytes[1] >> 3, kind);
        for cut in 0..small.bytes.len() {
            let cut = Payload::new(small.bytes.slice(..cut), small.encoding.clone());
            let error = cut.array(&LIMITS).expect_err("cut").to_string();
            let named = ["quantised array", "zstd", "invalid array"];
            assert!(named.iter().any(|name| error.contains(name)), "{error}");
        }
        let more = [&small.bytes[..], &[0]].concat();
        assert!(
            read(&more, &LIMITS).is_err(),
            "longer than its header states"
        );
        for n in 0..small.bytes.len() {
            for flip in [1, 0x80, 0xff] {
                let mut wrong = small.bytes.to_vec();
                wrong[n] ^= flip;
                let _ = read(&wrong, &LIMITS);
            }
        }
    }
}

#[test]
fn headers_beyond_the_limits_are_rejected() {
    let step = 1f32.to_le_bytes();
    let huge = [
        &[0x12, 0][..],
        &[0xff, 0xff, 0xff, 0x7f, 0xff, 0xff, 0x7f],
        &step,
        &[1, 0],
    ]
    .concat();
    let error = read(&huge, &LIMITS).expect_err("huge");
    assert!(matches!(error, CodecError::TooLarge { .. }), "{error}");
    // The size is within the limit, but the body is missing.
    let empty = [&[0x11, 0][..], &[0x80, 0x80, 0x08], &step, &[1, 0]].concat();
    assert!(matches!(
        read(&empty, &LIMITS),
        Err(CodecError::Damaged { .. })
    ));
    for (n, wrong) in [
        (0, 0x21),
        (0, 0x10),
        (0, 0x19),
        (1, 0x06),
        (1, 0x18),
        (1, 0x20),
        (7, 0),
        (8, 9),
    ] {
        let mut bytes = [&[0x11, 0][..], &[1], &step, &[1, 0], &[0]].concat();
        assert!(read(&bytes, &LIMITS).is_ok());
        bytes[n] = wrong;
        assert!(read(&bytes, &LIMITS).is_err(), "byte {n}: {wrong}");
    }
    for step in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let bytes = [&[0x11, 0, 1][..], &step.to_le_bytes(), &[1, 0, 0]].concat();
        assert!(read(&bytes, &LIMITS).is_err(), "a step of {step}");
    }
}

#[test]
fn only_arrays_of_floats_are_quantised() {
    let whole = Array::of(&[2], &[1i32, 2]).expect("an array").payload();
    let error = Quantised::new(1.0).expect("an error").encode(&whole);
    let error = error.expect_err("whole numbers").to_string();
    assert!(error.contains("array;i32;2"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn the_bound_holds_for_any_f32(
        numbers in prop::collection::vec(any::<f32>(), 0..200), exponent in -30..=30i32
    ) {
        all_near(10f64.powi(exponent).clamp(1e-30, 1e30), &[numbers.len()], &numbers);
    }

    #[test]
    fn the_bound_holds_for_any_f64(
        numbers in prop::collection::vec(any::<f64>(), 0..200), exponent in -30..=30i32
    ) {
        all_near(10f64.powi(exponent).clamp(1e-30, 1e30), &[numbers.len()], &numbers);
    }

    #[test]
    fn the_bound_holds_for_sensor_data(
        start in -1e4..1e4f64, steps in prop::collection::vec(-0.3..0.3f64, 6..300), error in 1e-4..0.5f64
    ) {
        let mut value = start;
        let walk: Vec<f64> = steps.iter().map(|step| { value += step; value }).collect();
        let narrow: Vec<f32> = walk.iter().map(|&wide| wide as f32).collect();
        let rows = walk.len() / 3;
        all_near(error, &[rows, 3], &walk[..rows * 3]);
        all_near(error, &[walk.len()], &narrow);
    }
}
