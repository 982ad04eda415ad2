//! Owns what goes with a request beside its payload: who asks, and until when the answer is of use.
use super::name::{Name, MAX_BYTES};

/// Not one of the marks of [`super::attachment`], and no beginning of a text in UTF-8 either.
const MARK: u8 = 0xFC;

/// As long as a service may take where the asker does not say; Zenoh's own default.
pub const DEFAULT_TIMEOUT_MS: u32 = 10_000;

/// What goes with a request, in at most 34 bytes: `0xFC`, the time-out in milliseconds (4 bytes, little endian), and the
/// asker's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asking {
    /// Who asks.
    pub from: Name,
    /// For how long it waits, in milliseconds from when it asked.
    pub timeout_ms: u32,
}

impl Asking {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(5 + MAX_BYTES);
        bytes.push(MARK);
        bytes.extend_from_slice(&self.timeout_ms.to_le_bytes());
        bytes.extend_from_slice(self.from.as_str().as_bytes());
        bytes
    }

    /// From bytes; `None`: a stock program asks.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&MARK, rest) = bytes.split_first()? else {
            return None;
        };
        let (timeout, name) = rest.split_first_chunk()?;
        let from = Name::new(std::str::from_utf8(name).ok()?).ok()?;
        let timeout_ms = u32::from_le_bytes(*timeout);
        Some(Self { from, timeout_ms })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_comes_back_and_nothing_else_is_taken_for_it() {
        let from = Name::new("wombat-1").expect("a name");
        let asking = Asking {
            from,
            timeout_ms: 1500,
        };
        let bytes = asking.encode();
        assert_eq!(Asking::decode(&bytes), Some(asking));
        for wrong in [&b""[..], b"text", &bytes[..5], &[MARK, 0, 0, 0, 0, b'/']] {
            assert_eq!(Asking::decode(wrong), None, "{wrong:?}");
        }
        assert_eq!(super::super::attachment::Attachment::decode(&bytes), None);
    }
}
