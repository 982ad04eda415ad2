//! Owns what a receiver answers to an offer, and what went wrong where something did.
use super::wire::{cut, write_number, write_text, Reader};

const VERSION: u8 = 1;
/// The longest text of a reason, in bytes; what is longer is cut.
pub const MAX_TEXT_BYTES: usize = 200;

/// What a receiver answers to an offer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It is being received; so many bytes are there.
    Running {
        /// How many.
        held_bytes: u64,
    },
    /// As many as it takes at once are running: offer again later.
    Busy,
    /// All is there, and its checksum is right.
    Done,
    /// It is not taken.
    Refused(Refusal),
    /// It was taken, and can't be finished.
    Failed(Fault),
}

/// Why a receiver does not take a transfer.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// No program there receives transfers about this from this robot: it has to say so (`receive_transfers`).
    #[error("no program there receives transfers of this topic from this robot")]
    NotWanted,
    /// It is larger than the program there takes.
    #[error("it is larger than the {limit_bytes} bytes that are taken there")]
    TooLarge {
        /// What it takes.
        limit_bytes: u64,
    },
    /// The offer can't be read there: versions that differ, or a name that is not for files.
    #[error("the offer is not understood there: {0}")]
    NotUnderstood(String),
}

/// Why a transfer that had begun ended.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// The bytes that came are not those that were offered. Most likely they changed meanwhile: send it again.
    #[error("the checksum is wrong: the source changed while it was sent, or bytes were damaged")]
    Checksum,
    /// The source is not what it was when it was offered. Send it again once nobody writes to it any more.
    #[error("the source changed while it was sent: {0}")]
    Changed(String),
    /// The sender can't read its source.
    #[error("the sender can't read it: {0}")]
    Unreadable(String),
    /// The receiver can't keep it: its disk is full, for example.
    #[error("the receiver can't keep it: {0}")]
    NotKept(String),
    /// The sender answered with something else than what was asked for.
    #[error("the sender broke the protocol: {0}")]
    Protocol(String),
    /// Nothing came for too long. What is there is kept where it is kept in a file, and offered again it goes on.
    #[error("nothing came from the sender for {0} s")]
    Silence(u64),
    /// The program there no longer wants it.
    #[error("the receiving program ended it")]
    Stopped,
}

const RUNNING: u8 = 0;
const BUSY: u8 = 1;
const DONE: u8 = 2;
const REFUSED: u8 = 3;
const FAILED: u8 = 4;

impl Answer {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![VERSION];
        match self {
            Self::Running { held_bytes } => {
                out.push(RUNNING);
                write_number(&mut out, *held_bytes);
            }
            Self::Busy => out.push(BUSY),
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

    /// From bytes that anyone may have sent; `None`: they are no answer, or one of another version.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let mut reader = Reader(bytes);
        if reader.byte()? != VERSION {
            return None;
        }
        let answer = match reader.byte()? {
            RUNNING => Self::Running {
                held_bytes: reader.number()?,
            },
            BUSY => Self::Busy,
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
            Self::NotWanted => out.push(0),
            Self::TooLarge { limit_bytes } => {
                out.push(1);
                write_number(out, *limit_bytes);
            }
            Self::NotUnderstood(text) => {
                out.push(2);
                write_text(out, cut(text, MAX_TEXT_BYTES));
            }
        }
    }

    fn read(reader: &mut Reader<'_>) -> Option<Self> {
        Some(match reader.byte()? {
            0 => Self::NotWanted,
            1 => Self::TooLarge {
                limit_bytes: reader.number()?,
            },
            2 => Self::NotUnderstood(reader.text(MAX_TEXT_BYTES)?.to_owned()),
            _ => return None,
        })
    }
}

impl Fault {
    /// As bytes: the error that a sender replies to a request.
    pub fn encode(&self) -> Vec<u8> {
        let mut out = vec![VERSION];
        self.write(&mut out);
        out
    }

    /// From bytes that anyone may have sent; `None`: they are no fault of this version.
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
            Self::NotKept(text) => (3, Some(text)),
            Self::Protocol(text) => (4, Some(text)),
            Self::Silence(_) => (5, None),
            Self::Stopped => (6, None),
        };
        out.push(code);
        if let Some(text) = text {
            write_text(out, cut(text, MAX_TEXT_BYTES));
        }
        if let Self::Silence(seconds) = self {
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
            3 => Self::NotKept(text()?),
            4 => Self::Protocol(text()?),
            5 => Self::Silence(reader.number()?),
            6 => Self::Stopped,
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_answer_comes_back_as_it_was_and_no_part_of_it_does() {
        let text = || "ä reason".to_owned();
        let faults = [
            Fault::Checksum,
            Fault::Changed(text()),
            Fault::Unreadable(text()),
            Fault::NotKept(text()),
            Fault::Protocol(text()),
            Fault::Silence(600),
            Fault::Stopped,
        ];
        let refusals = [
            Refusal::NotWanted,
            Refusal::TooLarge {
                limit_bytes: 1 << 40,
            },
            Refusal::NotUnderstood(text()),
        ];
        let mut answers = vec![
            Answer::Running { held_bytes: 300 },
            Answer::Busy,
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
                "one more"
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
    fn a_long_reason_is_cut() {
        let long = Answer::Failed(Fault::NotKept("ä".repeat(500)));
        let Some(Answer::Failed(Fault::NotKept(text))) = Answer::decode(&long.encode()) else {
            panic!("not read back");
        };
        assert_eq!(text, "ä".repeat(100));
    }
}
