//! Encodes the metadata of requests and replies: the header of a request (its sender, id and timeout), the marks of replies, and the robot
//! in an error reply, because Zenoh's error replies have no key.
use std::{fmt, time::Duration};

use super::{encoding::Encoding, payload::Payload};
use crate::name::{instance::Instance, Name, MAX_BYTES};

/// The first byte of a header. It differs from those of [`super::attachment`], and no text in UTF-8 begins with it.
const MARK: u8 = 0xFD;
/// The program of the requester has a liveliness token.
const ANNOUNCED: u8 = 1;
/// The requester expects several replies, and the mark of the last one.
const STREAM: u8 = 2;
/// The run of the program that may carry the request out follows.
const ONCE: u8 = 4;
const FLAGS: u8 = ANNOUNCED | STREAM | ONCE;

/// The timeout of a request without a header, in milliseconds. Zenoh's own default.
pub const DEFAULT_TIMEOUT_MS: u32 = 10_000;

/// The id of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RequestId {
    /// The run of the program that sent it.
    pub run: Instance,
    /// The number of the request in this run.
    pub number: u32,
}

impl RequestId {
    /// Parses the text of an id, `<run>/<number>`. `None` if it is something else.
    pub fn parse(text: &str) -> Option<Self> {
        let (run, number) = text.split_once('/')?;
        Some(Self {
            run: Instance::parse(run)?,
            number: number.parse().ok()?,
        })
    }
}

impl fmt::Display for RequestId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.run, self.number)
    }
}

/// The attachment of a request, at most 47 bytes: `0xFD`, flags, the timeout in milliseconds, the run and the number of the id, the run
/// of the program that may carry it out, if the requester states one (4 bytes each, little endian), and the name of the robot that
/// sent the request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestHeader {
    /// The robot that sent the request.
    pub sender: Name,
    /// How long the sender waits for a reply, in milliseconds from sending the request.
    pub timeout_ms: u32,
    /// The id.
    pub id: RequestId,
    /// Whether the program of the sender has a liveliness token.
    pub is_announced: bool,
    /// Whether the sender expects several replies, and the mark of the last one.
    pub is_stream: bool,
    /// The run of the program that may carry out the request, at most once. `None`: every program that serves the topic, each time that
    /// the request arrives.
    pub once_by: Option<Instance>,
}

impl RequestHeader {
    /// Encodes the header.
    pub fn encode(&self) -> Vec<u8> {
        let flag = |flag: u8, is_set: bool| if is_set { flag } else { 0 };
        let mut bytes = Vec::with_capacity(18 + MAX_BYTES);
        bytes.push(MARK);
        bytes.push(
            flag(ANNOUNCED, self.is_announced)
                | flag(STREAM, self.is_stream)
                | flag(ONCE, self.once_by.is_some()),
        );
        let RequestId { run, number } = self.id;
        let once_by = self.once_by.map(|run| run.0);
        for number in [self.timeout_ms, run.0, number].into_iter().chain(once_by) {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        bytes.extend_from_slice(self.sender.as_str().as_bytes());
        bytes
    }

    /// Decodes a header. Returns `None` if the bytes are something else, because the sender does not use RECT.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        let (&[MARK, flags], rest) = bytes.split_first_chunk()? else {
            return None;
        };
        let (timeout_ms, rest) = number(rest)?;
        let (run, rest) = number(rest)?;
        let (number_of_run, rest) = number(rest)?;
        let (once_by, name) = match flags & ONCE {
            0 => (None, rest),
            _ => number(rest).map(|(run, rest)| (Some(Instance(run)), rest))?,
        };
        let header = Self {
            sender: Name::new(std::str::from_utf8(name).ok()?).ok()?,
            timeout_ms,
            id: RequestId {
                run: Instance(run),
                number: number_of_run,
            },
            is_announced: flags & ANNOUNCED != 0,
            is_stream: flags & STREAM != 0,
            once_by,
        };
        (flags & !FLAGS == 0).then_some(header)
    }
}

/// Splits off a number.
fn number(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (number, rest) = bytes.split_first_chunk()?;
    Some((u32::from_le_bytes(*number), rest))
}

/// Returns the attachment of the reply without payload that ends a stream of replies: `0xFD`, and their number (4 bytes, little endian).
pub fn end_of_replies(count: u32) -> Vec<u8> {
    [&[MARK][..], &count.to_le_bytes()].concat()
}

/// Returns the number of replies that the attachment of the last one states. `None` if it is another reply.
pub fn count_of_replies(attachment: &[u8]) -> Option<u32> {
    let (&MARK, count) = attachment.split_first()? else {
        return None;
    };
    Some(u32::from_le_bytes(count.try_into().ok()?))
}

/// The attachment of a reply of a service that allows other programs of its robot to serve the topic: they may have received the request,
/// too.
pub const SHARED_REPLY: [u8; 2] = [MARK, 1];

/// Returns a timeout as headers state it. A longer one counts as the longest.
pub fn timeout_ms(timeout: Duration) -> u32 {
    u32::try_from(timeout.as_millis()).unwrap_or(u32::MAX)
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
        let header = RequestHeader {
            sender: Name::new("wombat-1").expect("valid name"),
            timeout_ms: 1500,
            id: RequestId {
                run: Instance(0x1f),
                number: 7,
            },
            is_announced: true,
            is_stream: false,
            once_by: None,
        };
        let once = RequestHeader {
            is_announced: false,
            is_stream: true,
            once_by: Some(Instance(0x2f)),
            ..header.clone()
        };
        for header in [header, once] {
            let bytes = header.encode();
            assert_eq!(RequestHeader::decode(&bytes), Some(header));
            assert_eq!(crate::message::attachment::Attachment::decode(&bytes), None);
            for end in 0..15 {
                assert_eq!(RequestHeader::decode(&bytes[..end]), None, "{end}");
            }
            let unknown_flag = [&[MARK, 0xFF], &bytes[2..]].concat();
            assert_eq!(RequestHeader::decode(&unknown_flag), None);
        }
        for wrong in [&b"text"[..], &[MARK, 0, 0, 0, 0, b'/']] {
            assert_eq!(RequestHeader::decode(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn marks_of_replies_differ() {
        assert_eq!(count_of_replies(&SHARED_REPLY), None);
        for count in [0, 1, u32::MAX] {
            let end = end_of_replies(count);
            assert_eq!(count_of_replies(&end), Some(count));
            assert_ne!(end, SHARED_REPLY);
        }
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
