//! Owns one L2CAP channel: the queue at each sender, the credits and the buffer at each receiver (Vol 3, Part A, 10.1).
//!
//! It moves whole SDUs and counts their bytes; which packet carries which byte is the connection's business.
use std::collections::VecDeque;

use super::{
    message::{RequestId, SendLimits, Violation},
    options::RECEIVE_BUFFER_BYTES,
};

/// Every SDU begins with its length.
const SDU_HEADER_BYTES: usize = 2;

/// A channel with its two ends: 0 at the central, 1 at the peripheral.
#[derive(Debug)]
pub(super) struct Channel {
    pub(super) ends: [ChannelEnd; 2],
    mps: usize,
    ahead_bytes: usize,
}

/// One end of a channel.
#[derive(Debug)]
pub(super) struct ChannelEnd {
    pub(super) state: EndState,
    pub(super) recv_mtu: u16,
    sending: SendQueue,
    receiving: ReceiveBuffer,
}

/// What one end knows of the channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EndState {
    /// It asked, and waits for the answer.
    Opening(RequestId),
    /// It has not been asked yet.
    Unaware,
    /// It is open.
    Open,
    /// It is closed, by its owner or by the link's end.
    Closed,
}

#[derive(Debug, Default)]
struct SendQueue {
    sdus: VecDeque<Outgoing>,
    /// Bytes of SDUs that are not acknowledged, those in `sdus` included.
    unacknowledged_bytes: usize,
    credits: u32,
}

#[derive(Debug)]
struct Outgoing {
    sdu: Vec<u8>,
    /// What is not cut into frames yet, the header included.
    left_bytes: usize,
}

/// Counts in frames: a credit is leave for one frame, full or not.
#[derive(Debug)]
struct ReceiveBuffer {
    /// Frames it has room for altogether.
    size: u32,
    /// Credits the sender has, or that are under way to it.
    granted: u32,
    /// Frames of the SDU that is not whole yet.
    partial: u32,
    /// Frames of each SDU that its owner has not read, oldest first.
    unread: VecDeque<u32>,
}

/// A piece of an SDU, ready to be sent.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Piece {
    pub(super) bytes: usize,
    /// How many of them are the SDU's own, not its header's.
    pub(super) sdu_bytes: usize,
    /// The SDU, with its last piece.
    pub(super) sdu: Option<Vec<u8>>,
}

impl Channel {
    /// A channel that the end on `side` asks for.
    pub(super) fn opening(
        side: usize,
        request: RequestId,
        recv_mtu: u16,
        mps: u16,
        ahead_bytes: usize,
    ) -> Self {
        let end = |state, recv_mtu| ChannelEnd {
            state,
            recv_mtu,
            sending: SendQueue::default(),
            receiving: ReceiveBuffer::new(recv_mtu, mps),
        };
        let mut ends = [end(EndState::Unaware, 0), end(EndState::Unaware, 0)];
        ends[side] = end(EndState::Opening(request), recv_mtu);
        Self {
            ends,
            mps: usize::from(mps),
            ahead_bytes,
        }
    }

    /// The end on `side` takes the channel; the other will hear of it.
    pub(super) fn accept(&mut self, side: usize, recv_mtu: u16) {
        let mps = u16::try_from(self.mps).unwrap_or(u16::MAX);
        self.ends[side].state = EndState::Open;
        self.ends[side].recv_mtu = recv_mtu;
        self.ends[side].receiving = ReceiveBuffer::new(recv_mtu, mps);
        // The request carried the asking end's credits.
        self.ends[side].sending.credits = self.ends[1 - side].receiving.grant_all();
    }

    /// The end on `side` asked and was answered with yes.
    pub(super) fn confirm(&mut self, side: usize) {
        self.ends[side].state = EndState::Open;
        self.ends[side].sending.credits = self.ends[1 - side].receiving.grant_all();
    }

    /// Queues an SDU at `side`.
    pub(super) fn queue(&mut self, side: usize, sdu: Vec<u8>) -> Result<(), Violation> {
        if sdu.is_empty() || sdu.len() > usize::from(self.ends[1 - side].recv_mtu) {
            return Err(Violation::SduSize);
        }
        let limits = self.send_limits(side);
        let sending = &mut self.ends[side].sending;
        if !limits.has_room(sending.unacknowledged_bytes) {
            return Err(Violation::NoRoom);
        }
        sending.unacknowledged_bytes += sdu.len();
        sending.sdus.push_back(Outgoing {
            left_bytes: sdu.len() + SDU_HEADER_BYTES,
            sdu,
        });
        Ok(())
    }

    /// Whether `side` has a frame to send and a credit for it.
    pub(super) fn is_ready(&self, side: usize) -> bool {
        let sending = &self.ends[side].sending;
        sending.credits > 0 && !sending.sdus.is_empty()
    }

    /// Cuts the next frame's piece off the oldest SDU, for one credit.
    pub(super) fn cut(&mut self, side: usize) -> Option<Piece> {
        let sending = &mut self.ends[side].sending;
        let credits = sending.credits.checked_sub(1)?;
        let oldest = sending.sdus.front_mut()?;
        let bytes = oldest.left_bytes.min(self.mps);
        let header_left = oldest.left_bytes.saturating_sub(oldest.sdu.len());
        let sdu_bytes = bytes - header_left.min(bytes);
        oldest.left_bytes -= bytes;
        let sdu = if oldest.left_bytes == 0 {
            sending.sdus.pop_front().map(|outgoing| outgoing.sdu)
        } else {
            None
        };
        sending.credits = credits;
        Some(Piece {
            bytes,
            sdu_bytes,
            sdu,
        })
    }

    /// So many bytes of SDUs from `side` were acknowledged. False when nobody waits for it any more.
    pub(super) fn acknowledged(&mut self, side: usize, bytes: usize) -> bool {
        let end = &mut self.ends[side];
        end.sending.unacknowledged_bytes = end.sending.unacknowledged_bytes.saturating_sub(bytes);
        end.state == EndState::Open
    }

    /// A frame came in at `side`, the last of its SDU or not. False when the end is closed and the frame is dropped.
    pub(super) fn received(&mut self, side: usize, is_last: bool) -> bool {
        let end = &mut self.ends[side];
        if end.state != EndState::Open {
            return false;
        }
        let buffer = &mut end.receiving;
        buffer.granted = buffer.granted.saturating_sub(1);
        buffer.partial += 1;
        if is_last {
            buffer.unread.push_back(std::mem::take(&mut buffer.partial));
        }
        true
    }

    /// The owner of `side` read its oldest SDU.
    pub(super) fn took(&mut self, side: usize) -> Result<(), Violation> {
        let end = &mut self.ends[side];
        match end.receiving.unread.pop_front() {
            Some(_) => Ok(()),
            None if end.state == EndState::Closed => Ok(()),
            None => Err(Violation::NothingToTake),
        }
    }

    /// The credits that `side` should send now, if it is worth a packet.
    pub(super) fn due_credits(&mut self, side: usize) -> Option<u32> {
        let end = &mut self.ends[side];
        if end.state != EndState::Open {
            return None;
        }
        end.receiving.due()
    }

    /// Credits came in at `side`.
    pub(super) fn credited(&mut self, side: usize, frames: u32) {
        let sending = &mut self.ends[side].sending;
        sending.credits = sending.credits.saturating_add(frames);
    }

    /// Closes the end on `side` and throws away what it still had to send. Tells what it was.
    pub(super) fn close(&mut self, side: usize) -> EndState {
        let end = &mut self.ends[side];
        end.sending = SendQueue::default();
        std::mem::replace(&mut end.state, EndState::Closed)
    }

    /// Whether neither end has any use for it.
    pub(super) fn is_over(&self) -> bool {
        self.ends
            .iter()
            .all(|end| matches!(end.state, EndState::Closed | EndState::Unaware))
    }

    /// Whether the end on `side` waits for the answer to that request.
    pub(super) fn is_opening(&self, side: usize, request: RequestId) -> bool {
        self.ends[side].state == EndState::Opening(request)
    }

    /// Whether the end on `side` can send and receive.
    pub(super) fn is_open(&self, side: usize) -> bool {
        self.ends[side].state == EndState::Open
    }

    /// Whether the end on `side` is closed.
    pub(super) fn is_closed(&self, side: usize) -> bool {
        self.ends[side].state == EndState::Closed
    }

    /// What `side` may send.
    pub(super) fn send_limits(&self, side: usize) -> SendLimits {
        SendLimits {
            sdu_bytes: self.ends[1 - side].recv_mtu,
            ahead_bytes: self.ahead_bytes,
        }
    }

    /// Bytes queued at `side`, for the status.
    pub(super) fn queued_bytes(&self, side: usize) -> usize {
        self.ends[side].sending.unacknowledged_bytes
    }
}

impl ReceiveBuffer {
    fn new(recv_mtu: u16, mps: u16) -> Self {
        let mps = usize::from(mps.max(1));
        let one_sdu = (usize::from(recv_mtu) + SDU_HEADER_BYTES).div_ceil(mps);
        let frames = (RECEIVE_BUFFER_BYTES / mps).max(one_sdu + 1);
        Self {
            size: u32::try_from(frames).unwrap_or(u32::MAX),
            granted: 0,
            partial: 0,
            unread: VecDeque::new(),
        }
    }

    fn free(&self) -> u32 {
        let used = self.granted + self.partial + self.unread.iter().sum::<u32>();
        self.size.saturating_sub(used)
    }

    fn grant_all(&mut self) -> u32 {
        let free = self.free();
        self.granted += free;
        free
    }

    /// Half the buffer at a time, so that credits cost next to no air; at once when the sender has none left.
    fn due(&mut self) -> Option<u32> {
        let free = self.free();
        if free >= self.size / 2 || (self.granted == 0 && free > 0) {
            Some(self.grant_all())
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn open(mps: u16, recv_mtu: u16) -> Channel {
        let mut channel = Channel::opening(0, RequestId(1), recv_mtu, mps, 2000);
        channel.accept(1, recv_mtu);
        channel.confirm(0);
        channel
    }

    #[test]
    fn an_sdu_is_cut_into_frames_with_its_length_in_front() {
        let mut channel = open(100, 1000);
        channel.queue(0, vec![7; 250]).expect("room");
        let pieces: Vec<_> = std::iter::from_fn(|| channel.cut(0)).collect();
        let sizes: Vec<_> = pieces.iter().map(|piece| piece.bytes).collect();
        assert_eq!(sizes, [100, 100, 52]);
        let of_sdu: Vec<_> = pieces.iter().map(|piece| piece.sdu_bytes).collect();
        assert_eq!(of_sdu, [98, 100, 52]);
        assert_eq!(pieces[2].sdu, Some(vec![7; 250]));
    }

    #[test]
    fn what_the_peer_does_not_take_is_refused() {
        let mut channel = open(247, 100);
        assert_eq!(channel.queue(0, vec![0; 101]), Err(Violation::SduSize));
        assert_eq!(channel.queue(0, vec![]), Err(Violation::SduSize));
        assert_eq!(channel.queue(0, vec![0; 100]), Ok(()));
    }

    #[test]
    fn the_send_queue_is_bounded_but_one_large_sdu_always_fits() {
        let mut channel = open(247, 60000);
        channel.queue(0, vec![0; 60000]).expect("alone");
        assert_eq!(channel.queue(0, vec![0; 1]), Err(Violation::NoRoom));
        assert!(channel.acknowledged(0, 60000));
        channel.queue(0, vec![0; 2000]).expect("room again");
    }

    #[test]
    fn a_reader_that_does_not_read_stops_the_sender_and_reading_starts_it_again() {
        let mut channel = open(247, 1000);
        let mut arrived = 0;
        loop {
            channel
                .queue(0, vec![0; 245])
                .expect("acknowledged at once");
            let Some(piece) = channel.cut(0) else { break };
            assert!(channel.received(1, piece.sdu.is_some()));
            channel.acknowledged(0, 245);
            assert_eq!(channel.due_credits(1), None);
            arrived += 1;
        }
        assert_eq!(arrived, RECEIVE_BUFFER_BYTES / 247);
        channel.took(1).expect("there is one");
        assert_eq!(channel.due_credits(1), Some(1));
        channel.credited(0, 1);
        assert!(channel.cut(0).is_some());
    }

    #[test]
    fn reading_what_never_came_is_a_violation() {
        let mut channel = open(247, 1000);
        assert_eq!(channel.took(0), Err(Violation::NothingToTake));
    }

    #[test]
    fn a_closed_end_drops_what_comes() {
        let mut channel = open(247, 1000);
        assert_eq!(channel.close(1), EndState::Open);
        assert!(!channel.received(1, true));
        assert!(!channel.is_over());
        channel.close(0);
        assert!(channel.is_over());
    }
}
