//! Frames of a video that have arrived and are not decoded yet. A program that reads only the newest frame needs the ones
//! before it, too.
use std::collections::VecDeque;

use bytes::Bytes;

use super::Decoder;
use crate::core::{codec_error::CodecError, limits::Limits, picture::Picture};

/// The number of bytes and frames that wait for a program that does not read, at most. Beyond them, all are dropped, and the
/// video continues with the next key frame.
const MAX_BYTES: usize = 8 << 20;
/// See [`MAX_BYTES`].
const MAX_FRAMES: usize = 600;

/// The frames since the last key frame that have not been decoded.
#[derive(Debug, Default)]
pub struct Pending {
    frames: VecDeque<(u64, Bytes)>,
    bytes: usize,
    decoder: Decoder,
    /// Whether frames are useless until there is a key frame.
    needs_key: bool,
    /// Whether the program decodes the video itself.
    is_undecoded: bool,
    /// Whether the program wants a key frame, although the frames could be decoded without one.
    is_asked_for: bool,
}

impl Pending {
    /// Creates an empty queue, which begins with a key frame.
    pub fn new() -> Self {
        Self {
            needs_key: true,
            ..Self::default()
        }
    }

    /// Leaves the decoding to the program: no frame is kept here.
    pub fn leave_undecoded(&mut self) {
        self.is_undecoded = true;
        self.clear();
    }

    /// Returns whether the program decodes the video itself.
    pub fn is_undecoded(&self) -> bool {
        self.is_undecoded
    }

    /// Asks for a key frame, for a decoder of the program.
    pub fn ask_for_key(&mut self) {
        self.is_asked_for = true;
    }

    /// Returns whether the sender is to be asked for a key frame: nothing can be decoded until there is one, or the program
    /// wants one.
    pub fn needs_key(&self) -> bool {
        self.needs_key || self.is_asked_for
    }

    /// Handles that a frame is missing: those after it cannot be decoded.
    pub fn on_gap(&mut self) {
        self.needs_key = true;
    }

    /// Handles a frame that has arrived. Returns whether it can be decoded.
    pub fn on_frame(&mut self, ordinal: u64, bytes: &Bytes, is_key: bool) -> bool {
        if is_key {
            self.clear();
            self.needs_key = false;
            self.is_asked_for = false;
        }
        if self.needs_key || self.is_undecoded {
            return !self.needs_key;
        }
        self.frames.push_back((ordinal, bytes.clone()));
        self.bytes += bytes.len();
        if self.bytes > MAX_BYTES || self.frames.len() > MAX_FRAMES {
            self.clear();
            self.needs_key = true;
        }
        !self.needs_key
    }

    /// Decodes the frames up to `ordinal`, and returns the picture of the last one; `None` if it is not available any more,
    /// because a later key frame has arrived.
    ///
    /// # Errors
    /// Returns the error of the decoder. The video continues with the next key frame.
    pub fn decode(&mut self, ordinal: u64, limits: &Limits) -> Result<Option<Picture>, CodecError> {
        let mut newest = None;
        while self
            .frames
            .front()
            .is_some_and(|(waiting, _)| *waiting <= ordinal)
        {
            let Some((_, bytes)) = self.frames.pop_front() else {
                break;
            };
            self.bytes -= bytes.len();
            match self.decoder.decode(&bytes, limits) {
                Ok(picture) => newest = picture,
                Err(error) => {
                    self.clear();
                    self.needs_key = true;
                    return Err(error);
                }
            }
        }
        Ok(newest)
    }

    fn clear(&mut self) {
        self.frames.clear();
        self.bytes = 0;
    }
}
