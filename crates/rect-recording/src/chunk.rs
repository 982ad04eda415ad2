//! Reads the records of a chunk, which a writer has usually compressed.
use std::io::Read;

use lz4_flex::frame::FrameDecoder;
use mcap::{records::ChunkHeader, McapError};

/// The names of the compressions of the format. Recordings of RECT have the first one.
const ZSTD: &str = "zstd";
const LZ4: &str = "lz4";
/// The size of a record's kind and of its length, in bytes.
pub(super) const HEAD: usize = 1 + size_of::<u64>();

/// The kind and the content of a record, and the position of the next one.
type Found<'a> = (u8, &'a [u8], usize);

/// The records of a chunk, or of messages outside of chunks.
#[derive(Default)]
pub(super) struct Chunk {
    records: Vec<u8>,
}

impl Chunk {
    /// Takes records that are not compressed.
    pub(super) fn of(records: Vec<u8>) -> Self {
        Self { records }
    }

    /// Decompresses and verifies a chunk of at most `limit` bytes.
    ///
    /// # Errors
    /// Fails if the chunk is damaged, too large, or compressed in another way.
    pub(super) fn read(header: &ChunkHeader, data: &[u8], limit: usize) -> Result<Self, McapError> {
        let size = header.uncompressed_size;
        let size = usize::try_from(size).ok().filter(|size| *size <= limit);
        let size = size.ok_or(McapError::ChunkTooLarge(header.uncompressed_size))?;
        let records = match header.compression.as_str() {
            "" => data.to_vec(),
            ZSTD => zstd::bulk::decompress(data, size)
                .map_err(|error| McapError::DecompressionError(error.to_string()))?,
            LZ4 => {
                let mut records = Vec::new();
                // One byte more shows that the header is wrong.
                let mut decoder = FrameDecoder::new(data).take(size as u64 + 1);
                match decoder.read_to_end(&mut records) {
                    Ok(_) => records,
                    Err(error) => return Err(McapError::DecompressionError(error.to_string())),
                }
            }
            other => return Err(McapError::UnsupportedCompression(other.to_owned())),
        };
        if records.len() != size {
            return Err(McapError::BadChunkLength {
                header: header.uncompressed_size,
                available: records.len() as u64,
            });
        }
        let saved = header.uncompressed_crc;
        let calculated = crc32fast::hash(&records);
        // A writer that computes none writes 0.
        if saved != 0 && saved != calculated {
            return Err(McapError::BadChunkCrc { saved, calculated });
        }
        Ok(Self { records })
    }

    /// Returns how many bytes the records have.
    pub(super) fn bytes(&self) -> usize {
        self.records.len()
    }

    /// Returns the record at a position; `None` after the last one.
    ///
    /// # Errors
    /// Fails if the record ends after the chunk.
    pub(super) fn record(&self, at: usize) -> Result<Option<Found<'_>>, McapError> {
        let rest = self.records.get(at..).unwrap_or_default();
        if rest.is_empty() {
            return Ok(None);
        }
        let (head, rest) = rest
            .split_at_checked(HEAD)
            .ok_or(McapError::UnexpectedEoc)?;
        let [kind, length @ ..] = head else {
            return Err(McapError::UnexpectedEoc);
        };
        let length = length.try_into().map(u64::from_le_bytes);
        let length = length.ok().and_then(|length| usize::try_from(length).ok());
        let content = length.and_then(|length| rest.get(..length));
        let content = content.ok_or(McapError::UnexpectedEoc)?;
        Ok(Some((*kind, content, at + HEAD + content.len())))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn chunk(compression: &str, data: &[u8], size: u64) -> Result<Chunk, McapError> {
        let header = ChunkHeader {
            message_start_time: 0,
            message_end_time: 0,
            uncompressed_size: size,
            uncompressed_crc: 0,
            compression: compression.to_owned(),
            compressed_size: data.len() as u64,
        };
        Chunk::read(&header, data, 1000)
    }

    fn record(kind: u8, content: &[u8]) -> Vec<u8> {
        let length = (content.len() as u64).to_le_bytes();
        [&[kind], length.as_slice(), content].concat()
    }

    #[test]
    fn records_are_read_in_their_order() {
        let records = [record(5, b"message"), record(5, b"")].concat();
        let size = records.len() as u64;
        let compressed = zstd::bulk::compress(&records, 1).expect("compressed");
        let mut encoder = lz4_flex::frame::FrameEncoder::new(Vec::new());
        encoder.write_all(&records).expect("compressed");
        let lz4 = encoder.finish().expect("compressed");
        for (compression, data) in [("", &records), (ZSTD, &compressed), (LZ4, &lz4)] {
            let chunk = chunk(compression, data, size).expect("a chunk");
            let record = |at| chunk.record(at).expect("whole");
            assert_eq!(record(0), Some((5, b"message".as_slice(), 16)));
            assert_eq!(record(16), Some((5, b"".as_slice(), 25)));
            assert_eq!(record(25), None);
        }
    }

    #[test]
    fn damaged_chunks_are_refused() {
        assert!(matches!(
            chunk("", b"x", 1001),
            Err(McapError::ChunkTooLarge(1001))
        ));
        assert!(matches!(
            chunk("", b"x", 2),
            Err(McapError::BadChunkLength { .. })
        ));
        assert!(matches!(
            chunk(ZSTD, b"x", 2),
            Err(McapError::DecompressionError(_))
        ));
        assert!(matches!(
            chunk(LZ4, b"x", 2),
            Err(McapError::DecompressionError(_))
        ));
        let mut bomb = lz4_flex::frame::FrameEncoder::new(Vec::new());
        bomb.write_all(&vec![0; 1 << 20]).expect("compressed");
        let bomb = bomb.finish().expect("compressed");
        assert!(matches!(
            chunk(LZ4, &bomb, 999),
            Err(McapError::BadChunkLength {
                available: 1000,
                ..
            })
        ));
        assert!(matches!(
            chunk("bz2", b"x", 1),
            Err(McapError::UnsupportedCompression(_))
        ));
        let mut record = record(5, b"message");
        record.pop();
        for size in 1..=record.len() {
            let chunk = chunk("", &record[..size], size as u64).expect("a chunk");
            assert!(
                matches!(chunk.record(0), Err(McapError::UnexpectedEoc)),
                "{size}"
            );
        }
    }
}
