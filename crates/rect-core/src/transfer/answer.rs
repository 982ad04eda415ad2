//! Encodes a receiver's answers to offers, and the faults of transfers.
use super::wire::{cut, write_number, write_text, Reader};

const VERSION: u8 = 1;
/// The maximum length of a reason, in bytes. Longer ones are truncated.
pub const MAX_TEXT_BYTES: usize = 200;

/// A receiver's answer to an offer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// The transfer is in progress.
    Running {
        /// Number of bytes received so far.
        received_bytes: u64,
    },
    /// The maximum number of concurrent transfers is reached. Offer the transfer again later.
    Busy,
    /// The transfer has arrived, or there is no place for it, and the receiving program has not taken those that arrived before.
    NotTaken,
    /// The transfer is complete, and its checksum is correct.
    Done,
    /// The offer is refused.
    Refused(Refusal),
    /// The transfer began, but failed.
    Failed(Fault),
}

/// The reason why a receiver refuses an offer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// No program of the robot receives transfers of this topic from this sender. The program must call
    /// `receive_transfers`.
    #[error("no program on that robot receives transfers of this topic from this sender")]
    NotAccepted,
    /// The transfer is larger than the receiving program accepts.
    #[error("it is larger than the {limit_bytes} bytes that the receiver accepts")]
    TooLarge {
        /// Maximum size that the program accepts, in bytes.
        limit_bytes: u64,
    },
    /// The receiver cannot read the offer: its version differs, or the name is not valid for a file.
    #[error("the receiver cannot read the offer: {0}")]
    InvalidOffer(String),
}

/// The reason why a transfer failed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The received data does not match the checksum of the offer. The source probably changed while it was sent: send
    /// it again.
    #[error(
        "the checksum is wrong: the source changed while it was sent, or the data was damaged"
    )]
    Checksum,
    /// The source has changed since it was offered. Send it again when nothing writes to it any more.
    #[error("the source changed while it was sent: {0}")]
    Changed(String),
    /// The sender cannot read its source.
    #[error("the sender cannot read the source: {0}")]
    Unreadable(String),
    /// The receiver cannot store the data, for example because its disk is full.
    #[error("the receiver cannot store it: {0}")]
    NotStored(String),
    /// The sender's reply does not match the request.
    #[error("the sender violated the protocol: {0}")]
    Protocol(String),
    /// Nothing was received for this many seconds, which exceeds the timeout. If the receiver stores transfers
    /// in a folder, a new offer continues where this one stopped.
    #[error("nothing was received from the sender for {0} s")]
    TimedOut(u64),
    /// The receiving program ended the transfer.
    #[error("the receiving program ended it")]
    Stopped,
}

const RUNNING: u8 = 0;
const BUSY: u8 = 1;
const DONE: u8 = 2;
const REFUSED: u8 = 3;
const FAILED: u8 = 4;
const NOT_TAKEN: u8 = 5;

impl Answer {
    /// Encodes the answer.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![VERSION];
        match self {
            Self::Running { received_bytes } => {
                out.push(RUNNING);
                write_number(&mut out, *received_bytes);
            }
            Self::Busy => out.push(BUSY),
            Self::NotTaken => out.push(NOT_TAKEN),
            Self::Done => out.push(DONE),
            Self::Refused(refusal) => {
                out.push(REFUSED);
                refusal.write(&mut out);
            }
            Self::Failed(fault) => {
                out.push(FAILED);
                fault.write(&mut out);
            }
        }
        out
    }

    /// Decodes an untrusted answer. Returns `None` if the bytes are not an answer of this version.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        if reader.byte()? != VERSION {
            return None;
        }
        let answer = match reader.byte()? {
            RUNNING => Self::Running {
                received_bytes: reader.number()?,
            },
            BUSY => Self::Busy,
            NOT_TAKEN => Self::NotTaken,
            DONE => Self::Done,
            REFUSED => Self::Refused(Refusal::read(&mut reader)?),
            FAILED => Self::Failed(Fault::read(&mut reader)?),
            _ => return None,
        };
        reader.end()?;
        Some(answer)
    }
}

impl Refusal {
    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::NotAccepted => out.push(0),
            Self::TooLarge { limit_bytes } => {
                out.push(1);
                write_number(out, *limit_bytes);
            }
            Self::InvalidOffer(text) => {
                out.push(2);
                write_text(out, cut(text, MAX_TEXT_BYTES));
            }
        }
    }

    fn read(reader: &mut Reader<'_>) -> Option<Self> {
        Some(match reader.byte()? {
            0 => Self::NotAccepted,
            1 => Self::TooLarge {
                limit_bytes: reader.number()?,
            },
            2 => Self::InvalidOffer(reader.text(MAX_TEXT_BYTES)?.to_owned()),
            _ => return None,
        })
    }
}

impl Fault {
    /// Encodes the fault. A sender returns it as an error reply to a request.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![VERSION];
        self.write(&mut out);
        out
    }

    /// Decodes an untrusted fault. Returns `None` if the bytes are not a fault of this version.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        if reader.byte()? != VERSION {
            return None;
        }
        let fault = Self::read(&mut reader)?;
        reader.end()?;
        Some(fault)
    }

    pub(super) fn write(&self, out: &mut Vec<u8>) {
        let (code, text) = match self {
            Self::Checksum => (0, None),
            Self::Changed(text) => (1, Some(text)),
            Self::Unreadable(text) => (2, Some(text)),
            Self::NotStored(text) => (3, Some(text)),
            Self::Protocol(text) => (4, Some(text)),
            Self::TimedOut(_) => (5, None),
            Self::Stopped => (6, None),
        };
        out.push(code);
        if let Some(text) = text {
            write_text(out, cut(text, MAX_TEXT_BYTES));
        }
        if let Self::TimedOut(seconds) = self {
            write_number(out, *seconds);
        }
    }

    pub(super) fn read(reader: &mut Reader<'_>) -> Option<Self> {
        let code = reader.byte()?;
        let mut text = || Some(reader.text(MAX_TEXT_BYTES)?.to_owned());
        Some(match code {
            0 => Self::Checksum,
            1 => Self::Changed(text()?),
            2 => Self::Unreadable(text()?),
            3 => Self::NotStored(text()?),
            4 => Self::Protocol(text()?),
            5 => Self::TimedOut(reader.number()?),
            6 => Self::Stopped,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_round_trip_and_truncated_ones_are_rejected() {
        let text = || "ä reason".to_owned();
        let faults = [
            Fault::Checksum,
            Fault::Changed(text()),
            Fault::Unreadable(text()),
            Fault::NotStored(text()),
            Fault::Protocol(text()),
            Fault::TimedOut(600),
            Fault::Stopped,
        ];
        let refusals = [
            Refusal::NotAccepted,
            Refusal::TooLarge {
                limit_bytes: 1 << 40,
            },
            Refusal::InvalidOffer(text()),
        ];
        let mut answers = vec![
            Answer::Running {
                received_bytes: 300,
            },
            Answer::Busy,
            Answer::NotTaken,
            Answer::Done,
        ];
        answers.extend(refusals.map(Answer::Refused));
        answers.extend(faults.clone().map(Answer::Failed));
        for answer in answers {
            let bytes = answer.encode();
            assert_eq!(Answer::decode(&bytes), Some(answer));
            for cut in 0..bytes.len() {
                assert_eq!(Answer::decode(&bytes[..cut]), None, "cut to {cut}");
            }
            assert_eq!(
                Answer::decode(&[&bytes[..], &[0]].concat()),
                None,
                "one byte too many"
            );
        }
        for fault in faults {
            assert_eq!(Fault::decode(&fault.encode()), Some(fault));
        }
        for other in [
            &[][..],
            &[2, 1],
            &[1, 9],
            &[1, REFUSED, 9],
            &[1, FAILED, 99],
        ] {
            assert_eq!(Answer::decode(other), None, "{other:?}");
        }
    }

    #[test]
    fn long_reasons_are_truncated() {
        let long = Answer::Failed(Fault::NotStored("ä".repeat(500)));
        let Some(Answer::Failed(Fault::NotStored(text))) = Answer::decode(&long.encode()) else {
            panic!("not read back");
        };
        assert_eq!(text, "ä".repeat(100));
    }
}
