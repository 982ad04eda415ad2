//! Encodes the metadata of requests and error replies: the header of a request (sender and timeout), and the robot in
//! an error reply, because Zenoh's error replies have no key.
use super::{encoding::Encoding, payload::Payload};
use crate::name::{Name, MAX_BYTES};

/// The first byte of a header. It differs from those of [`super::attachment`], and no text in UTF-8 begins with it.
const MARK: u8 = 0xFC;

/// The timeout of a request without a header, in milliseconds. Zenoh's own default.
pub const DEFAULT_TIMEOUT_MS: u32 = 10_000;

/// The attachment of a request, at most 34 bytes: `0xFC`, the timeout in milliseconds (4 bytes, little endian), and the
/// name of the robot that sent the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestHeader {
    /// The robot that sent the request.
    pub sender: Name,
    /// How long the sender waits for a reply, in milliseconds from sending the request.
    pub timeout_ms: u32,
}

impl RequestHeader {
    /// Encodes the header.
    pub fn encode(&self) -> Vec<u8> {
        let mut bytes = Vec::with_capacity(5 + MAX_BYTES);
        bytes.push(MARK);
        bytes.extend_from_slice(&self.timeout_ms.to_le_bytes());
        bytes.extend_from_slice(self.sender.as_str().as_bytes());
        bytes
    }

    /// Decodes a header. Returns `None` if the bytes are something else, because the sender does not use RECT.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&MARK, rest) = bytes.split_first()? else {
            return None;
        };
        let (timeout, name) = rest.split_first_chunk()?;
        let sender = Name::new(std::str::from_utf8(name).ok()?).ok()?;
        let timeout_ms = u32::from_le_bytes(*timeout);
        Some(Self { sender, timeout_ms })
    }
}

/// The last part of an error reply's encoding, before the name of the replying robot: `text/plain;from=wombat-2`.
const FROM: &str = "from=";

/// Returns the error reply of `robot`: `error`, with the robot in its encoding.
pub fn error_to_payload(robot: &Name, error: Payload) -> Payload {
    let encoding = error.encoding.with_suffix(&format!("{FROM}{robot}"));
    Payload { encoding, ..error }
}

/// Splits an error reply into the robot that sent it (`None` if that robot does not use RECT) and the error.
pub fn error_from_payload(reply: Payload) -> (Option<Name>, Payload) {
    let parts = reply.encoding.as_str().rsplit_once(';');
    let parts = parts.and_then(|(encoding, last)| Some((encoding, last.strip_prefix(FROM)?)));
    match parts.and_then(|(encoding, robot)| Some((encoding.to_owned(), Name::new(robot).ok()?))) {
        Some((encoding, robot)) => {
            let encoding = Encoding::new(encoding);
            (Some(robot), Payload { encoding, ..reply })
        }
        None => (None, reply),
    }
}

/// Returns whether an error reply of `robot` is Zenoh's own: the timeout of the query has expired.
pub fn is_timeout(robot: Option<&Name>, error: &Payload) -> bool {
    robot.is_none() && error.bytes == b"Timeout"[..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn headers_round_trip_and_other_attachments_are_rejected() {
        let from = Name::new("wombat-1").expect("valid name");
        let header = RequestHeader {
            sender: from,
            timeout_ms: 1500,
        };
        let bytes = header.encode();
        assert_eq!(RequestHeader::decode(&bytes), Some(header));
        for wrong in [&b""[..], b"text", &bytes[..5], &[MARK, 0, 0, 0, 0, b'/']] {
            assert_eq!(RequestHeader::decode(wrong), None, "{wrong:?}");
        }
        assert_eq!(crate::message::attachment::Attachment::decode(&bytes), None);
    }

    #[test]
    fn only_an_error_without_a_robot_is_a_timeout() {
        let timeout = Payload::new("Timeout", Encoding::TEXT);
        let other = Payload::new("the arm is stuck", Encoding::TEXT);
        let robot = Name::new("wombat-2").expect("valid name");
        assert!(is_timeout(None, &timeout));
        assert!(!is_timeout(Some(&robot), &timeout));
        assert!(!is_timeout(None, &other));
    }

    #[test]
    fn error_replies_name_the_robot() {
        let from = Name::new("wombat-2").expect("valid name");
        let error = Payload::new("the arm is stuck", Encoding::TEXT);
        let reply = error_to_payload(&from, error.clone());
        assert_eq!(reply.encoding.as_str(), "text/plain;from=wombat-2");
        assert_eq!(error_from_payload(reply), (Some(from), error.clone()));
        for stock in ["text/plain", "text/plain;utf-8", "text/plain;from=a b"] {
            let stock = Payload {
                encoding: Encoding::new(stock),
                ..error.clone()
            };
            assert_eq!(error_from_payload(stock.clone()), (None, stock));
        }
    }
}
