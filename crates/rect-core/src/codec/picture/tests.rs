//! Tests raw pictures and scaling.
use super::*;

fn raw(schema: &str, bytes: usize) -> Payload {
    let encoding = format!("application/octet-stream;{schema}");
    Payload::new(vec![0; bytes], Encoding::new(encoding))
}

#[test]
fn pictures_round_trip_without_a_copy() {
    let picture = Picture::new(3, 2, Format::Rgb8, vec![9; 18]).expect("a picture");
    let payload = picture.to_payload().expect("written");
    assert_eq!(
        payload.encoding.as_str(),
        "application/octet-stream;picture;rgb8;3x2"
    );
    let back = payload.picture(&Limits::default()).expect("read");
    assert_eq!(back, picture);
    assert_eq!(back.pixels().as_ptr(), picture.pixels().as_ptr());
}

#[test]
fn sizes_that_do_not_match_are_rejected() {
    for (width, height, bytes) in [(0, 2, 0), (2, 0, 0), (2, 2, 11), (2, 2, 13)] {
        assert!(Picture::new(width, height, Format::Rgb8, vec![0; bytes]).is_err());
    }
    assert!(Picture::new(u32::MAX, u32::MAX, Format::Rgba8, vec![]).is_err());
    for (schema, bytes) in [
        ("picture;rgb8;2x2", 11),
        ("picture;rgb8;0x0", 0),
        ("picture;rgb9;2x2", 12),
        ("picture;rgb8;2", 12),
        ("picture;rgb8;2x2x2", 24),
        ("picture;rgb8;-2x2", 12),
        ("picture;rgb8", 12),
        ("picture;rgb8;99999999999x1", 12),
    ] {
        let error = raw(schema, bytes).picture(&Limits::default());
        let error = error.expect_err(schema);
        let damaged = matches!(error, PayloadError::Codec(CodecError::Damaged { .. }));
        assert!(damaged, "{schema}: {error}");
    }
    let absurd = raw("picture;rgba8;4000000000x4000000000", 12);
    let error = absurd.picture(&Limits::default()).expect_err("absurd");
    assert!(matches!(
        error,
        PayloadError::Codec(CodecError::TooLarge { .. })
    ));
}

#[test]
fn other_payloads_are_not_pictures() {
    for payload in [
        Payload::new("{}", Encoding::JSON),
        raw("array;u8;4", 4),
        raw("pictures;rgb8;2x2", 12),
        Payload::new("", Encoding::new("text/plain;picture;rgb8;2x2")),
    ] {
        let error = payload.picture(&Limits::default()).expect_err("no picture");
        assert!(matches!(error, PayloadError::Mismatch { .. }), "{error}");
    }
}

#[test]
fn a_scaled_picture_has_the_mean_of_the_pixels() {
    for (format, channels) in [(Format::Grey8, 1), (Format::Rgb8, 3), (Format::Rgba8, 4)] {
        // Alternating columns of 0 and 200, all opaque.
        let pixel = |x: usize| {
            let mut pixel = vec![(x % 2) as u8 * 200; channels];
            if channels == 4 {
                pixel[3] = 255;
            }
            pixel
        };
        let pixels: Vec<u8> = (0..64 * 48).flat_map(pixel).collect();
        let picture = Picture::new(64, 48, format, pixels).expect("a picture");
        let small = picture.scaled(16, 12).expect("smaller");
        assert_eq!((small.width(), small.height()), (16, 12));
        let middle = &small.pixels()[5 * channels..6 * channels];
        let colors = &middle[..channels.min(3)];
        assert!(colors.iter().all(|c| c.abs_diff(100) < 20), "{middle:?}");
        assert_eq!(picture.scaled(64, 48).expect("the same"), picture);
        let large = picture.scaled(100, 90).expect("larger");
        assert_eq!(large.pixels().len(), 9000 * channels);
        assert!(picture.scaled(0, 10).is_err());
        assert!(picture.scaled(u32::MAX, u32::MAX).is_err());
    }
}
