//! Decodes video into pictures.
use std::fmt;

#[cfg(feature = "video")]
use openh264::formats::YUVSource;

#[cfg(feature = "video")]
use super::{bitstream, FORMAT};
#[cfg(feature = "video")]
use crate::{codec::picture::Format, message::codec_error::damaged};
use crate::{
    codec::{picture::Picture, Limits},
    message::codec_error::CodecError,
};

/// Decodes the frames of one video, which come from a peer and may be damaged or hostile.
#[derive(Default)]
pub struct Decoder {
    #[cfg(feature = "video")]
    running: Option<openh264::decoder::Decoder>,
}

/// Returns the error of a program that was built without video.
#[cfg(not(feature = "video"))]
pub(super) fn unavailable() -> CodecError {
    CodecError::Unknown {
        name: "h264".to_owned(),
        available: "this program was built without the feature `video`",
    }
}

#[cfg(not(feature = "video"))]
impl Decoder {
    /// Fails: this program was built without video.
    ///
    /// # Errors
    /// Always returns [`CodecError::Unknown`].
    pub fn decode(&mut self, _: &[u8], _: &Limits) -> Result<Option<Picture>, CodecError> {
        Err(unavailable())
    }
}

#[cfg(feature = "video")]
impl Decoder {
    /// Decodes a frame. All frames since the last key frame must have been decoded before. Returns `None` if the frame has no
    /// picture.
    ///
    /// # Errors
    /// Returns a [`CodecError`] if the frame is damaged, or the pictures exceed the limits. The next frame must be a key frame
    /// then.
    pub fn decode(&mut self, bytes: &[u8], limits: &Limits) -> Result<Option<Picture>, CodecError> {
        bitstream::check(bytes, limits)?;
        limits.bytes(FORMAT, bytes.len() as u64)?;
        let mut decoder = match self.running.take() {
            Some(decoder) => decoder,
            None => openh264::decoder::Decoder::new().map_err(|error| damaged(FORMAT, error))?,
        };
        // A decoder that has failed is not used again.
        let picture = match decoder.decode(bytes) {
            Err(error) => return Err(damaged(FORMAT, error)),
            Ok(None) => None,
            Ok(Some(decoded)) => {
                let (width, height) = decoded.dimensions();
                let size = [width, height].map(|side| u32::try_from(side).unwrap_or(u32::MAX));
                let mut pixels = vec![0; limits.picture(FORMAT, size, 3)?];
                decoded.write_rgb8(&mut pixels);
                Some(Picture::new(size[0], size[1], Format::Rgb8, pixels)?)
            }
        };
        self.running = Some(decoder);
        Ok(picture)
    }
}

impl fmt::Debug for Decoder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Decoder").finish_non_exhaustive()
    }
}
