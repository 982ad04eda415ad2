//! Defines [`Limits`]: how large a decoded payload may be.
use crate::message::codec_error::{damaged, CodecError};

/// The limits of a decoder, which protect a receiver against malicious peers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Maximum size of a decoded payload, in bytes. Default: 64 MiB.
    pub max_bytes: usize,
    /// Maximum number of pixels of a picture. Default: 16 million.
    pub max_pixels: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            max_bytes: 64 << 20,
            max_pixels: 16_000_000,
        }
    }
}

impl Limits {
    /// No limits, for data that is already in memory.
    pub(crate) fn any() -> Self {
        Self {
            max_bytes: isize::MAX as usize,
            max_pixels: usize::MAX,
        }
    }

    /// Returns the size in bytes of a picture of these dimensions, if the limits allow it.
    pub(crate) fn picture(
        &self,
        format: &'static str,
        [width, height]: [u32; 2],
        channels: usize,
    ) -> Result<usize, CodecError> {
        if width == 0 || height == 0 {
            return Err(damaged(format, format!("{width}x{height} pixels")));
        }
        let pixels = u64::from(width) * u64::from(height);
        if pixels > self.max_pixels as u64 {
            return Err(CodecError::TooLarge {
                format,
                found: format!("{width}x{height} pixels"),
                limit: format!("{} pixels", self.max_pixels),
            });
        }
        self.bytes(format, pixels.saturating_mul(channels as u64))
    }

    /// Returns `bytes` if the limits allow it.
    pub(crate) fn bytes(&self, format: &'static str, bytes: u64) -> Result<usize, CodecError> {
        match usize::try_from(bytes) {
            Ok(bytes) if bytes <= self.max_bytes => Ok(bytes),
            _ => Err(CodecError::TooLarge {
                format,
                found: format!("{bytes} bytes"),
                limit: format!("{} bytes", self.max_bytes),
            }),
        }
    }
}
