//! Encodes the pictures of a stream: as video, or at a step of the ladder, for which it scales them, and compresses them
//! losslessly or with a quality.
use std::time::Instant;

use super::{
    job::Job,
    ladder::{Coding, Step},
};
use crate::{
    codec::{jpeg::Jpeg, picture::Picture, png::Png, webp::Webp, Codec, CodecError},
    message::payload::Payload,
    video::Encoder,
};

/// The format of pictures that are compressed with a quality.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LossyFormat {
    /// JPEG: fast to encode, and supported by every program. The default.
    #[default]
    Jpeg,
    /// WebP: a quarter to a half smaller at the same quality, but several times slower to encode.
    Webp,
}

/// Encodes the pictures of one stream.
#[derive(Debug)]
pub struct PictureEncoder {
    lossy_format: LossyFormat,
    /// The video of each group.
    videos: [Encoder; 2],
}

impl PictureEncoder {
    /// Creates the encoder of a stream.
    pub fn new(lossy_format: LossyFormat) -> Self {
        Self {
            lossy_format,
            videos: Default::default(),
        }
    }

    /// Encodes a picture for a job.
    ///
    /// # Errors
    /// Returns the error of the codec.
    pub fn encode(
        &mut self,
        picture: &Picture,
        job: Job,
        now: Instant,
    ) -> Result<Payload, CodecError> {
        match job.video {
            Some(settings) => self.videos[job.group.index()].encode(picture, settings, now),
            None => encode(picture, job.step, self.lossy_format),
        }
    }
}

/// Encodes a picture at a step. Without a step, it stays raw.
fn encode(
    picture: &Picture,
    step: Option<Step>,
    lossy_format: LossyFormat,
) -> Result<Payload, CodecError> {
    let Some(step) = step else {
        return Ok(picture.clone().payload());
    };
    let side = |pixels: u32| (pixels * u32::from(step.quarters) / 4).max(1);
    let scaled = picture.scaled(side(picture.width()), side(picture.height()))?;
    let raw = scaled.payload();
    match (step.coding, lossy_format) {
        (Coding::Lossless, _) => Png.encode(&raw),
        (Coding::Lossy(quality), LossyFormat::Jpeg) => Jpeg::new(quality).encode(&raw),
        (Coding::Lossy(quality), LossyFormat::Webp) => Webp::new(quality).encode(&raw),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        codec::{picture::Format, Limits},
        stream::ladder::PICTURES,
    };

    #[test]
    fn pictures_of_each_step_have_its_size() {
        let (width, height) = (160, 120);
        let pixels: Vec<u8> = (0..width * height * 3)
            .map(|n| (n * 7 % 251) as u8)
            .collect();
        let picture = Picture::new(width, height, Format::Rgb8, pixels).expect("a picture");
        for lossy_format in [LossyFormat::Jpeg, LossyFormat::Webp] {
            for step in PICTURES {
                let payload = encode(&picture, Some(step), lossy_format).expect("written");
                let read = payload.picture(&Limits::default()).expect("a picture");
                let quarters = u32::from(step.quarters);
                assert_eq!(read.width(), width * quarters / 4, "{step}");
                assert_eq!(read.height(), height * quarters / 4, "{step}");
                if step.coding == Coding::Lossless {
                    assert_eq!(read, picture);
                }
            }
        }
        let raw = encode(&picture, None, LossyFormat::Jpeg).expect("raw");
        assert_eq!(raw.picture(&Limits::default()).expect("a picture"), picture);
    }
}
