//! Owns the reading of files that users name: a pipe, a device or a socket in a file's place must not hold up a reader.
use std::{
    fs::{File, OpenOptions},
    io::{self, Read},
    os::unix::fs::OpenOptionsExt,
    path::Path,
};

use nix::libc::O_NONBLOCK;

/// Opens a file for reading, unless it is a folder, a pipe, a device or a socket.
pub fn open(path: &Path) -> io::Result<File> {
    // Without this flag, opening a pipe waits for a writer.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(O_NONBLOCK)
        .open(path)?;
    if !file.metadata()?.is_file() {
        let what = "it is not a regular file";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, what));
    }
    Ok(file)
}

/// Reads a text of at most `max_bytes`.
pub fn read_to_string(path: &Path, max_bytes: u64) -> io::Result<String> {
    let mut text = String::new();
    let read = open(path)?.take(max_bytes + 1).read_to_string(&mut text)?;
    if read as u64 > max_bytes {
        let what = format!("it is larger than {max_bytes} bytes");
        return Err(io::Error::new(io::ErrorKind::InvalidData, what));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use nix::{sys::stat::Mode, unistd::mkfifo};

    use super::*;

    #[test]
    fn a_pipe_is_refused_at_once() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("pipe");
        mkfifo(&path, Mode::S_IRWXU).expect("a pipe");
        let error = open(&path).expect_err("a pipe");
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
        assert!(open(Path::new("/dev/zero")).is_err());
        assert!(open(folder.path()).is_err());
    }

    #[test]
    fn a_text_may_be_as_long_as_its_limit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("text");
        fs::write(&path, "1234").expect("written");
        assert_eq!(read_to_string(&path, 4).expect("text"), "1234");
        assert!(read_to_string(&path, 3).is_err());
    }
}
