//! Models one L2CAP channel: the send queue of each end, and the credits and the receive buffer of each end (Vol 3,
//! Part A, 10.1).
//!
//! The channel moves complete SDUs and counts their bytes. The connection decides which packet carries which bytes.
use std::collections::VecDeque;

use super::{
    message::{RequestId, SendLimits, Violation},
    options::RECEIVE_BUFFER_BYTES,
};

/// Size of the length field at the start of every SDU.
const SDU_HEADER_BYTES: usize = 2;

/// A channel with its two ends: index 0 at the central, index 1 at the peripheral.
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

/// State of the channel from the view of one end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum EndState {
    /// The end requested the channel and waits for the response.
    Opening(RequestId),
    /// The request has not arrived yet.
    Unaware,
    /// The channel is open.
    Open,
    /// The channel was closed by its owner or by the end of the connection.
    Closed,
}

#[derive(Debug, Default)]
struct SendQueue {
    sdus: VecDeque<Outgoing>,
    /// Bytes of unacknowledged SDUs, including those in `sdus`.
    unacknowledged_bytes: usize,
    credits: u32,
}

#[derive(Debug)]
struct Outgoing {
    sdu: Vec<u8>,
    /// Bytes not yet cut into frames, including the header.
    left_bytes: usize,
}

/// Counts in frames: one credit permits one frame, full or not.
#[derive(Debug)]
struct ReceiveBuffer {
    /// Total capacity in frames.
    size: u32,
    /// Credits that the sender has, or that are in flight to it.
    granted: u32,
    /// Frames of the SDU that is not complete yet.
    partial: u32,
    /// Number of frames of each SDU that its owner has not read, oldest first.
    unread: VecDeque<u32>,
}

/// A piece of an SDU, ready to be sent.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Piece {
    pub(super) bytes: usize,
    /// Bytes of the piece that belong to the SDU itself, without the header.
    pub(super) sdu_bytes: usize,
    /// The complete SDU; set only in its last piece.
    pub(super) sdu: Option<Vec<u8>>,
}

impl Channel {
    /// Returns a channel that the end on `side` requests.
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

    /// Accepts the channel at `side`. The other end learns of it by the response.
    pub(super) fn accept(&mut self, side: usize, recv_mtu: u16) {
        let mps = u16::try_from(self.mps).unwrap_or(u16::MAX);
        self.ends[side].state = EndState::Open;
        self.ends[side].recv_mtu = recv_mtu;
        self.ends[side].receiving = ReceiveBuffer::new(recv_mtu, mps);
        // The request carried the credits of the requesting end.
        self.ends[side].sending.credits = self.ends[1 - side].receiving.grant_all();
    }

    /// Opens the end on `side`, whose request was accepted.
    pub(super) fn confirm(&mut self, side: usize) {
        self.ends[side].state = EndState::Open;
        self.ends[side].sending.credits = self.ends[1 - side].receiving.grant_all();
    }

    /// Queues an SDU at `side`.
    ///
    /// # Errors
    /// Fails if the peer cannot receive an SDU of this size, or if the send queue is full.
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

    /// Returns whether `side` has a frame to send and a credit for it.
    pub(super) fn is_ready(&self, side: usize) -> bool {
        let sending = &self.ends[side].sending;
        sending.credits > 0 && !sending.sdus.is_empty()
    }

    /// Cuts the piece for the next frame off the oldest SDU, and spends one credit.
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

    /// Handles the acknowledgement of `bytes` of the SDUs from `side`. Returns `false` if that end is no longer open.
    pub(super) fn on_acknowledged(&mut self, side: usize, bytes: usize) -> bool {
        let end = &mut self.ends[side];
        end.sending.unacknowledged_bytes = end.sending.unacknowledged_bytes.saturating_sub(bytes);
        end.state == EndState::Open
    }

    /// Handles a frame that arrived at `side`; `is_last` marks the last frame of an SDU. Returns `false` if that end is
    /// closed and the frame is dropped.
    pub(super) fn on_frame(&mut self, side: usize, is_last: bool) -> bool {
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

    /// Handles that the owner of `side` read its oldest SDU.
    pub(super) fn on_sdu_read(&mut self, side: usize) -> Result<(), Violation> {
        let end = &mut self.ends[side];
        match end.receiving.unread.pop_front() {
            Some(_) => Ok(()),
            None if end.state == EndState::Closed => Ok(()),
            None => Err(Violation::NothingToRead),
        }
    }

    /// Returns the credits that `side` should send now, if they are worth a packet.
    pub(super) fn due_credits(&mut self, side: usize) -> Option<u32> {
        let end = &mut self.ends[side];
        if end.state != EndState::Open {
            return None;
        }
        end.receiving.due()
    }

    /// Handles credits that arrived at `side`.
    pub(super) fn on_credits(&mut self, side: usize, frames: u32) {
        let sending = &mut self.ends[side].sending;
        sending.credits = sending.credits.saturating_add(frames);
    }

    /// Closes the end on `side`, discards its send queue, and returns its previous state.
    pub(super) fn close(&mut self, side: usize) -> EndState {
        let end = &mut self.ends[side];
        end.sending = SendQueue::default();
        std::mem::replace(&mut end.state, EndState::Closed)
    }

    /// Returns whether neither end uses the channel any more.
    pub(super) fn is_finished(&self) -> bool {
        self.ends
            .iter()
            .all(|end| matches!(end.state, EndState::Closed | EndState::Unaware))
    }

    /// Returns whether the end on `side` waits for the response to that request.
    pub(super) fn is_opening(&self, side: usize, request: RequestId) -> bool {
        self.ends[side].state == EndState::Opening(request)
    }

    /// Returns whether the end on `side` can send and receive.
    pub(super) fn is_open(&self, side: usize) -> bool {
        self.ends[side].state == EndState::Open
    }

    /// Returns whether the end on `side` is closed.
    pub(super) fn is_closed(&self, side: usize) -> bool {
        self.ends[side].state == EndState::Closed
    }

    /// Returns the limits for SDUs sent by `side`.
    pub(super) fn send_limits(&self, side: usize) -> SendLimits {
        SendLimits {
            sdu_bytes: self.ends[1 - side].recv_mtu,
            ahead_bytes: self.ahead_bytes,
        }
    }

    /// Returns the number of bytes queued at `side`, for the status.
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

    /// Grants half of the buffer at a time, so that credits take little airtime, or immediately if the sender has no
    /// credits left.
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
    fn splits_an_sdu_into_frames_after_its_length_field() {
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
    fn refuses_sdus_larger_than_the_peers_mtu() {
        let mut channel = open(247, 100);
        assert_eq!(channel.queue(0, vec![0; 101]), Err(Violation::SduSize));
        assert_eq!(channel.queue(0, vec![]), Err(Violation::SduSize));
        assert_eq!(channel.queue(0, vec![0; 100]), Ok(()));
    }

    #[test]
    fn bounds_the_send_queue_but_accepts_one_large_sdu() {
        let mut channel = open(247, 60000);
        channel.queue(0, vec![0; 60000]).expect("alone");
        assert_eq!(channel.queue(0, vec![0; 1]), Err(Violation::NoRoom));
        assert!(channel.on_acknowledged(0, 60000));
        channel.queue(0, vec![0; 2000]).expect("room again");
    }

    #[test]
    fn blocks_the_sender_until_the_receiver_reads() {
        let mut channel = open(247, 1000);
        let mut arrived = 0;
        loop {
            channel
                .queue(0, vec![0; 245])
                .expect("acknowledged at once");
            let Some(piece) = channel.cut(0) else { break };
            assert!(channel.on_frame(1, piece.sdu.is_some()));
            channel.on_acknowledged(0, 245);
            assert_eq!(channel.due_credits(1), None);
            arrived += 1;
        }
        assert_eq!(arrived, RECEIVE_BUFFER_BYTES / 247);
        channel.on_sdu_read(1).expect("there is one");
        assert_eq!(channel.due_credits(1), Some(1));
        channel.on_credits(0, 1);
        assert!(channel.cut(0).is_some());
    }

    #[test]
    fn reading_a_missing_sdu_is_a_violation() {
        let mut channel = open(247, 1000);
        assert_eq!(channel.on_sdu_read(0), Err(Violation::NothingToRead));
    }

    #[test]
    fn drops_frames_that_arrive_at_a_closed_end() {
        let mut channel = open(247, 1000);
        assert_eq!(channel.close(1), EndState::Open);
        assert!(!channel.on_frame(1, true));
        assert!(!channel.is_finished());
        channel.close(0);
        assert!(channel.is_finished());
    }
}
