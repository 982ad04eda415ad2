//! Reads the messages of a file in the order of their times, whatever the order in which they were written.
use std::{
    cmp::Reverse,
    collections::{BTreeMap, BinaryHeap},
    ops::Range,
    path::PathBuf,
    time::Duration,
};

use mcap::{
    records::{op, Metadata},
    McapError,
};

use super::{
    contents::{log_time, Contents},
    input::Input,
    layout::{Block, Layout},
};
use crate::{chunk::Chunk, entry::Entry, file::ORIGINAL};

/// How many bytes of blocks are kept, whose messages are not all due yet. Beyond that, a block is read again.
const KEPT_BYTES: usize = 64 << 20;

/// A part of a file that cannot be read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Missing {
    /// The file.
    pub path: PathBuf,
    /// Where it is.
    pub bytes: Range<u64>,
    /// When its first and last message were recorded, since 1970; `None` if that is not known.
    pub times: Option<(Duration, Duration)>,
    /// Why it cannot be read.
    pub reason: String,
}

/// Where a message is. In the order of time, and of the file if the time is equal.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    time: u64,
    block: usize,
    at: usize,
}

/// A block whose messages are not all read.
struct Loaded {
    unread: usize,
    /// `None`: it has to be read again.
    chunk: Option<Chunk>,
}

/// The messages of a file.
pub(super) struct ByTime {
    path: PathBuf,
    input: Input,
    blocks: Vec<Block>,
    contents: Contents,
    /// The blocks that are not loaded yet. The next one is the last.
    waiting: Vec<usize>,
    /// The messages of the loaded blocks.
    places: BinaryHeap<Reverse<Place>>,
    loaded: BTreeMap<usize, Loaded>,
    kept_bytes: usize,
    problem: Option<McapError>,
    /// The number of messages that were returned, and that of the file according to itself.
    returned: u64,
    expected: Option<u64>,
    /// The number of messages of channels that are not described.
    undescribed: u64,
    /// `None`: reading ends where the file is damaged.
    missing: Option<Vec<Missing>>,
}

impl ByTime {
    /// Returns the messages of a file, and its metadata.
    pub(super) fn new(
        path: PathBuf,
        mut input: Input,
        is_tolerant: bool,
    ) -> Result<(Self, Vec<Metadata>), McapError> {
        let layout = Layout::read(&mut input, is_tolerant)?;
        let mut waiting = Vec::from_iter(0..layout.blocks.len());
        waiting.sort_by_key(|block| layout.blocks[*block].first);
        let is_ordered = waiting.is_sorted();
        waiting.reverse();
        let gap = |(bytes, problem): (Range<u64>, McapError)| Missing {
            path: path.clone(),
            bytes,
            times: None,
            reason: problem.to_string(),
        };
        let gaps = layout.gaps.into_iter().map(gap).collect();
        let mut messages = Self {
            input,
            blocks: layout.blocks,
            contents: layout.contents,
            waiting,
            places: BinaryHeap::new(),
            loaded: BTreeMap::new(),
            kept_bytes: 0,
            problem: layout.problem,
            returned: 0,
            expected: layout.messages,
            undescribed: 0,
            missing: is_tolerant.then_some(gaps),
            path,
        };
        if !is_ordered && !layout.has_summary {
            messages.find_channels();
        }
        Ok((messages, layout.metadata))
    }

    /// Finds the channels that are described in earlier blocks of the file than those with their messages, and read later.
    fn find_channels(&mut self) {
        for block in &self.blocks {
            // Damage is reported when the block is read.
            let Ok(chunk) = block.read(&mut self.input) else {
                continue;
            };
            let mut at = 0;
            while let Ok(Some((kind, data, next))) = chunk.record(at) {
                if self.contents.on_record(kind, data).is_err() {
                    break;
                }
                at = next;
            }
        }
    }

    /// Returns what could not be read.
    pub(super) fn into_missing(self) -> Vec<Missing> {
        let Some(mut missing) = self.missing else {
            return Vec::new();
        };
        let (returned, undescribed) = (self.returned, self.undescribed);
        let expected = self.expected.filter(|expected| *expected > returned);
        let reason = match expected {
            _ if undescribed > 0 => {
                format!("the description of the topics of {undescribed} messages is damaged")
            }
            Some(expected) => format!("it has {expected} messages, of which {returned} are whole"),
            None => return missing,
        };
        missing.push(Missing {
            path: self.path,
            bytes: 0..0,
            times: None,
            reason,
        });
        missing
    }

    /// Returns the next message; `None` at the end of the file.
    pub(super) fn next(&mut self) -> Result<Option<Entry>, McapError> {
        loop {
            let place = self.places.peek().map(|Reverse(place)| *place);
            let is_due = |block: &&usize| {
                let first = self.blocks[**block].first;
                place.is_none_or(|place| first < place.time)
            };
            if let Some(block) = self.waiting.last().filter(is_due).copied() {
                self.waiting.pop();
                self.on_block(block)?;
                continue;
            }
            let Some(place) = place else {
                return self.problem.take().map_or(Ok(None), Err);
            };
            self.places.pop();
            match self.entry(place) {
                Err(McapError::UnknownChannel(..)) if self.missing.is_some() => {
                    self.undescribed += 1;
                }
                entry => {
                    self.returned += 1;
                    return entry.map(Some);
                }
            }
        }
    }

    /// Loads a block. If it is damaged, the messages before it are returned, and then the error.
    fn on_block(&mut self, block: usize) -> Result<(), McapError> {
        let problem = match self.load(block) {
            Ok(()) => return Ok(()),
            Err(McapError::Io(error)) => return Err(error.into()),
            Err(problem) => problem,
        };
        let Some(missing) = &mut self.missing else {
            self.waiting.clear();
            self.problem = Some(problem);
            return Ok(());
        };
        let Block {
            bytes, first, last, ..
        } = &self.blocks[block];
        missing.push(Missing {
            path: self.path.clone(),
            bytes: bytes.clone(),
            times: Some((Duration::from_nanos(*first), Duration::from_nanos(*last))),
            reason: problem.to_string(),
        });
        Ok(())
    }

    fn load(&mut self, block: usize) -> Result<(), McapError> {
        let chunk = self.blocks[block].read(&mut self.input)?;
        let (mut at, mut unread) = (0, 0);
        let indexed = loop {
            match chunk.record(at) {
                Ok(Some((op::MESSAGE, message, next))) => {
                    match log_time(message) {
                        Ok(time) => self.places.push(Reverse(Place { time, block, at })),
                        Err(error) => break Err(error),
                    }
                    unread += 1;
                    at = next;
                }
                Ok(Some((kind, data, next))) => {
                    if let Err(error) = self.contents.on_record(kind, data) {
                        break Err(error);
                    }
                    at = next;
                }
                Ok(None) => break Ok(()),
                Err(error) => break Err(error),
            }
        };
        self.keep(block, unread, chunk);
        indexed
    }

    fn entry(&mut self, place: Place) -> Result<Entry, McapError> {
        let Place { block, at, .. } = place;
        let Some(Loaded { unread, chunk }) = self.loaded.remove(&block) else {
            return Err(McapError::UnexpectedEoc);
        };
        let chunk = match chunk {
            Some(chunk) => {
                self.kept_bytes -= chunk.bytes();
                chunk
            }
            None => self.blocks[block].read(&mut self.input)?,
        };
        let entry = match chunk.record(at)? {
            Some((op::MESSAGE, message, next)) => {
                let original = match chunk.record(next) {
                    Ok(Some((ORIGINAL, original, _))) => Some(original),
                    _ => None,
                };
                self.contents.entry(message, original)
            }
            _ => Err(McapError::UnexpectedEoc),
        };
        self.keep(block, unread - 1, chunk);
        entry
    }

    /// Keeps a block until its messages are read, unless there are too many.
    fn keep(&mut self, block: usize, unread: usize, chunk: Chunk) {
        if unread == 0 {
            return;
        }
        self.kept_bytes += chunk.bytes();
        let chunk = Some(chunk);
        self.loaded.insert(block, Loaded { unread, chunk });
        let others = self.loaded.iter_mut().filter(|(other, _)| **other != block);
        for (_, other) in others {
            if self.kept_bytes <= KEPT_BYTES {
                break;
            }
            if let Some(chunk) = other.chunk.take() {
                self.kept_bytes -= chunk.bytes();
            }
        }
    }
}
