//! Reads the frames of a stream for the program: decodes video, and counts what the program did not read.
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use super::frame::{Frame, ReceivedFrame};
use crate::{
    codec::{picture::Picture, Limits},
    message::payload::Payload,
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
    /// The ordinal of the previous frame, and how many had not arrived until then.
    last: Option<(u64, u64)>,
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
        let (skipped, lost) = self.count(frame.ordinal, frame.lost);
        Some(Frame {
            payload,
            number: frame.number,
            age: frame.age,
            skipped,
            lost,
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

    /// Returns how many frames were skipped before this one, and how many of them did not arrive.
    fn count(&mut self, ordinal: u64, lost: u64) -> (u32, u32) {
        let Some((last, lost_before)) = self.last.replace((ordinal, lost)) else {
            return (0, 0);
        };
        let capped = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        let skipped = ordinal.saturating_sub(last + 1);
        (capped(skipped), capped(lost.saturating_sub(lost_before)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::encoding::Encoding;

    #[test]
    fn counts_the_frames_that_the_program_did_not_read() {
        let mut reader = FrameReader::new(SharedPending::new());
        let counts = [(3, 0), (4, 0), (8, 2), (10, 2)].map(|(ordinal, lost)| {
            let frame = ReceivedFrame {
                payload: Payload::new("1", Encoding::JSON),
                number: 0,
                age: None,
                ordinal,
                lost,
            };
            let frame = reader.read(frame).expect("a frame");
            (frame.skipped, frame.lost)
        });
        assert_eq!(counts, [(0, 0), (0, 0), (3, 2), (1, 0)]);
    }
}
