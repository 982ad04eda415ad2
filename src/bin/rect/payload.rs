//! Owns what a user gives to be sent: from the command line, a file or the standard input.
use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
};

use clap::Args;
use rect::{Encoding, Payload};

use crate::Failure;

/// The largest file that goes as one message, in bytes; larger ones are for a transfer.
const MAX_BYTES: u64 = 16 << 20;

/// What to send.
#[derive(Args, Clone, Debug)]
pub struct PayloadArguments {
    /// The value: JSON if it is that, else text; `-` reads the standard input
    value: Option<String>,
    /// A file instead; what it is, its name says: .json, .txt, .png, .jpg, .webp, .cbor, else bytes
    #[arg(long, value_name = "FILE", conflicts_with = "value")]
    file: Option<PathBuf>,
    /// Text even if it could be JSON
    #[arg(long)]
    text: bool,
}

impl PayloadArguments {
    /// Reads it. Nothing given: an empty text.
    pub fn payload(&self) -> Result<Payload, Failure> {
        if let Some(file) = &self.file {
            return read(file);
        }
        let value = match self.value.as_deref() {
            Some("-") => {
                let mut all = String::new();
                io::stdin().take(MAX_BYTES).read_to_string(&mut all)?;
                all
            }
            value => value.unwrap_or_default().to_owned(),
        };
        let json = !self.text && serde_json::from_str::<serde::de::IgnoredAny>(&value).is_ok();
        let encoding = if json { Encoding::JSON } else { Encoding::TEXT };
        Ok(Payload::new(value, encoding))
    }
}

fn read(file: &Path) -> Result<Payload, Failure> {
    let named = |error: io::Error| format!("{}: {error}", file.display());
    let bytes = fs::metadata(file).map_err(named)?.len();
    if bytes > MAX_BYTES {
        return Err(format!(
            "{}: {bytes} bytes, and a message has at most {MAX_BYTES}",
            file.display()
        )
        .into());
    }
    let encoding = match file.extension().and_then(|end| end.to_str()) {
        Some("json") => Encoding::JSON,
        Some("txt" | "md" | "csv" | "log") => Encoding::TEXT,
        Some("png") => Encoding::PNG,
        Some("jpg" | "jpeg") => Encoding::JPEG,
        Some("webp") => Encoding::WEBP,
        Some("cbor") => Encoding::CBOR,
        _ => Encoding::BYTES,
    };
    Ok(Payload::new(fs::read(file).map_err(named)?, encoding))
}
