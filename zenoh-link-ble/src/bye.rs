//! Owns the reasons with which a side ends the link. Codes: `PROTOCOL.md`.

/// Why a side ends the link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bye {
    /// It closes in the ordinary way.
    Closing,
    /// A newer link between the two replaces this one.
    Replaced,
    /// What it received broke the protocol.
    ProtocolError,
    /// What it received was not what was sent: lost, damaged or repeated.
    Unverified,
    /// The peer acknowledged nothing for too long.
    Unacknowledged,
    /// A reason this version does not know.
    Other(u8),
}

impl Bye {
    /// Its code on the air.
    pub fn code(self) -> u8 {
        match self {
            Self::Closing => 0,
            Self::Replaced => 1,
            Self::ProtocolError => 2,
            Self::Unverified => 3,
            Self::Unacknowledged => 4,
            Self::Other(code) => code,
        }
    }

    /// The reason of that code.
    pub fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Closing,
            1 => Self::Replaced,
            2 => Self::ProtocolError,
            3 => Self::Unverified,
            4 => Self::Unacknowledged,
            other => Self::Other(other),
        }
    }

    /// In words.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Closing => "it is done",
            Self::Replaced => "a newer link between the two replaces it",
            Self::ProtocolError => "it could not read what this side sent",
            Self::Unverified => "something was lost or damaged on the way to it",
            Self::Unacknowledged => "this side acknowledged nothing for too long",
            Self::Other(_) => "for a reason this version does not know",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reason_reads_back_as_it_was_written() {
        for code in 0..=u8::MAX {
            assert_eq!(Bye::from_code(code).code(), code);
        }
    }
}
