//! Reads the value of a message from the command line, a file or the standard input.
use std::{
    fs,
    io::{self, Read},
    path::{Path, PathBuf},
};

use clap::Args;
use rect::{Encoding, Payload};
use rect_core::message::payload;

use crate::Failure;

/// Largest size of a message that is read from a file or from the standard input, in bytes; larger files require a
/// transfer.
const MAX_BYTES: u64 = 16 << 20;

/// The value of a message.
#[derive(Args, Clone, Debug)]
pub struct PayloadArguments {
    /// The value, sent as JSON if it is valid JSON, otherwise as text; `-` reads stdin [default: an empty text]
    #[arg(allow_negative_numbers = true)]
    value: Option<String>,
    /// Send this file instead; its extension determines the encoding: .json, .txt, .png, .jpg, .webp, .cbor, else bytes
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
            Some("-") => read_stdin(io::stdin())?,
            value => value.unwrap_or_default().to_owned(),
        };
        Ok(match self.text {
            true => Payload::new(value, Encoding::TEXT),
            false => payload::typed(value),
        })
    }
}

/// Reads the text of the standard input.
fn read_stdin(stdin: impl Read) -> Result<String, Failure> {
    let mut bytes = Vec::new();
    // One byte more than the limit shows that the input is too large.
    let read = stdin.take(MAX_BYTES + 1).read_to_end(&mut bytes);
    read.map_err(|error| format!("stdin: {error}"))?;
    if bytes.len() as u64 > MAX_BYTES {
        return Err(format!(
            "stdin: more than {MAX_BYTES} bytes, the limit for a message; save them to a file and send it with \
             `rect transfer send`"
        )
        .into());
    }
    let text = String::from_utf8(bytes);
    Ok(text
        .map_err(|_| "stdin: not a text in UTF-8; save it to a file and send it with `--file`")?)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stdin_over_the_limit_is_rejected() {
        let largest = read_stdin(io::repeat(b'a').take(MAX_BYTES)).expect("within the limit");
        assert_eq!(largest.len() as u64, MAX_BYTES);
        // The limit is in the middle of a character.
        for too_large in ["a", "€"] {
            let input = too_large.repeat(MAX_BYTES as usize / too_large.len() + 1);
            let error = read_stdin(input.as_bytes()).expect_err("too large");
            assert!(error.to_string().contains("rect transfer send"), "{error}");
        }
        let error = read_stdin(&b"\xff"[..]).expect_err("no text");
        assert!(error.to_string().contains("--file"), "{error}");
    }
}
