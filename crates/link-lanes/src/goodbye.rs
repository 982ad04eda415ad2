//! Defines the reasons that a goodbye gives for the end of a link. For the codes see section 4 of `PROTOCOL.md`.

/// The reason for which a side ends a link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Goodbye {
    /// The side closes the link regularly.
    Closing,
    /// A newer link between the two nodes replaces this one.
    Replaced,
    /// The side received something that violates the protocol.
    ProtocolError,
    /// An SDU to the side was lost, damaged or repeated.
    LostOrDamaged,
    /// The peer has acknowledged nothing for too long.
    Unacknowledged,
    /// A reason that this version does not know, with its code.
    Other(u8),
}

impl Goodbye {
    /// Returns the code of the reason, as it is sent.
    pub fn code(self) -> u8 {
        match self {
            Self::Closing => 0,
            Self::Replaced => 1,
            Self::ProtocolError => 2,
            Self::LostOrDamaged => 3,
            Self::Unacknowledged => 4,
            Self::Other(code) => code,
        }
    }

    /// Returns the reason with that code.
    pub fn from_code(code: u8) -> Self {
        match code {
            0 => Self::Closing,
            1 => Self::Replaced,
            2 => Self::ProtocolError,
            3 => Self::LostOrDamaged,
            4 => Self::Unacknowledged,
            other => Self::Other(other),
        }
    }

    /// Describes the reason to the side that receives the goodbye.
    pub fn reason(self) -> &'static str {
        match self {
            Self::Closing => "it has finished",
            Self::Replaced => "a newer link between the two replaces it",
            Self::ProtocolError => "this side violated the link protocol",
            Self::LostOrDamaged => "a message to it was lost or damaged",
            Self::Unacknowledged => "this side acknowledged nothing for too long",
            Self::Other(_) => "its reason is unknown to this version",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_code_decodes_to_its_reason() {
        for code in 0..=u8::MAX {
            assert_eq!(Goodbye::from_code(code).code(), code);
        }
    }
}
