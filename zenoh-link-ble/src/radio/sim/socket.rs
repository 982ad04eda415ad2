//! Owns where the air's socket is, and the file itself while a server has it.
use std::{
    env, fs, io,
    os::unix::{
        fs::{FileTypeExt, MetadataExt, PermissionsExt},
        net::{UnixListener, UnixStream},
    },
    path::{Path, PathBuf},
};

/// The environment variable that names the socket.
pub const SOCKET_VARIABLE: &str = "RECT_AIR";

/// Where the air's socket is: `$RECT_AIR`, else `$XDG_RUNTIME_DIR/rect-air.sock`, else `/tmp/rect-air-<uid>.sock`.
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

/// Why a server cannot have its socket.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// Another server has it.
    #[error("an air is running at {} already: use it, or stop it, or give another --socket", .0.display())]
    InUse(PathBuf),
    /// Something else is there, which is not ours to delete.
    #[error("{} is there and is no socket: give another --socket", .0.display())]
    NotASocket(PathBuf),
    /// The system says no.
    #[error("cannot make the socket {}: {source}", path.display())]
    Io {
        /// Where.
        path: PathBuf,
        /// What the system says.
        source: io::Error,
    },
}

/// A listening socket whose file is removed with it.
pub(super) struct SocketFile {
    path: PathBuf,
    identity: (u64, u64),
}

impl SocketFile {
    /// Makes the socket, for this user only. A file left by a server that died is replaced.
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
        // Made under another name, so that nobody can connect before its mode is right; the last step replaces a
        // stale file too.
        let mut made = path.as_os_str().to_owned();
        made.push(format!(".{}", std::process::id()));
        let made = PathBuf::from(made);
        let _ = fs::remove_file(&made);
        let listener = UnixListener::bind(&made).map_err(failed)?;
        let identity = fs::set_permissions(&made, fs::Permissions::from_mode(0o600))
            .and_then(|()| fs::rename(&made, path))
            .and_then(|()| identity(path))
            .and_then(|identity| listener.set_nonblocking(true).map(|()| identity))
            .inspect_err(|_| drop(fs::remove_file(&made)))
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
        // Another server may have its own there by now.
        if identity(&self.path).is_ok_and(|there| there == self.identity) {
            let _ = fs::remove_file(&self.path);
        }
    }
}

fn identity(path: &Path) -> io::Result<(u64, u64)> {
    fs::symlink_metadata(path).map(|file| (file.dev(), file.ino()))
}

fn user() -> u32 {
    // SAFETY: it takes no arguments, touches no memory and cannot fail.
    unsafe { libc::geteuid() }
}
