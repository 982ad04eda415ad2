//! Opens files that users name, and rejects pipes, devices and sockets, which could block the reader.
use std::{
    fs::{self, DirBuilder, File, OpenOptions},
    io::{self, Read},
    os::unix::fs::{DirBuilderExt, OpenOptionsExt, PermissionsExt},
    path::Path,
};

use libc::O_NONBLOCK;

/// Opens a regular file for reading. Does not block.
///
/// # Errors
/// Fails if the file cannot be opened, or if it is a folder, a pipe, a device or a socket.
pub fn open(path: &Path) -> io::Result<File> {
    // Without this flag, opening a pipe would block until a writer opens it.
    let file = OpenOptions::new()
        .read(true)
        .custom_flags(O_NONBLOCK)
        .open(path)?;
    if !file.metadata()?.is_file() {
        let problem = "it is not a regular file";
        return Err(io::Error::new(io::ErrorKind::InvalidInput, problem));
    }
    Ok(file)
}

/// The permissions of new files: their owner writes, and their group reads them.
const MODE: u32 = 0o640;
/// Those of new folders.
const FOLDER_MODE: u32 = 0o750;

/// Creates a file, whose permissions do not depend on the umask of the program.
///
/// # Errors
/// Fails with [`io::ErrorKind::AlreadyExists`] if there is anything of that name, and if the file cannot be created.
pub fn create_new(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    let file = options.write(true).create_new(true).mode(MODE).open(path)?;
    file.set_permissions(fs::Permissions::from_mode(MODE))?;
    Ok(file)
}

/// Does the same as [`create_new`] with a folder.
///
/// # Errors
/// Fails like [`create_new`].
pub fn create_folder(path: &Path) -> io::Result<()> {
    DirBuilder::new().mode(FOLDER_MODE).create(path)?;
    fs::set_permissions(path, fs::Permissions::from_mode(FOLDER_MODE))
}

/// Reads a text file of at most `max_bytes`.
///
/// # Errors
/// Fails if the file is not a regular file, cannot be read, is larger than `max_bytes` or is not UTF-8.
pub fn read_to_string(path: &Path, max_bytes: u64) -> io::Result<String> {
    let mut text = String::new();
    let read = open(path)?.take(max_bytes + 1).read_to_string(&mut text)?;
    check_size(read, max_bytes)?;
    Ok(text)
}

/// Reads a file of at most `max_bytes`.
///
/// # Errors
/// Fails if the file is not a regular file, cannot be read, or is larger than `max_bytes`.
pub fn read(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let read = open(path)?.take(max_bytes + 1).read_to_end(&mut bytes)?;
    check_size(read, max_bytes)?;
    Ok(bytes)
}

fn check_size(read: usize, max_bytes: u64) -> io::Result<()> {
    if read as u64 > max_bytes {
        let problem = format!("it is larger than {max_bytes} bytes");
        return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::fs;

    use nix::{
        sys::stat::{umask, Mode},
        unistd::mkfifo,
    };

    use super::*;

    #[test]
    fn rejects_pipes_devices_and_folders_without_blocking() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("pipe");
        mkfifo(&path, Mode::S_IRWXU).expect("a pipe");
        let error = open(&path).expect_err("a pipe");
        assert_eq!(error.kind(), io::ErrorKind::InvalidInput);
        assert!(open(Path::new("/dev/zero")).is_err());
        assert!(open(folder.path()).is_err());
    }

    #[test]
    fn permissions_of_new_files_do_not_depend_on_the_umask() {
        let parent = tempfile::tempdir().expect("a folder");
        let mode = |path: &Path| fs::metadata(path).expect("exists").permissions().mode() & 0o777;
        for (n, mask) in [Mode::empty(), Mode::S_IRWXG | Mode::S_IRWXO]
            .into_iter()
            .enumerate()
        {
            let [file, folder] =
                ["file", "folder"].map(|name| parent.path().join(format!("{name}-{n}")));
            let before = umask(mask);
            let created = create_new(&file).and_then(|_| create_folder(&folder));
            umask(before);
            created.expect("created");
            assert_eq!((mode(&file), mode(&folder)), (MODE, FOLDER_MODE));
            for again in [create_new(&file).map(drop), create_folder(&folder)] {
                let error = again.expect_err("it exists");
                assert_eq!(error.kind(), io::ErrorKind::AlreadyExists);
            }
        }
    }

    #[test]
    fn enforces_the_size_limit() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("text");
        fs::write(&path, "1234").expect("written");
        assert_eq!(read_to_string(&path, 4).expect("text"), "1234");
        assert!(read_to_string(&path, 3).is_err());
    }
}
