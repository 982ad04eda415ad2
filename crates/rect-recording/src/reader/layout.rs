//! Finds where in a file what is, without reading the messages.
use std::{io, ops::Range};

use mcap::{
    records::{op, Metadata, Record},
    McapError, MAGIC,
};

use super::{
    contents::{log_time, parsed, Contents},
    input::Input,
};
use crate::{
    chunk::{Chunk, HEAD},
    file::ORIGINAL,
};

/// The largest record that is read, in bytes, except those with messages.
pub(super) const MAX_RECORD: usize = 64 * 1024 * 1024;
/// The largest chunk or message that is read, in bytes, also when it is decompressed. Recordings of RECT have chunks of about 1 MB; other
/// programs may write all messages into a single one.
const MAX_MESSAGES: usize = 1 << 30;
/// How many bytes of messages outside of chunks make one block.
const RUN_BYTES: u64 = 1 << 20;
/// The size of the numbers at the beginning of a message.
const MESSAGE_HEAD: usize = 22;
/// The size of the head of a chunk without the name of its compression.
const CHUNK_HEAD: usize = 40;
/// The longest name of a compression.
const MAX_COMPRESSION: usize = 4;
/// How many bytes are searched at once for a chunk.
const SEARCHED: usize = 1 << 20;

/// Messages that are read at once: a chunk, or messages outside of chunks that follow each other.
#[derive(Clone, Debug)]
pub(super) struct Block {
    /// Where it is.
    pub(super) bytes: Range<u64>,
    /// The times of its first and last message, in nanoseconds.
    pub(super) first: u64,
    pub(super) last: u64,
    is_chunk: bool,
}

/// The parts of a file.
#[derive(Default)]
pub(super) struct Layout {
    pub(super) blocks: Vec<Block>,
    /// The channels that are described outside of chunks.
    pub(super) contents: Contents,
    /// Whether the channels are described behind the messages again.
    pub(super) has_summary: bool,
    pub(super) profile: String,
    pub(super) metadata: Vec<Metadata>,
    /// Where the attachments are.
    pub(super) attachments: Vec<Range<u64>>,
    /// The number of messages, according to the file.
    pub(super) messages: Option<u64>,
    /// Why the file ends early.
    pub(super) problem: Option<McapError>,
    /// The bytes that are not a record and why, if the rest was searched for.
    pub(super) gaps: Vec<(Range<u64>, McapError)>,
    is_behind_messages: bool,
}

impl Block {
    /// Reads the messages.
    pub(super) fn read(&self, input: &mut Input) -> Result<Chunk, McapError> {
        let length = usize::try_from(self.bytes.end - self.bytes.start).unwrap_or(usize::MAX);
        let bytes = input.bytes(self.bytes.start, length)?;
        if !self.is_chunk {
            return Ok(Chunk::of(bytes));
        }
        match parsed(op::CHUNK, &bytes)? {
            Record::Chunk { header, data } => Chunk::read(&header, &data, MAX_MESSAGES),
            _ => Err(McapError::UnexpectedEoc),
        }
    }
}

impl Layout {
    /// Reads the layout of a file. If it is damaged, what is behind the damage is searched for if `is_tolerant`.
    pub(super) fn read(input: &mut Input, is_tolerant: bool) -> io::Result<Self> {
        let mut layout = Self::default();
        let (mut before, mut at) = (0, 0);
        loop {
            let step = match at {
                0 => magic(input, 0).map(Some),
                at => layout.step(input, at, is_tolerant),
            };
            match step {
                Ok(Some(next)) => (before, at) = (at, next),
                Ok(None) => return Ok(layout),
                Err(McapError::Io(error)) => return Err(error),
                Err(problem) if !is_tolerant => {
                    layout.problem = Some(problem);
                    return Ok(layout);
                }
                Err(problem) => {
                    // The length of the record before may be wrong.
                    let found = next_chunk(input, before + 1)?;
                    let end = found.unwrap_or(input.end());
                    if end > at || found.is_none() {
                        layout.gaps.push((at..end, problem));
                    }
                    let Some(found) = found else {
                        return Ok(layout);
                    };
                    (before, at) = (found, found);
                }
            }
        }
    }

    /// Handles the record at a position. Returns the position of the next one; `None` at the end of the file.
    fn step(
        &mut self,
        input: &mut Input,
        at: u64,
        is_tolerant: bool,
    ) -> Result<Option<u64>, McapError> {
        let (kind, length) = head(input, at)?;
        let begin = at + HEAD as u64;
        let next = begin
            .checked_add(length)
            .filter(|next| *next <= input.end());
        let next = next.ok_or(McapError::UnexpectedEof)?;
        let content = begin..next;
        match kind {
            op::CHUNK => {
                let mut times = [0; 16];
                read_head(input, &content, kind, &mut times)?;
                let [first, last] = [&times[..8], &times[8..]].map(number);
                self.blocks.push(Block {
                    bytes: content,
                    first,
                    last,
                    is_chunk: true,
                });
            }
            op::MESSAGE => {
                let mut message = [0; MESSAGE_HEAD];
                read_head(input, &content, kind, &mut message)?;
                let time = log_time(&message)?;
                self.add_to_run(at..next, Some(time));
            }
            ORIGINAL => self.add_to_run(at..next, None),
            op::HEADER | op::SCHEMA | op::CHANNEL | op::METADATA | op::STATISTICS => {
                let length = limited(kind, length)?;
                let data = input.bytes(content.start, length)?;
                self.on_record(kind, &data)?;
            }
            op::ATTACHMENT => self.attachments.push(content),
            op::DATA_END => self.is_behind_messages = true,
            op::FOOTER => return magic(input, next).map(|_| None),
            op::MESSAGE_INDEX..=op::SUMMARY_OFFSET | 0x80.. => {}
            // A later version of the format may have further records. A damaged file rather has none.
            _ if is_tolerant || kind == 0 => return Err(McapError::BadFooter),
            _ => {}
        }
        Ok(Some(next))
    }

    fn on_record(&mut self, kind: u8, data: &[u8]) -> Result<(), McapError> {
        match kind {
            op::STATISTICS => self.messages = data.first_chunk().map(|n| u64::from_le_bytes(*n)),
            op::SCHEMA | op::CHANNEL => {
                self.has_summary |= self.is_behind_messages;
                self.contents.on_record(kind, data)?;
            }
            _ => match parsed(kind, data)? {
                Record::Header(header) => self.profile = header.profile,
                Record::Metadata(metadata) => self.metadata.push(metadata),
                _ => {}
            },
        }
        Ok(())
    }

    /// Adds a message outside of chunks to the last block, or the payload that follows a message.
    fn add_to_run(&mut self, bytes: Range<u64>, time: Option<u64>) {
        let run = self.blocks.last_mut().filter(|run| {
            let length = run.bytes.end - run.bytes.start;
            !run.is_chunk && run.bytes.end == bytes.start && (length < RUN_BYTES || time.is_none())
        });
        match (run, time) {
            (Some(run), time) => {
                run.bytes.end = bytes.end;
                run.first = run.first.min(time.unwrap_or(u64::MAX));
                run.last = run.last.max(time.unwrap_or(0));
            }
            (None, Some(time)) => self.blocks.push(Block {
                bytes,
                first: time,
                last: time,
                is_chunk: false,
            }),
            // It belongs to no message.
            (None, None) => {}
        }
    }
}

/// Returns the kind and the length of the record at a position.
fn head(input: &mut Input, at: u64) -> Result<(u8, u64), McapError> {
    if input.end() - at < HEAD as u64 {
        return Err(McapError::UnexpectedEof);
    }
    let mut head = [0; HEAD];
    input.read_at(at, &mut head)?;
    Ok((head[0], number(&head[1..])))
}

/// Reads the beginning of a record that is read later.
fn read_head(
    input: &mut Input,
    content: &Range<u64>,
    kind: u8,
    buffer: &mut [u8],
) -> Result<(), McapError> {
    let length = limited(kind, content.end - content.start)?;
    if length < buffer.len() {
        return Err(McapError::UnexpectedEoc);
    }
    Ok(input.read_at(content.start, buffer)?)
}

/// Verifies the magic bytes at a position. Returns the position behind them.
fn magic(input: &mut Input, at: u64) -> Result<u64, McapError> {
    let next = at + MAGIC.len() as u64;
    if next > input.end() {
        return Err(McapError::UnexpectedEof);
    }
    match input.bytes(at, MAGIC.len())? == MAGIC {
        true => Ok(next),
        false => Err(McapError::BadMagic),
    }
}

fn limited(opcode: u8, len: u64) -> Result<usize, McapError> {
    let limit = match opcode {
        op::CHUNK | op::MESSAGE | ORIGINAL => MAX_MESSAGES,
        _ => MAX_RECORD,
    };
    let length = usize::try_from(len).ok();
    length
        .filter(|length| *length <= limit)
        .ok_or(McapError::RecordTooLarge { opcode, len })
}

fn number(bytes: &[u8]) -> u64 {
    bytes.first_chunk().map_or(0, |n| u64::from_le_bytes(*n))
}

/// Returns the position of the first chunk that begins at `at` or later.
fn next_chunk(input: &mut Input, mut at: u64) -> io::Result<Option<u64>> {
    const LENGTH: usize = HEAD + CHUNK_HEAD + MAX_COMPRESSION;
    while at < input.end() {
        let rest = input.end() - at;
        let length = usize::try_from(rest).map_or(SEARCHED, |rest| rest.min(SEARCHED));
        let bytes = input.bytes(at, length)?;
        let found = (0..length).find(|&n| is_chunk(&bytes[n..], rest - n as u64));
        if let Some(found) = found {
            return Ok(Some(at + found as u64));
        }
        // A head may begin at the end of what was read.
        at += (length.saturating_sub(LENGTH)).max(1) as u64;
    }
    Ok(None)
}

/// Returns whether bytes look like a chunk, of which `rest` bytes follow in the file at most.
fn is_chunk(bytes: &[u8], rest: u64) -> bool {
    if bytes.first() != Some(&op::CHUNK) || bytes.len() < HEAD + CHUNK_HEAD {
        return false;
    }
    let length = number(&bytes[1..]);
    let fits = length <= MAX_MESSAGES as u64 && HEAD as u64 + length <= rest;
    let head = &bytes[HEAD..];
    let [first, last, size] = [0, 8, 16].map(|at| number(&head[at..]));
    let Some((name, records)) = head.get(28..).and_then(|rest| {
        let (length, rest) = rest.split_first_chunk()?;
        let length = u32::from_le_bytes(*length) as usize;
        rest.split_at_checked(length.min(MAX_COMPRESSION + 1))
    }) else {
        return false;
    };
    let is_known = [&b""[..], b"zstd", b"lz4"].contains(&name);
    let stored = (CHUNK_HEAD + name.len()) as u64;
    let is_stored = records.len() >= 8 && Some(number(records)) == length.checked_sub(stored);
    fits && first <= last && size <= MAX_MESSAGES as u64 && is_known && is_stored
}
