//! Decodes untrusted raw pictures and arrays with any encoding. A decoded value must encode to the same value, and its
//! quantised form must respect the error bound.
use rect_core::{codec::{array::{Array, Element}, parse, Limits}, message::{encoding::Encoding, payload::{Payload, ToPayload}}};

const LIMITS: Limits = Limits {
    max_bytes: 1 << 20,
    max_pixels: 1 << 18,
};
const ERROR: f64 = 0.01;

fn check_error_bound(array: &Array, payload: &Payload) {
    let codec = parse("quantised:0.01").expect("a codec");
    let small = codec.encode(payload).expect("encodes");
    let back = small.array(&LIMITS).expect("decodes");
    assert_eq!(back.shape(), array.shape());
    let as_f64 = |array: &Array| -> Vec<f64> {
        array.numbers::<f64>().unwrap_or_else(|| {
            let numbers = array.numbers::<f32>().expect("floats");
            numbers.into_iter().map(f64::from).collect()
        })
    };
    for (a, b) in as_f64(array).into_iter().zip(as_f64(&back)) {
        assert!(a.is_nan() && b.is_nan() || a == b || (a - b).abs() <= ERROR);
    }
}

/// Splits the input into the text before the first line break and the bytes after it.
fn split(data: &[u8]) -> Option<(&str, &[u8])> {
    let end = data.iter().position(|&byte| byte == b'\n')?;
    let text = std::str::from_utf8(&data[..end]).ok()?;
    Some((text, &data[end + 1..]))
}

/// Runs the target on one input.
pub fn run(data: &[u8]) {
    let Some((text, bytes)) = split(data) else {
        return;
    };
    let encoding = Encoding::new(format!("application/octet-stream;{text}"));
    let payload = Payload::new(bytes.to_vec(), encoding);
    if let Ok(picture) = payload.picture(&LIMITS) {
        let again = picture.to_payload().expect("encodes");
        assert_eq!(
            again.picture(&LIMITS).expect("decodes its own payload"),
            picture
        );
        let small = parse("png").expect("a codec").encode(&again);
        let back = small.expect("encodes").picture(&LIMITS).expect("decodes");
        assert_eq!(back, picture);
    }
    if let Ok(array) = payload.array(&LIMITS) {
        let again = array.to_payload().expect("encodes");
        assert_eq!(
            again.array(&LIMITS).expect("decodes its own payload"),
            array
        );
        if matches!(array.element(), Element::F32 | Element::F64) {
            check_error_bound(&array, &again);
        }
    }
}
