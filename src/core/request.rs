//! Owns what goes with a request beside its payload: who asks, and until when the answer is of use; and what goes with an
//! error: who answers so, since Zenoh gives errors no key.
use super::{
    encoding::Encoding,
    name::{Name, MAX_BYTES},
    payload::Payload,
};

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

/// The last part of an error's encoding, before the name of who answers so: `text/plain;from=wombat-2`.
const FROM: &str = "from=";

/// An error as an answer.
pub fn error_to_payload(from: &Name, error: Payload) -> Payload {
    let encoding = error.encoding.packed(&format!("{FROM}{from}"));
    Payload { encoding, ..error }
}

/// An error that came as an answer, and who answered so; `None`: a stock program.
pub fn error_from_payload(answer: Payload) -> (Option<Name>, Payload) {
    let from = answer.encoding.as_str().rsplit_once(';');
    let from = from.and_then(|(what, from)| Some((what, from.strip_prefix(FROM)?)));
    match from.and_then(|(what, from)| Some((what.to_owned(), Name::new(from).ok()?))) {
        Some((what, from)) => {
            let encoding = Encoding::new(what);
            (Some(from), Payload { encoding, ..answer })
        }
        None => (None, answer),
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

    #[test]
    fn an_error_says_who_answers_so() {
        let from = Name::new("wombat-2").expect("a name");
        let error = Payload::new("the arm is stuck", Encoding::TEXT);
        let answer = error_to_payload(&from, error.clone());
        assert_eq!(answer.encoding.as_str(), "text/plain;from=wombat-2");
        assert_eq!(error_from_payload(answer), (Some(from), error.clone()));
        for stock in ["text/plain", "text/plain;utf-8", "text/plain;from=a b"] {
            let stock = Payload {
                encoding: Encoding::new(stock),
                ..error.clone()
            };
            assert_eq!(error_from_payload(stock.clone()), (None, stock));
        }
    }
}
