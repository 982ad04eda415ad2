//! Owns the framing of SDUs after the hello: one byte that says what follows. Layout: `PROTOCOL.md`.

/// Bytes that framing adds to a batch.
pub const HEADER: usize = 1;

const BATCH: u8 = 0;
const BYE: u8 = 1;

/// Why a side ends the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bye {
    /// It closes in the ordinary way.
    Closing,
    /// A newer link between the two replaces this one.
    Replaced,
    /// What it received broke the protocol.
    ProtocolError,
    /// A reason this version does not know.
    Other(u8),
}

impl Bye {
    fn code(self) -> u8 {
        match self {
            Self::Closing => 0,
            Self::Replaced => 1,
            Self::ProtocolError => 2,
            Self::Other(code) => code,
        }
    }

    fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Closing,
            1 => Self::Replaced,
            2 => Self::ProtocolError,
            other => Self::Other(other),
        }
    }

    /// In words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Closing => "it is done",
            Self::Replaced => "a newer link between the two replaces it",
            Self::ProtocolError => "it could not read what this side sent",
            Self::Other(_) => "for a reason this version does not know",
        }
    }
}

/// An SDU taken apart.
#[derive(Debug, PartialEq, Eq)]
pub enum Frame<'a> {
    /// One Zenoh batch, never empty.
    Batch(&'a [u8]),
    /// The end of the link.
    Bye(Bye),
}

/// Why an SDU is not a frame.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// It has no byte at all, or nothing after the first.
    #[error("an empty frame")]
    Empty,
    /// Its kind is unknown.
    #[error("unknown kind {0} of frame")]
    Kind(u8),
}

impl<'a> Frame<'a> {
    /// Takes an SDU apart.
    pub fn decode(sdu: &'a [u8]) -> Result<Self, FrameError> {
        match sdu {
            [] | [_] => Err(FrameError::Empty),
            [BATCH, batch @ ..] => Ok(Self::Batch(batch)),
            [BYE, code, ..] => Ok(Self::Bye(Bye::from_code(*code))),
            [kind, ..] => Err(FrameError::Kind(*kind)),
        }
    }

    /// The SDU's bytes.
    pub fn encode(&self) -> Vec<u8> {
        match self {
            Self::Batch(batch) => {
                let mut sdu = Vec::with_capacity(HEADER + batch.len());
                sdu.push(BATCH);
                sdu.extend_from_slice(batch);
                sdu
            }
            Self::Bye(bye) => vec![BYE, bye.code()],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_reads_back_as_it_was_written() {
        for frame in [
            Frame::Batch(b"x"),
            Frame::Batch(&[7; 2000]),
            Frame::Bye(Bye::Closing),
            Frame::Bye(Bye::Other(77)),
        ] {
            assert_eq!(Frame::decode(&frame.encode()), Ok(frame));
        }
    }

    #[test]
    fn empty_and_unknown_frames_are_refused() {
        assert_eq!(Frame::decode(&[]), Err(FrameError::Empty));
        assert_eq!(Frame::decode(&[BATCH]), Err(FrameError::Empty));
        assert_eq!(Frame::decode(&[BYE]), Err(FrameError::Empty));
        assert_eq!(Frame::decode(&[2, 0]), Err(FrameError::Kind(2)));
    }
}
