//! Encodes and decodes the SDUs of an open link: head, check and body. For the layout see section 4 of `PROTOCOL.md`.
use super::{
    check::{self, Fault},
    Lane, HEADER,
};

const BATCH: u8 = 0;
const ACK: u8 = 1;
const STOP: u8 = 2;
const GO: u8 = 3;
const GOODBYE: u8 = 4;
const INTERVAL: u8 = 5;

/// The content of an SDU.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content<'a> {
    /// One Zenoh batch, never empty.
    Batch(Lane, &'a [u8]),
    /// The total cost of the batches that the receiver has read from its socket since the link began, in bytes modulo
    /// 2^16: see `credits`.
    Ack(u16),
    /// The receiver holds enough of that lane. The sender sends no more of it until [`Content::Go`].
    Stop(Lane),
    /// The receiver accepts more of that lane.
    Go(Lane),
    /// The end of the link, with the code of the reason.
    Goodbye(u8),
    /// A connection interval in units of 1.25 ms: from the central, the one that it has set; from the peripheral, a request.
    Interval(u16),
}

/// Why an SDU was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SduError {
    /// The SDU has a wrong length for its kind.
    #[error("an sdu of {0} bytes, which is a wrong length for its kind")]
    Size(usize),
    /// The kind or the lane in the first byte is unknown.
    #[error("an sdu of unknown kind {0:#04x}")]
    Head(u8),
    /// The check does not match.
    #[error(transparent)]
    Fault(#[from] Fault),
}

impl Content<'_> {
    /// Encodes the content as an SDU whose check is zero: see [`seal`].
    pub fn encode(&self) -> Vec<u8> {
        let with_body = |kind: u8, lane: u8, body: &[u8]| {
            let mut sdu = Vec::with_capacity(HEADER + body.len());
            sdu.extend_from_slice(&[kind << 4 | lane, 0, 0]);
            sdu.extend_from_slice(body);
            sdu
        };
        match self {
            Self::Batch(lane, batch) => with_body(BATCH, lane.number(), batch),
            Self::Ack(total) => with_body(ACK, 0, &total.to_le_bytes()),
            Self::Stop(lane) => with_body(STOP, lane.number(), &[]),
            Self::Go(lane) => with_body(GO, lane.number(), &[]),
            Self::Goodbye(reason) => with_body(GOODBYE, 0, &[*reason]),
            Self::Interval(units) => with_body(INTERVAL, 0, &units.to_le_bytes()),
        }
    }
}

/// Writes the check into an SDU. `number` is the number of SDUs that were sent on the link before.
pub fn seal(number: u32, sdu: &mut [u8]) {
    if let [head, low, high, body @ ..] = sdu {
        [*low, *high] = check::compute(number, *head, body);
    }
}

/// Verifies and decodes an SDU. `number` is the number of SDUs that were received on the link before.
///
/// # Errors
/// Fails if the check does not match, or if the kind, the lane or the size is not one of the protocol.
pub fn open(number: u32, sdu: &[u8]) -> Result<Content<'_>, SduError> {
    let [head, low, high, body @ ..] = sdu else {
        return Err(SduError::Size(sdu.len()));
    };
    check::verify(number, *head, [*low, *high], body)?;
    let lane = Lane::new(head & 0x0f).ok_or(SduError::Head(*head))?;
    let kind = head >> 4;
    if matches!(kind, ACK | GOODBYE | INTERVAL) && lane.number() != 0 {
        return Err(SduError::Head(*head));
    }
    match (kind, body) {
        (BATCH, [_, ..]) => Ok(Content::Batch(lane, body)),
        (ACK, [low, high]) => Ok(Content::Ack(u16::from_le_bytes([*low, *high]))),
        (STOP, []) => Ok(Content::Stop(lane)),
        (GO, []) => Ok(Content::Go(lane)),
        (GOODBYE, [reason]) => Ok(Content::Goodbye(*reason)),
        (INTERVAL, [low, high]) => Ok(Content::Interval(u16::from_le_bytes([*low, *high]))),
        (BATCH | ACK | STOP | GO | GOODBYE | INTERVAL, _) => Err(SduError::Size(sdu.len())),
        _ => Err(SduError::Head(*head)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed(number: u32, mut sdu: Vec<u8>) -> Vec<u8> {
        seal(number, &mut sdu);
        sdu
    }

    #[test]
    fn every_sdu_decodes_to_what_was_encoded() {
        let lane = Lane::new(5).expect("valid");
        for (number, content) in [
            Content::Batch(lane, b"x"),
            Content::Ack(4711),
            Content::Stop(lane),
            Content::Go(lane),
            Content::Goodbye(3),
            Content::Interval(24),
        ]
        .into_iter()
        .enumerate()
        {
            let sdu = sealed(number as u32, content.encode());
            assert_eq!(open(number as u32, &sdu), Ok(content));
        }
    }

    #[test]
    fn malformed_sdu_is_rejected() {
        assert_eq!(open(0, &[]), Err(SduError::Size(0)));
        assert_eq!(open(0, &[0, 0]), Err(SduError::Size(2)));
        for (sdu, error) in [
            (vec![0x05, 0, 0], SduError::Size(3)),
            (vec![0x10, 0, 0, 1], SduError::Size(4)),
            (vec![0x15, 0, 0, 1, 1], SduError::Head(0x15)),
            (vec![0x25, 0, 0, 1], SduError::Size(4)),
            (vec![0x41, 0, 0, 1], SduError::Head(0x41)),
            (vec![0x08, 0, 0, 1], SduError::Head(0x08)),
            (vec![0x50, 0, 0, 1], SduError::Size(4)),
            (vec![0x60, 0, 0, 1], SduError::Head(0x60)),
        ] {
            assert_eq!(open(0, &sealed(0, sdu)), Err(error));
        }
        let lost = sealed(
            4,
            Content::Batch(Lane::new(0).expect("valid"), b"x").encode(),
        );
        assert_eq!(open(1, &lost), Err(SduError::Fault(Fault::Lost(3))));
    }
}
