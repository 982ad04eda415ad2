//! Owns a picture's way to the bytes of a level: made smaller, and written lossless or with a quality.
use super::ladder::{Coding, Level};
use crate::core::{
    codec::{jpeg::Jpeg, png::Png, webp::Webp, Codec, CodecError},
    payload::Payload,
    picture::Picture,
};

/// How pictures with a quality are written.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Photographs {
    /// JPEG: quick to write, and every program reads it.
    #[default]
    Jpeg,
    /// WebP: a quarter to a half smaller for the same look, and takes several times as long to write.
    Webp,
}

/// The picture at a level; without one it stays raw.
///
/// # Errors
/// The codec's.
pub fn encode(
    picture: &Picture,
    level: Option<Level>,
    photographs: Photographs,
) -> Result<Payload, CodecError> {
    let Some(level) = level else {
        return Ok(picture.clone().payload());
    };
    let side = |pixels: u32| (pixels * u32::from(level.quarters) / 4).max(1);
    let scaled = picture.scaled(side(picture.width()), side(picture.height()))?;
    let raw = scaled.payload();
    match (level.coding, photographs) {
        (Coding::Lossless, _) => Png.encode(&raw),
        (Coding::Lossy(quality), Photographs::Jpeg) => Jpeg::new(quality).encode(&raw),
        (Coding::Lossy(quality), Photographs::Webp) => Webp::new(quality).encode(&raw),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::{codec::Limits, picture::Format, stream::ladder::PICTURES};

    #[test]
    fn each_step_gives_a_picture_of_its_size_that_can_be_read() {
        let (width, height) = (160, 120);
        let pixels: Vec<u8> = (0..width * height * 3)
            .map(|n| (n * 7 % 251) as u8)
            .collect();
        let picture = Picture::new(width, height, Format::Rgb8, pixels).expect("a picture");
        for photographs in [Photographs::Jpeg, Photographs::Webp] {
            for level in PICTURES {
                let payload = encode(&picture, Some(level), photographs).expect("written");
                let read = payload.picture(&Limits::default()).expect("a picture");
                let quarters = u32::from(level.quarters);
                assert_eq!(read.width(), width * quarters / 4, "{level}");
                assert_eq!(read.height(), height * quarters / 4, "{level}");
                if level.coding == Coding::Lossless {
                    assert_eq!(read, picture);
                }
            }
        }
        let raw = encode(&picture, None, Photographs::Jpeg).expect("raw");
        assert_eq!(raw.picture(&Limits::default()).expect("a picture"), picture);
    }
}
