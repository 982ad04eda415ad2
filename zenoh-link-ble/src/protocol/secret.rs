//! Handles the secret that the nodes of a team share, and derives from it what the handshake requires.
//!
//! `key_agreement` uses it. Section 3 of `PROTOCOL.md` specifies both.
use std::{fmt, fs, io, io::Read, path::Path};

use hmac::{Hmac, Mac};
use sha3::Sha3_256;

/// The shortest secret, in bytes. A peer that has dialled a robot once can try out secrets offline, so the secret has to be hard
/// to guess.
pub const MIN_SECRET: usize = 16;
/// The largest accepted `secret=` file, in bytes.
const MAX_FILE: u64 = 65_536;

/// Why no secret could be obtained.
#[derive(Debug, thiserror::Error)]
pub enum SecretError {
    /// The file cannot be read. Check that it exists and that the router's user may read it.
    #[error("cannot read the secret= file {path}")]
    Unreadable {
        /// Path of the file.
        path: String,
        /// The error of the operating system.
        #[source]
        source: io::Error,
    },
    /// The path is not that of a regular file, or the file is too large.
    #[error("{path} is not a secret= file: it must be a regular file with the secret in its first line and at most {MAX_FILE} bytes")]
    NoSecretFile {
        /// Path of the file.
        path: String,
    },
    /// The secret is too short. Generate a longer one.
    #[error("the secret in the first line of {path} has {length} bytes, but needs at least {MIN_SECRET} that are hard to guess: `openssl rand -base64 18` generates some")]
    TooShort {
        /// Path of the file.
        path: String,
        /// Size of the secret, in bytes.
        length: usize,
    },
}

/// A secret that a team shares. It is kept as the key of a hash and never printed.
#[derive(Clone)]
pub struct Secret(Hmac<Sha3_256>);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl Secret {
    /// Reads the secret from the first line of a file that is not blank. A router's file of logins can serve as the secret.
    ///
    /// # Errors
    /// Fails if the path is not that of a readable regular file, if the file is too large, or if the secret is shorter than
    /// [`MIN_SECRET`].
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let path_text = || path.display().to_string();
        let unreadable = |source| SecretError::Unreadable {
            path: path_text(),
            source,
        };
        // Reading a pipe could block, and a device may be endless.
        if !fs::metadata(path).map_err(unreadable)?.is_file() {
            return Err(SecretError::NoSecretFile { path: path_text() });
        }
        let file = fs::File::open(path).map_err(unreadable)?;
        let mut text = Vec::new();
        (file.take(MAX_FILE + 1).read_to_end(&mut text)).map_err(unreadable)?;
        if text.len() as u64 > MAX_FILE {
            return Err(SecretError::NoSecretFile { path: path_text() });
        }
        let mut lines = text.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
        let line = lines.find(|line| !line.is_empty()).unwrap_or_default();
        Self::new(line).ok_or_else(|| SecretError::TooShort {
            path: path_text(),
            length: line.len(),
        })
    }

    /// Creates a secret from bytes. Returns `None` if there are fewer than [`MIN_SECRET`].
    pub fn new(secret: &[u8]) -> Option<Self> {
        let key = Some(secret).filter(|secret| secret.len() >= MIN_SECRET)?;
        Hmac::new_from_slice(key).ok().map(Self)
    }

    /// Derives the key that the handshake of two nodes with this secret requires.
    pub fn pre_shared_key(&self) -> [u8; 32] {
        let hash = self.0.clone().chain_update(b"RECT link 2 psk");
        hash.finalize().into_bytes().into()
    }

    /// Derives the passkey of six digits with which Bluetooth pairs the two sides if `sec=high`.
    pub fn passkey(&self) -> u32 {
        let hash = (self.0.clone().chain_update(b"passkey").finalize()).into_bytes();
        u32::from_le_bytes(std::array::from_fn(|at| hash[at])) % 1_000_000
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn secret(text: &str) -> Secret {
        Secret::new(text.as_bytes()).expect("long enough")
    }

    fn read(text: &[u8]) -> Result<Secret, SecretError> {
        let folder = tempfile::tempdir().expect("makes a folder");
        let path = folder.path().join("users");
        fs::write(&path, text).expect("writes");
        Secret::read(&path)
    }

    #[test]
    fn secret_is_the_first_line_that_is_not_blank() {
        let expected = secret("fleet:0123456789abcdef");
        for text in [
            "fleet:0123456789abcdef",
            "\n\r\n  fleet:0123456789abcdef \r\nwombat-2:other\n",
        ] {
            let read = read(text.as_bytes()).expect("has one");
            assert_eq!(read.passkey(), expected.passkey());
        }
        // A secret may consist of any bytes.
        assert!(read(&[0xff; MIN_SECRET]).is_ok());
    }

    #[test]
    fn invalid_files_are_rejected_with_the_reason() {
        let fifteen = read(b"fifteen bytes..").expect_err("too short").to_string();
        assert!(
            fifteen.contains("has 15 bytes, but needs at least 16"),
            "{fifteen}"
        );
        let empty = read(b"\n \n").expect_err("empty").to_string();
        assert!(empty.contains("has 0 bytes"), "{empty}");
        let large = read(&vec![b'x'; 70_000])
            .expect_err("too large")
            .to_string();
        assert!(large.contains("at most 65536"), "{large}");
        let folder = Secret::read(Path::new("/")).expect_err("a folder");
        assert!(matches!(folder, SecretError::NoSecretFile { .. }));
        let none = Secret::read(Path::new("/no/such/file")).expect_err("none");
        assert!(matches!(none, SecretError::Unreadable { .. }));
    }

    #[test]
    fn secret_is_not_printed_and_its_passkey_has_six_digits() {
        let secret = secret("a secret of 16 bytes");
        assert_eq!(format!("{secret:?}"), "Secret(..)");
        assert!(secret.passkey() < 1_000_000);
    }
}
