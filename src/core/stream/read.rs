//! Reads the frames of a stream for the program: decodes video, and counts what the program did not read.
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::frame::{Frame, ReceivedFrame};
use crate::core::{
    codec::Limits,
    payload::Payload,
    picture::Picture,
    video::{bitstream, pending::Pending, Decoder, IS_AVAILABLE},
};

/// The frames of a video that wait for the program. The receiving end adds them; the reader decodes them.
#[derive(Clone, Debug)]
pub(super) struct SharedPending(Arc<Mutex<Pending>>);

impl SharedPending {
    pub(super) fn new() -> Self {
        Self(Arc::new(Mutex::new(Pending::new())))
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Pending> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Reads the frames of one stream in the order of their arrival.
#[derive(Debug)]
pub struct FrameReader {
    pending: SharedPending,
    decoder: Decoder,
    last: Option<u64>,
}

impl FrameReader {
    pub(super) fn new(pending: SharedPending) -> Self {
        Self {
            pending,
            decoder: Decoder::default(),
            last: None,
        }
    }

    /// Reads a frame. Returns `None` if there is nothing to show: it is damaged, or a later one replaces it.
    pub fn read(&mut self, frame: ReceivedFrame) -> Option<Frame> {
        let sent_bytes = frame.payload.bytes.len();
        let payload = match bitstream::is_video(&frame.payload) {
            true => self.decoded(&frame)?,
            false => frame.payload,
        };
        Some(Frame {
            payload,
            number: frame.number,
            age: frame.age,
            skipped: self.count(frame.ordinal),
            sent_bytes,
        })
    }

    fn decoded(&mut self, frame: &ReceivedFrame) -> Option<Payload> {
        // Not locked while frames are decoded, because the receiving end adds others meanwhile.
        let frames = {
            let mut pending = self.pending.lock();
            if pending.is_undecoded() || !IS_AVAILABLE {
                return Some(frame.payload.clone());
            }
            pending.take(frame.ordinal)
        };
        let mut newest = None;
        for bytes in frames {
            match self.decoder.decode(&bytes, &Limits::default()) {
                Ok(picture) => newest = picture,
                Err(_) => {
                    self.pending.lock().on_damage();
                    return None;
                }
            }
        }
        newest.map(Picture::payload)
    }

    fn count(&mut self, ordinal: u64) -> u32 {
        let last = self.last.replace(ordinal);
        let skipped = last.map_or(0, |last| ordinal.saturating_sub(last + 1));
        u32::try_from(skipped).unwrap_or(u32::MAX)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::core::encoding::Encoding;

    #[test]
    fn counts_the_frames_that_the_program_did_not_read() {
        let mut reader = FrameReader::new(SharedPending::new());
        let skipped = [3, 4, 7].map(|ordinal| {
            let frame = ReceivedFrame {
                payload: Payload::new("1", Encoding::JSON),
                number: 0,
                age: None,
                ordinal,
            };
            reader.read(frame).map(|frame| frame.skipped)
        });
        assert_eq!(skipped, [Some(0), Some(0), Some(2)]);
    }
}
