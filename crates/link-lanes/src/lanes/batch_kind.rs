//! Determines from the first bytes of a batch which part of a message it carries, and whether Zenoh may drop that message.
//! A batch that cannot be parsed counts as a whole message that must arrive. The result affects only how much may wait on a
//! lane.
use zenoh_buffers::reader::{DidntRead, HasReader, Reader};
use zenoh_codec::{RCodec, Zenoh080, Zenoh080Condition, Zenoh080Header};
use zenoh_protocol::{
    common::{iext, imsg, ZExtUnknown},
    core::{CongestionControl, WireExpr},
    network::{id as network, push},
    transport::{id as transport, FragmentHeader, FrameHeader},
};

/// The part of a message that a batch carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BatchKind {
    /// One or more whole messages.
    Whole {
        /// Whether Zenoh may drop the first of them if the lane has no room.
        is_droppable: bool,
    },
    /// The first fragment of a message.
    FirstFragment {
        /// Whether Zenoh may drop the message if the lane has no room.
        is_droppable: bool,
    },
    /// A further fragment of the message whose fragments came before.
    NextFragment,
}

impl BatchKind {
    /// Determines the kind of a batch.
    pub fn of(batch: &[u8]) -> Self {
        read(batch).unwrap_or(Self::Whole {
            is_droppable: false,
        })
    }
}

fn read(batch: &[u8]) -> Result<BatchKind, DidntRead> {
    let mut reader = batch.reader();
    let header: u8 = Zenoh080::new().read(&mut reader)?;
    let codec = Zenoh080Header::new(header);
    match imsg::mid(header) {
        transport::FRAME => {
            let _: FrameHeader = codec.read(&mut reader)?;
            let is_droppable = is_droppable(&mut reader)?;
            Ok(BatchKind::Whole { is_droppable })
        }
        transport::FRAGMENT => {
            let fragment: FragmentHeader = codec.read(&mut reader)?;
            if fragment.ext_first.is_none() {
                return Ok(BatchKind::NextFragment);
            }
            let is_droppable = is_droppable(&mut reader)?;
            Ok(BatchKind::FirstFragment { is_droppable })
        }
        _ => Err(DidntRead),
    }
}

/// Returns whether the network message that begins here is a push with congestion control `Drop`. Zenoh drops no others.
fn is_droppable(reader: &mut impl Reader) -> Result<bool, DidntRead> {
    let codec = Zenoh080::new();
    let header: u8 = codec.read(&mut *reader)?;
    if imsg::mid(header) != network::PUSH {
        return Ok(false);
    }
    let is_named = imsg::has_flag(header, push::flag::N);
    let _: WireExpr<'static> = Zenoh080Condition::new(is_named).read(&mut *reader)?;
    let mut has_more = imsg::has_flag(header, push::flag::Z);
    while has_more {
        let extension: u8 = codec.read(&mut *reader)?;
        let codec = Zenoh080Header::new(extension);
        if iext::eid(extension) == push::ext::QoS::ID {
            let (qos, _): (push::ext::QoSType, bool) = codec.read(&mut *reader)?;
            return Ok(qos.get_congestion_control() == CongestionControl::Drop);
        }
        // The others do not matter here, not even mandatory ones, such as the number that routers add to what they forward.
        let (_, follows): (ZExtUnknown, bool) = codec.read(&mut *reader)?;
        has_more = follows;
    }
    Ok(push::ext::QoSType::DEFAULT.get_congestion_control() == CongestionControl::Drop)
}

#[cfg(test)]
pub(super) mod tests {
    use zenoh_codec::WCodec;
    use zenoh_protocol::{
        core::{Priority, Reliability},
        transport::{fragment, frame},
    };

    use super::*;

    /// Returns the part of a network message that the link parses: a push to a named key, with an unknown mandatory extension
    /// before the QoS extension, and the number of a router after it.
    fn message(congestion_control: CongestionControl) -> Vec<u8> {
        /// A mandatory extension with an unknown id and a small integer, which is followed by another extension.
        const OTHER: [u8; 2] = [0xb7, 1];
        /// The number of a router, a mandatory extension, which is the last one.
        const NODE: [u8; 2] = [0x33, 1];
        let (codec, mut bytes) = (Zenoh080::new(), Vec::new());
        let writer = &mut bytes;
        let header = network::PUSH | push::flag::N | push::flag::Z;
        let qos = push::ext::QoSType::new(Priority::Data, congestion_control, false);
        let written = codec
            .write(&mut *writer, header)
            .and_then(|()| codec.write(&mut *writer, &WireExpr::from("rect/wombat-1/camera")))
            .and_then(|()| codec.write(&mut *writer, OTHER[0]))
            .and_then(|()| codec.write(&mut *writer, OTHER[1]))
            .and_then(|()| codec.write(&mut *writer, (qos, true)))
            .and_then(|()| codec.write(&mut *writer, NODE[0]))
            .and_then(|()| codec.write(&mut *writer, NODE[1]));
        assert!(written.is_ok());
        bytes
    }

    /// Returns a batch with these messages.
    pub(in crate::lanes) fn framed(messages: &[u8]) -> Vec<u8> {
        let header = FrameHeader {
            reliability: Reliability::Reliable,
            sn: 300,
            ext_qos: frame::ext::QoSType::new(Priority::Data),
        };
        let mut bytes = Vec::new();
        assert!(Zenoh080::new().write(&mut bytes, &header).is_ok());
        bytes.extend_from_slice(messages);
        bytes
    }

    /// Returns a batch with a fragment of a message.
    pub(in crate::lanes) fn fragment(is_first: bool, message: &[u8]) -> Vec<u8> {
        let header = FragmentHeader {
            reliability: Reliability::Reliable,
            more: true,
            sn: 300,
            ext_qos: fragment::ext::QoSType::new(Priority::Data),
            ext_first: is_first.then(fragment::ext::First::new),
            ext_drop: None,
        };
        let mut bytes = Vec::new();
        assert!(Zenoh080::new().write(&mut bytes, &header).is_ok());
        bytes.extend_from_slice(message);
        bytes
    }

    #[test]
    fn droppable_messages_are_recognised_by_their_first_bytes() {
        for (congestion_control, is_droppable) in [
            (CongestionControl::Drop, true),
            (CongestionControl::Block, false),
        ] {
            let message = message(congestion_control);
            let whole = BatchKind::of(&framed(&message));
            assert_eq!(whole, BatchKind::Whole { is_droppable });
            let first = BatchKind::of(&fragment(true, &message));
            assert_eq!(first, BatchKind::FirstFragment { is_droppable });
        }
    }

    #[test]
    fn further_fragment_is_recognised_regardless_of_its_content() {
        let droppable = message(CongestionControl::Drop);
        assert_eq!(
            BatchKind::of(&fragment(false, &droppable)),
            BatchKind::NextFragment
        );
    }

    #[test]
    fn batch_that_cannot_be_parsed_must_arrive() {
        let whole = BatchKind::Whole {
            is_droppable: false,
        };
        let batch = framed(&message(CongestionControl::Drop));
        for end in 0..8 {
            assert_eq!(BatchKind::of(&batch[..end]), whole, "{end} bytes");
        }
        assert_eq!(BatchKind::of(&[0xff; 100]), whole);
    }
}
