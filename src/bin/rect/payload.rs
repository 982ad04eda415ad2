//! Reads the value of a message from the command line, a file or the standard input.
use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
};

use clap::Args;
use rect::{Encoding, Payload};

use crate::Failure;

/// Largest size of a message that is read from a file, in bytes; larger files require a transfer.
const MAX_BYTES: u64 = 16 << 20;

/// The value of a message.
#[derive(Args, Clone, Debug)]
pub struct PayloadArguments {
    /// The value, sent as JSON if it is valid JSON, otherwise as text; `-` reads stdin [default: an empty text]
    value: Option<String>,
    /// Send this file instead; its name determines the encoding: .json, .txt, .png, .jpg, .webp, .cbor, otherwise bytes
    #[arg(long, value_name = "FILE", conflicts_with = "value")]
    file: Option<PathBuf>,
    /// Send the value as text even if it is valid JSON
    #[arg(long)]
    text: bool,
}

impl PayloadArguments {
    /// Reads the value; without arguments it is an empty text.
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
            "{}: {bytes} bytes exceed the limit of {MAX_BYTES} for a message; send it with `rect transfer send`",
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
