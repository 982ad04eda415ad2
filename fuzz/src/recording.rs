//! Reads untrusted recordings: whole files, records of a file, and records of a chunk. The reader must return messages or one
//! error, and a viewer's form of each message.
use std::io::Cursor;

use rect_recording::{view::View, Reader};

const MAGIC: &[u8] = b"\x89MCAP0\r\n";
/// The kind of a chunk.
const CHUNK: u8 = 6;

/// Returns a record.
fn record(kind: u8, content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u64).to_le_bytes();
    [&[kind], length.as_slice(), content].concat()
}

/// Returns a chunk of these records, without compression and checksum.
fn chunk(records: &[u8]) -> Vec<u8> {
    let size = (records.len() as u64).to_le_bytes();
    let (times, no_checksum, no_compression) = ([0; 16], [0; 4], [0; 4]);
    let head = [
        times.as_slice(),
        &size,
        &no_checksum,
        &no_compression,
        &size,
    ]
    .concat();
    record(CHUNK, &[&head, records].concat())
}

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    let Some((form, bytes)) = input.split_first() else {
        return;
    };
    let file = match form % 3 {
        0 => bytes.to_vec(),
        1 => [MAGIC, bytes].concat(),
        _ => [MAGIC, &chunk(bytes)].concat(),
    };
    let Ok(reader) = Reader::of("fuzzed.mcap".into(), Cursor::new(file)) else {
        return;
    };
    for entry in reader {
        let Ok(entry) = entry else { break };
        assert!(!View::of(&entry).message().is_empty());
    }
}
