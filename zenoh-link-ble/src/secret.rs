//! Owns the secret that the nodes of a team share, and how one node proves to another that it knows it without telling it:
//! a keyed hash over what both have just said, with a number of chance from each. The order of messages: `opening`; their
//! layout: `PROTOCOL.md`, section 3.
use std::{fmt, fs, io, io::Read, path::Path};

use hmac::{Hmac, Mac};
use sha3::Sha3_256;

use crate::hello::NodeId;

/// A number of chance, in bytes: no two of a node's life are the same.
pub const NONCE_BYTES: usize = 16;
/// The part of the keyed hash that is sent, in bytes.
pub const PROOF_BYTES: usize = 16;
/// The shortest secret, in bytes: who hears a proof can try out secrets at home, so it is one that nobody can guess.
pub const MIN_SECRET: usize = 16;
/// The longest file read for one, in bytes.
const MAX_FILE: u64 = 65_536;

/// A number of chance.
pub type Nonce = [u8; NONCE_BYTES];
/// The beginning of a keyed hash.
pub type Proof = [u8; PROOF_BYTES];

/// Why a file gives no secret.
#[derive(Debug, thiserror::Error)]
pub enum SecretError {
    /// It can't be read.
    #[error("the secret= file {path} can't be read")]
    Unreadable {
        /// The file.
        path: String,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// It is no file, or far too large.
    #[error("{path} is no file with a secret: its first line is the secret, and it has at most {MAX_FILE} bytes")]
    NoSecretFile {
        /// The file.
        path: String,
    },
    /// Its first line is too short.
    #[error("the secret in {path} (its first line) has {length} bytes; it needs {MIN_SECRET} that nobody can guess: `openssl rand -base64 18` makes some")]
    TooShort {
        /// The file.
        path: String,
        /// How long it is.
        length: usize,
    },
    /// The system gives no random numbers.
    #[error("no random numbers: {0}")]
    NoChance(String),
}

/// Which side proves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The one that opened the channel.
    Dialler,
    /// The other.
    Listener,
}

/// What both sides have said when they prove.
#[derive(Clone, Copy, Debug)]
pub struct Said<'a> {
    /// The dialler's HELLO as it was sent, with its nonce.
    pub hello: &'a [u8],
    /// Who answers.
    pub listener: NodeId,
    /// The listener's nonce.
    pub nonce: &'a Nonce,
}

/// A secret that is shared by a team, as the key of a hash.
#[derive(Clone)]
pub struct Secret(Hmac<Sha3_256>);

impl fmt::Debug for Secret {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Secret(..)")
    }
}

impl Secret {
    /// The first line of the file that is not blank: the file of logins of a router will do.
    pub fn read(path: &Path) -> Result<Self, SecretError> {
        let shown = || path.display().to_string();
        let unreadable = |source| SecretError::Unreadable {
            path: shown(),
            source,
        };
        // A pipe would be waited for, and a device may never end.
        if !fs::metadata(path).map_err(unreadable)?.is_file() {
            return Err(SecretError::NoSecretFile { path: shown() });
        }
        let file = fs::File::open(path).map_err(unreadable)?;
        let mut text = Vec::new();
        (file.take(MAX_FILE + 1).read_to_end(&mut text)).map_err(unreadable)?;
        if text.len() as u64 > MAX_FILE {
            return Err(SecretError::NoSecretFile { path: shown() });
        }
        let mut lines = text.split(|byte| *byte == b'\n').map(<[u8]>::trim_ascii);
        let line = lines.find(|line| !line.is_empty()).unwrap_or_default();
        Self::new(line).ok_or_else(|| SecretError::TooShort {
            path: shown(),
            length: line.len(),
        })
    }

    /// `None` if it is shorter than [`MIN_SECRET`].
    pub fn new(secret: &[u8]) -> Option<Self> {
        let key = Some(secret).filter(|secret| secret.len() >= MIN_SECRET)?;
        Hmac::new_from_slice(key).ok().map(Self)
    }

    /// What `side` proves with.
    pub fn proof(&self, side: Side, said: Said<'_>) -> Proof {
        let hash = self.hash(side, said).finalize().into_bytes();
        std::array::from_fn(|at| hash[at])
    }

    /// Whether `proof` is that of `side`; takes as long for any wrong one.
    pub fn is_proved(&self, side: Side, said: Said<'_>, proof: &Proof) -> bool {
        self.hash(side, said).verify_truncated_left(proof).is_ok()
    }

    /// What both sides type in when Bluetooth pairs them with `sec=high`: six digits.
    pub fn passkey(&self) -> u32 {
        let hash = (self.0.clone().chain_update(b"passkey").finalize()).into_bytes();
        u32::from_le_bytes(std::array::from_fn(|at| hash[at])) % 1_000_000
    }

    fn hash(&self, side: Side, said: Said<'_>) -> Hmac<Sha3_256> {
        let side = match side {
            Side::Dialler => b'D',
            Side::Listener => b'L',
        };
        // The hello is the only part of more than one length.
        (self.0.clone())
            .chain_update([side])
            .chain_update(said.listener.0.to_le_bytes())
            .chain_update(said.nonce)
            .chain_update(said.hello)
    }
}

/// A new number of chance.
pub fn nonce() -> Result<Nonce, SecretError> {
    let mut nonce = [0; NONCE_BYTES];
    getrandom::fill(&mut nonce).map_err(|error| SecretError::NoChance(error.to_string()))?;
    Ok(nonce)
}

#[cfg(test)]
mod tests {
    use super::*;

    const HELLO: &[u8] = b"RECT and so on";
    const SAID: Said<'static> = Said {
        hello: HELLO,
        listener: NodeId(7),
        nonce: &[3; NONCE_BYTES],
    };

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
    fn a_proof_is_good_for_one_side_one_conversation_and_one_secret() {
        let own = secret("a secret of 16 bytes");
        let proof = own.proof(Side::Dialler, SAID);
        assert!(own.is_proved(Side::Dialler, SAID, &proof));
        assert!(!own.is_proved(Side::Listener, SAID, &proof), "sent back");
        for other in [
            Said {
                hello: b"RECT and so om",
                ..SAID
            },
            Said {
                listener: NodeId(8),
                ..SAID
            },
            Said {
                nonce: &[4; NONCE_BYTES],
                ..SAID
            },
        ] {
            assert!(!own.is_proved(Side::Dialler, other, &proof), "{other:?}");
        }
        let wrong = secret("a secret of 17 bytes");
        assert!(!wrong.is_proved(Side::Dialler, SAID, &proof));
        for bit in 0..PROOF_BYTES * 8 {
            let mut damaged = proof;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(!own.is_proved(Side::Dialler, SAID, &damaged), "bit {bit}");
        }
    }

    #[test]
    fn it_is_the_first_line_that_is_not_blank() {
        let wanted = secret("fleet:0123456789abcdef");
        for text in [
            "fleet:0123456789abcdef",
            "\n\r\n  fleet:0123456789abcdef \r\nwombat-2:other\n",
        ] {
            let read = read(text.as_bytes()).expect("has one");
            assert_eq!(read.passkey(), wanted.passkey());
        }
        // Bytes of any kind are a secret.
        assert!(read(&[0xff; MIN_SECRET]).is_ok());
    }

    #[test]
    fn files_without_a_secret_say_what_is_wrong() {
        let fifteen = read(b"fifteen bytes..").expect_err("too short").to_string();
        assert!(fifteen.contains("has 15 bytes; it needs 16"), "{fifteen}");
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
    fn it_is_not_printed_and_its_passkey_has_six_digits() {
        let secret = secret("a secret of 16 bytes");
        assert_eq!(format!("{secret:?}"), "Secret(..)");
        assert!(secret.passkey() < 1_000_000);
    }
}
