//! Reads a file at any position.
use std::io::{self, BufReader, Read, Seek, SeekFrom};

/// A file, or what is read like one.
pub trait Source: Read + Seek + Send {}

impl<T: Read + Seek + Send> Source for T {}

pub(super) struct Input {
    file: BufReader<Box<dyn Source>>,
    /// The position of `file`.
    at: u64,
    end: u64,
}

impl Input {
    pub(super) fn new(mut file: Box<dyn Source>) -> io::Result<Self> {
        let end = file.seek(SeekFrom::End(0))?;
        file.rewind()?;
        Ok(Self {
            file: BufReader::new(file),
            at: 0,
            end,
        })
    }

    /// Returns the size of the file when it was opened.
    pub(super) fn end(&self) -> u64 {
        self.end
    }

    /// Fills a buffer with the bytes at a position.
    pub(super) fn read_at(&mut self, at: u64, buffer: &mut [u8]) -> io::Result<()> {
        // Small steps stay within the buffer.
        let by = i64::try_from(i128::from(at) - i128::from(self.at));
        self.file.seek_relative(by.map_err(io::Error::other)?)?;
        self.file.read_exact(buffer)?;
        self.at = at + buffer.len() as u64;
        Ok(())
    }

    /// Returns `length` bytes at a position. They must be within the file.
    pub(super) fn bytes(&mut self, at: u64, length: usize) -> io::Result<Vec<u8>> {
        let mut bytes = vec![0; length];
        self.read_at(at, &mut bytes)?;
        Ok(bytes)
    }
}
