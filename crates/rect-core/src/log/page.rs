//! The questions for lines that a router keeps, and its answers, in JSON that is compressed if it is long.
use serde::{Deserialize, Serialize};

use super::{level::Level, line::Line, MAX_LAST};
use crate::{
    message::{encoding::Encoding, payload::Payload},
    name::Name,
};

/// The size at which a page ends, in bytes of its lines. A page of usual lines takes a fifth of that on the air.
pub(super) const PAGE: usize = 24 << 10;
/// The maximum size of a page, in bytes of its JSON. The last line may exceed [`PAGE`], and the JSON of a line may be longer than it.
const MAX_JSON: usize = 1 << 20;
/// The size from which on a page is compressed, in bytes.
const COMPRESSED_FROM: usize = 256;
const COMPRESSION_LEVEL: i32 = 3;
/// The bytes with which compressed data begins, as JSON never does.
const ZSTD: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];
/// The maximum size of a question, in bytes.
const MAX_QUESTION: usize = 1 << 10;

/// Which lines somebody asks for. The router answers with the newest ones that fit into a page.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// The maximum number of lines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub last: Option<usize>,
    /// The least important level.
    #[serde(default)]
    pub level: Level,
    /// The program; `None`: all programs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<String>,
    /// Only lines with smaller numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<u64>,
    /// Only lines with greater numbers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<u64>,
}

/// A line that a router keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Kept {
    /// Its number at this run of the router, beginning with 1.
    pub number: u64,
    /// The program.
    pub program: String,
    /// The line.
    #[serde(flatten)]
    pub line: Line,
}

/// Lines that a router keeps, in the order of their numbers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Page {
    /// The run of the router.
    pub run: u32,
    /// In an answer, the number of the newest line of all; in a publication, that of the line which was published before it with
    /// this key.
    pub at: u64,
    /// Whether there are older lines which the question selects.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub more: bool,
    /// The lines.
    pub lines: Vec<Kept>,
}

impl Question {
    /// Returns how many lines are asked for.
    pub fn count(&self) -> usize {
        self.last.unwrap_or(MAX_LAST).min(MAX_LAST)
    }

    /// Returns whether a line is one of those that are asked for.
    pub fn selects(&self, kept: &Kept) -> bool {
        let is_program = |name: &String| *name == kept.program;
        kept.line.level >= self.level
            && self.program.as_ref().is_none_or(is_program)
            && self.before.is_none_or(|before| kept.number < before)
            && self.after.is_none_or(|after| kept.number > after)
    }

    /// Returns the question as bytes.
    pub fn write(&self) -> Payload {
        let json = serde_json::to_vec(self).unwrap_or_default();
        Payload::new(json, Encoding::JSON)
    }

    /// Reads a question. One without bytes asks for everything.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        if bytes.is_empty() {
            return Ok(Self::default());
        }
        if bytes.len() > MAX_QUESTION {
            return Err(format!("a question has {MAX_QUESTION} bytes at most"));
        }
        serde_json::from_slice(bytes).map_err(|error| error.to_string())
    }
}

impl Page {
    /// Returns the page as bytes.
    pub fn write(&self) -> Payload {
        let json = serde_json::to_vec(self).unwrap_or_default();
        if json.len() >= COMPRESSED_FROM {
            if let Ok(compressed) = zstd::bulk::compress(&json, COMPRESSION_LEVEL) {
                return Payload::new(compressed, Encoding::BYTES);
            }
        }
        Payload::new(json, Encoding::JSON)
    }

    /// Reads a page, whose lines are cleaned, because nothing is known about the one who has sent it.
    ///
    /// # Errors
    /// Returns the reason.
    pub fn read(bytes: &[u8]) -> Result<Self, String> {
        let text = |error: &dyn std::fmt::Display| format!("lines that cannot be read: {error}");
        let decompressed;
        let json = if bytes.starts_with(&ZSTD) {
            decompressed = zstd::bulk::decompress(bytes, MAX_JSON).map_err(|error| text(&error))?;
            &decompressed[..]
        } else {
            bytes
        };
        if json.len() > MAX_JSON {
            return Err(text(&format_args!("they have more than {MAX_JSON} bytes")));
        }
        let page: Self = serde_json::from_slice(json).map_err(|error| text(&error))?;
        let lines = page.lines.into_iter().map(Kept::clean);
        let mut lines: Vec<_> = lines.collect();
        lines.sort_by_key(|kept| kept.number);
        lines.dedup_by_key(|kept| kept.number);
        Ok(Self { lines, ..page })
    }
}

impl Kept {
    fn clean(self) -> Self {
        let program = match Name::new(&self.program) {
            Ok(_) => self.program,
            Err(_) => super::UNNAMED.to_owned(),
        };
        Self {
            program,
            line: self.line.clean(),
            ..self
        }
    }
}
