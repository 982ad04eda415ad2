//! Determines the path of the air's socket, and manages the socket file while a server uses it.
use std::{
    env, fs, io,
    os::unix::{
        fs::{FileTypeExt, MetadataExt, PermissionsExt},
        net::{UnixListener, UnixStream},
    },
    path::{Path, PathBuf},
};

/// Environment variable with the path of the socket.
pub const SOCKET_VARIABLE: &str = "RECT_AIR";

/// Returns the path of the air's socket: `$RECT_AIR`, else `$XDG_RUNTIME_DIR/rect-air.sock`, else
/// `/tmp/rect-air-<uid>.sock`.
pub fn socket_path() -> PathBuf {
    let set = |name| env::var_os(name).filter(|value| !value.is_empty());
    if let Some(path) = set(SOCKET_VARIABLE) {
        return path.into();
    }
    match set("XDG_RUNTIME_DIR") {
        Some(folder) => Path::new(&folder).join("rect-air.sock"),
        None => format!("/tmp/rect-air-{}.sock", user()).into(),
    }
}

/// Reasons why a server cannot create its socket.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// Another server uses the socket.
    #[error("an air is already running at {}: use it, stop it, or pass another --socket", .0.display())]
    InUse(PathBuf),
    /// The path exists and is not a socket, so it is not deleted.
    #[error("{} exists and is not a socket: pass another --socket", .0.display())]
    NotASocket(PathBuf),
    /// The operating system reported an error.
    #[error("cannot create the socket {}: {source}", path.display())]
    Io {
        /// Path of the socket.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
}

/// A listening socket. Its file is removed when it is dropped.
pub(super) struct SocketFile {
    path: PathBuf,
    /// Device and inode number of the file.
    identity: (u64, u64),
}

impl SocketFile {
    /// Creates the socket, accessible only by this user. Replaces a socket file that an ended server left behind.
    pub(super) fn bind(path: &Path) -> Result<(Self, UnixListener), SocketError> {
        let failed = |source| SocketError::Io {
            path: path.to_owned(),
            source,
        };
        match fs::symlink_metadata(path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {}
            Err(error) => return Err(failed(error)),
            Ok(found) if !found.file_type().is_socket() => {
                return Err(SocketError::NotASocket(path.to_owned()));
            }
            Ok(_) => match UnixStream::connect(path) {
                Ok(_) => return Err(SocketError::InUse(path.to_owned())),
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {}
                Err(error) => return Err(failed(error)),
            },
        }
        // Created under another name, so that nobody can connect before its mode is set. Renaming it also replaces a
        // stale file.
        let mut temporary = path.as_os_str().to_owned();
        temporary.push(format!(".{}", std::process::id()));
        let temporary = PathBuf::from(temporary);
        let _ = fs::remove_file(&temporary);
        let listener = UnixListener::bind(&temporary).map_err(failed)?;
        let identity = fs::set_permissions(&temporary, fs::Permissions::from_mode(0o600))
            .and_then(|()| fs::rename(&temporary, path))
            .and_then(|()| identity(path))
            .and_then(|identity| listener.set_nonblocking(true).map(|()| identity))
            .inspect_err(|_| drop(fs::remove_file(&temporary)))
            .map_err(failed)?;
        let file = Self {
            path: path.to_owned(),
            identity,
        };
        Ok((file, listener))
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for SocketFile {
    fn drop(&mut self) {
        // The file may belong to another server by now.
        if identity(&self.path).is_ok_and(|current| current == self.identity) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn identity(path: &Path) -> io::Result<(u64, u64)> {
    fs::symlink_metadata(path).map(|file| (file.dev(), file.ino()))
}

fn user() -> u32 {
    // SAFETY: `geteuid` takes no arguments, touches no memory and cannot fail.
    unsafe { libc::geteuid() }
}
