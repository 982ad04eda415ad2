//! Frames of a video that have arrived and are not decoded yet. A program that reads only the newest frame needs the ones
//! before it, too.
use std::collections::VecDeque;

use bytes::Bytes;

/// The number of bytes and frames that wait for a program that does not read, at most. Beyond them, the oldest are dropped, up to
/// the next key frame.
const MAX_BYTES: usize = 8 << 20;
/// See [`MAX_BYTES`].
const MAX_FRAMES: usize = 600;

/// The frames since the last key frame that have not been decoded.
#[derive(Debug, Default)]
pub struct Pending {
    frames: VecDeque<Frame>,
    bytes: usize,
    /// Whether frames are useless until there is a key frame.
    needs_key: bool,
    /// Whether the program decodes the video itself.
    is_undecoded: bool,
    /// Whether the program wants a key frame, although the frames could be decoded without one.
    is_asked_for: bool,
}

#[derive(Debug)]
struct Frame {
    ordinal: u64,
    bytes: Bytes,
    is_key: bool,
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

    /// Handles that a frame is missing: those that follow cannot be decoded.
    pub fn on_gap(&mut self) {
        self.needs_key = true;
    }

    /// Handles that a frame is damaged: those that wait cannot be decoded either.
    pub fn on_damage(&mut self) {
        self.clear();
        self.needs_key = true;
    }

    /// Handles a frame that has arrived. Returns whether it can be decoded.
    pub fn on_frame(&mut self, ordinal: u64, bytes: &Bytes, is_key: bool) -> bool {
        if is_key {
            self.needs_key = false;
            self.is_asked_for = false;
        }
        if self.needs_key || self.is_undecoded {
            return !self.needs_key;
        }
        self.bytes += bytes.len();
        self.frames.push_back(Frame {
            ordinal,
            bytes: bytes.clone(),
            is_key,
        });
        while self.bytes > MAX_BYTES || self.frames.len() > MAX_FRAMES {
            self.drop_oldest();
        }
        !self.needs_key
    }

    /// Drops the frames up to the next key frame; if there is none, all.
    fn drop_oldest(&mut self) {
        let next_key = self.frames.iter().skip(1).position(|frame| frame.is_key);
        let Some(before) = next_key else {
            self.on_damage();
            return;
        };
        let dropped = self.frames.drain(..=before);
        self.bytes -= dropped.map(|frame| frame.bytes.len()).sum::<usize>();
    }

    /// Removes and returns the frames up to `ordinal` that are needed for its picture, in the order in which they are to be
    /// decoded.
    pub fn take(&mut self, ordinal: u64) -> Vec<Bytes> {
        let count = self
            .frames
            .partition_point(|frame| frame.ordinal <= ordinal);
        let taken: Vec<Frame> = self.frames.drain(..count).collect();
        self.bytes -= taken.iter().map(|frame| frame.bytes.len()).sum::<usize>();
        // Nothing before a key frame is needed.
        let first = taken.iter().rposition(|frame| frame.is_key).unwrap_or(0);
        let needed = taken.into_iter().skip(first);
        needed.map(|frame| frame.bytes).collect()
    }

    fn clear(&mut self) {
        self.frames.clear();
        self.bytes = 0;
    }
}
