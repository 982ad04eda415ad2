//! Reads and writes files: those of transfers, what is sent ([`Source`]) and what is received ([`Store`]), and small ones that are
//! replaced as a whole ([`ReplacedFile`]). Apart from the files of dictionaries, all disk I/O of the protocol is here. This module does
//! not depend on Zenoh.
mod files;
pub mod regular_file;
mod replaced_file;
mod source;
mod state_folder;
mod store;

pub use files::{Concluded, Files};
pub use replaced_file::ReplacedFile;
pub use source::Source;
pub use state_folder::state_folder;
pub use store::{Content, Store};

use std::{
    fs::File,
    io::{self, Read},
};

use sha2::{Digest, Sha256};

use crate::transfer::Checksum;

/// The size of the read buffer, in bytes.
const BUFFER_BYTES: usize = 256 * 1024;

/// Computes the SHA-256 of a whole file, in little memory.
fn checksum(file: &mut File) -> io::Result<(Checksum, u64)> {
    let (mut hash, mut size) = (Sha256::new(), 0);
    let mut buffer = vec![0; BUFFER_BYTES];
    loop {
        match file.read(&mut buffer) {
            Ok(0) => return Ok((Checksum(hash.finalize().into()), size)),
            Ok(read) => {
                hash.update(buffer.get(..read).unwrap_or_default());
                size += read as u64;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => return Err(error),
        }
    }
}
