//! Decodes untrusted messages and stored records of transfers. A decoded offer, answer, fault, request or record must
//! encode to the same bytes.
use rect_core::transfer::{offer, record::{self, Record}, Answer, Fault, Offer, Request, MAX_PIECE_BYTES};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Some((kind, bytes)) = input.split_first() else {
        return;
    };
    match kind % 5 {
        0 => {
            if let Ok(offer) = Offer::decode(bytes) {
                assert!(bytes.len() <= offer::MAX_BYTES);
                assert!(
                    !offer.name.as_str().contains('/') && !offer.sender.as_str().starts_with('.')
                );
                assert_eq!(offer.encode(), bytes);
            }
        }
        1 => {
            if let Some(answer) = Answer::decode(bytes) {
                assert_eq!(answer.encode(), bytes);
            }
        }
        2 => {
            if let Some(fault) = Fault::decode(bytes) {
                assert_eq!(fault.encode(), bytes);
            }
        }
        3 => {
            if let Some(request) = Request::decode(bytes) {
                if let Request::Range { offset, length, .. } = request {
                    assert!(
                        (1..=MAX_PIECE_BYTES).contains(&length)
                            && offset.checked_add(length.into()).is_some()
                    );
                }
                assert_eq!(request.encode(), bytes);
            }
        }
        _ => {
            let _ = Record::decode(bytes);
            let bytes = record::seal(bytes);
            if let Some(record) = Record::decode(&bytes) {
                assert!(record.held.end() <= record.offer.size_bytes);
                assert_eq!(record.encode(), bytes);
            }
        }
    }
}
