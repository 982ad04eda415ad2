//! Reads the secret of a team from the file that `secret=` names.
use std::{fs, io, io::Read, path::Path};

use link_lanes::secret::{Secret, MIN_SECRET};

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
    #[error("the secret in the first line of {path} has {length} bytes{}, but needs at least {MIN_SECRET} that are hard to guess: `openssl rand -base64 18` generates some", if *.has_user { " after the user's name" } else { "" })]
    TooShort {
        /// Path of the file.
        path: String,
        /// Size of the secret, in bytes, without the name of the user.
        length: usize,
        /// Whether the line is that of a login, `user:password`.
        has_user: bool,
    },
}

/// Reads the secret from the first line of a file that is not blank. A router's file of logins can serve as the secret: the whole line
/// is the secret, but the name of the user in it does not make it harder to guess.
///
/// # Errors
/// Fails if the path is not that of a readable regular file, if the file is too large, or if the secret is shorter than
/// [`MIN_SECRET`], without the name of the user.
pub fn read(path: &Path) -> Result<Secret, SecretError> {
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
    of_text(path, &text)
}

/// Returns the secret of the text of the file at `path`.
///
/// # Errors
/// [`SecretError::TooShort`].
pub fn of_text(path: &Path, text: &[u8]) -> Result<Secret, SecretError> {
    let mut lines = text.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
    let line = lines.find(|line| !line.is_empty()).unwrap_or_default();
    let password = line.iter().position(|byte| *byte == b':');
    let hard_to_guess = password.map_or(line, |colon| &line[colon + 1..]);
    let secret = Secret::new(line).filter(|_| hard_to_guess.len() >= MIN_SECRET);
    secret.ok_or_else(|| SecretError::TooShort {
        path: path.display().to_string(),
        length: hard_to_guess.len(),
        has_user: password.is_some(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn secret(text: &str) -> Secret {
        Secret::new(text.as_bytes()).expect("long enough")
    }

    fn read_text(text: &[u8]) -> Result<Secret, SecretError> {
        let folder = tempfile::tempdir().expect("makes a folder");
        let path = folder.path().join("users");
        fs::write(&path, text).expect("writes");
        read(&path)
    }

    #[test]
    fn secret_is_the_first_line_that_is_not_blank() {
        let expected = secret("fleet:0123456789abcdef");
        for text in [
            "fleet:0123456789abcdef",
            "\n\r\n  fleet:0123456789abcdef \r\nwombat-2:other\n",
        ] {
            let read = read_text(text.as_bytes()).expect("has one");
            assert_eq!(read.passkey(), expected.passkey());
        }
        // A secret may consist of any bytes.
        assert!(read_text(&[0xff; MIN_SECRET]).is_ok());
    }

    #[test]
    fn invalid_files_are_rejected_with_the_reason() {
        let fifteen = read_text(b"fifteen bytes..")
            .expect_err("too short")
            .to_string();
        assert!(
            fifteen.contains("has 15 bytes, but needs at least 16"),
            "{fifteen}"
        );
        // The name of the user is public.
        for login in ["fleet:1234", "a long name of a user:fifteen bytes.."] {
            let login = read_text(login.as_bytes()).expect_err("too short");
            assert!(
                login
                    .to_string()
                    .contains("bytes after the user's name, but needs"),
                "{login}"
            );
        }
        assert!(read_text(b"u:sixteen bytes...").is_ok());
        let empty = read_text(b"\n \n").expect_err("empty").to_string();
        assert!(empty.contains("has 0 bytes"), "{empty}");
        let large = read_text(&vec![b'x'; 70_000])
            .expect_err("too large")
            .to_string();
        assert!(large.contains("at most 65536"), "{large}");
        let folder = read(Path::new("/")).expect_err("a folder");
        assert!(matches!(folder, SecretError::NoSecretFile { .. }));
        let none = read(Path::new("/no/such/file")).expect_err("none");
        assert!(matches!(none, SecretError::Unreadable { .. }));
    }
}
