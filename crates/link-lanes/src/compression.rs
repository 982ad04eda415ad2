//! Compresses the batches of Zenoh's `Control` priority, nearly all of which are declarations. When two routers are linked, each declares
//! everything that it knows, with keys that resemble each other, before anything else. Each direction is one stream of DEFLATE, so that
//! a batch repeats nothing of the batches before it. For the layout see section 4.1 of `PROTOCOL.md`.
use std::{
    borrow::Cow,
    time::{Duration, Instant},
};

use flate2::{Compress, Compression, Decompress, FlushCompress, FlushDecompress, Status};

/// The first bytes of compressed batches. The low five bits of the first byte of Zenoh's messages are their kind, and no kind is 0x1f.
const CONTINUES: u8 = 0x1f;
const BEGINS: u8 = 0x3f;
/// The last bytes of each part of a stream, which are not sent.
const TAIL: [u8; 4] = [0, 0, 0xff, 0xff];
/// Shorter batches, such as keep-alives, stay as they are.
const MIN_BYTES: usize = 40;
/// The memory of a stream, about 300 kB, is released at the next keep-alive after this time without declarations.
const IDLE: Duration = Duration::from_secs(5);
/// The largest number of bytes by which a part of a stream, with its first and last bytes, is longer than its batch.
const MAX_GROWTH: usize = 32;

/// Compresses the batches of one direction of a link.
#[derive(Debug, Default)]
pub struct Compressor {
    /// The stream up to the last batch that was sent.
    stream: Option<Compress>,
    /// The stream with a batch that may never be sent. Then another stream begins.
    unsent: Option<Compress>,
    used: Option<Instant>,
}

impl Compressor {
    /// Returns what to send for a batch: it is compressed, or stays as it is if that is not longer. Call
    /// [`on_sent`](Self::on_sent) once it is queued, before the next batch.
    pub fn compress<'a>(&mut self, batch: &'a [u8], now: Instant) -> Cow<'a, [u8]> {
        self.unsent = None;
        if batch.len() < MIN_BYTES {
            if self.used.is_some_and(|used| now >= used + IDLE) {
                self.stream = None;
            }
            return Cow::Borrowed(batch);
        }
        self.used = Some(now);
        let (first, mut stream) = match self.stream.take() {
            Some(stream) => (CONTINUES, stream),
            None => (BEGINS, Compress::new(Compression::default(), false)),
        };
        let mut bytes = Vec::with_capacity(batch.len() + MAX_GROWTH);
        bytes.push(first);
        let before = stream.total_in();
        let status = stream.compress_vec(batch, &mut bytes, FlushCompress::Sync);
        let is_whole = stream.total_in() - before == batch.len() as u64;
        if matches!(status, Ok(Status::Ok)) && is_whole && bytes.ends_with(&TAIL) {
            bytes.truncate(bytes.len() - TAIL.len());
            if bytes.len() < batch.len() {
                self.unsent = Some(stream);
                return Cow::Owned(bytes);
            }
        }
        Cow::Borrowed(batch)
    }

    /// Handles that what was returned last is queued for the peer.
    pub fn on_sent(&mut self) {
        if let Some(stream) = self.unsent.take() {
            self.stream = Some(stream);
        }
    }
}

/// Restores the batches of one direction of a link.
#[derive(Debug, Default)]
pub struct Decompressor(Option<Decompress>);

/// Why a batch cannot be restored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a compressed batch that is damaged, or over {max} bytes")]
pub struct NotCompressed {
    /// The largest batch, in bytes.
    pub max: usize,
}

impl Decompressor {
    /// Returns the batch, of at most `max` bytes, for which the peer has sent these bytes.
    ///
    /// # Errors
    /// Fails if they do not continue the stream, or if the batch is empty or larger.
    pub fn decompress(&mut self, sent: Vec<u8>, max: usize) -> Result<Vec<u8>, NotCompressed> {
        let part = match sent.split_first() {
            Some((&BEGINS, part)) => {
                self.0 = Some(Decompress::new(false));
                part
            }
            Some((&CONTINUES, part)) => part,
            _ => return Ok(sent),
        };
        let invalid = NotCompressed { max };
        let stream = self.0.as_mut().ok_or(invalid)?;
        let part = [part, &TAIL].concat();
        // One byte more than is allowed, so that more of it is detected.
        let mut batch = Vec::with_capacity(max + 1);
        let before = stream.total_in();
        let status = stream.decompress_vec(&part, &mut batch, FlushDecompress::Sync);
        let is_whole = stream.total_in() - before == part.len() as u64;
        if !matches!(status, Ok(Status::Ok)) || !is_whole || !(1..=max).contains(&batch.len()) {
            self.0 = None;
            return Err(invalid);
        }
        batch.shrink_to_fit();
        Ok(batch)
    }
}

#[cfg(test)]
mod tests;
