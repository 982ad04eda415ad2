//! Owns `rect dictionary`: making one of messages like those to come.
use std::{
    fs,
    io::{self, BufRead, BufReader},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use rect::core::{codec::dictionary::Packed, codec::Codec as _, dictionary::Dictionary};
use rect::{Encoding, Payload};

use crate::{Done, Failure};

/// The most that is read of one line or file, in bytes: dictionaries are for small messages.
const MAX_SAMPLE_BYTES: usize = 64 << 10;
/// Each so manieth sample is not trained on, to see what the dictionary does for messages it has not seen.
const KEPT_BACK: usize = 5;

/// Dictionaries, with which small messages get much smaller.
#[derive(Args)]
pub struct DictionaryArguments {
    #[command(subcommand)]
    command: DictionaryCommand,
}

#[derive(Subcommand)]
enum DictionaryCommand {
    /// Make one of messages like those to come: a recording (`rect sub ... --json`, or a message a line), or files
    Train {
        /// Recordings (.jsonl, a message a line), or files with a message each
        #[arg(required = true)]
        samples: Vec<PathBuf>,
        /// Where to
        #[arg(long, short)]
        output: PathBuf,
        /// How large, in bytes
        #[arg(long, default_value_t = 8192)]
        size: usize,
    },
}

/// `rect dictionary`.
pub fn run(arguments: DictionaryArguments) -> Done {
    let DictionaryCommand::Train {
        samples,
        output,
        size,
    } = arguments.command;
    let all = read_all(&samples)?;
    let kept_back = |n: usize| n % KEPT_BACK == KEPT_BACK - 1;
    let (mut learned, mut unseen) = (Vec::new(), Vec::new());
    for (n, sample) in all.into_iter().enumerate() {
        if kept_back(n) {
            &mut unseen
        } else {
            &mut learned
        }
        .push(sample);
    }
    let spinner = ProgressBar::new_spinner()
        .with_message(format!("learning from {} messages", learned.len()));
    spinner.enable_steady_tick(std::time::Duration::from_millis(100));
    let dictionary = Dictionary::train(&learned, size)?;
    spinner.finish_and_clear();
    dictionary.write(&output)?;
    let (id, bytes) = (dictionary.id(), dictionary.as_bytes().len());
    rect::outln!(
        "{}: dictionary {id}, {bytes} bytes, of {} messages",
        output.display(),
        learned.len()
    );
    let packing = Packed::new(dictionary.into());
    let (mut before, mut after) = (0, 0);
    for sample in unseen.iter() {
        let packed = packing.encode(&Payload::new(sample.clone(), Encoding::JSON))?;
        before += sample.len();
        after += packed.bytes.len();
    }
    if before > 0 {
        let (count, share) = (unseen.len(), after as f64 / before as f64);
        rect::outln!(
            "{count} messages that it has not seen: {before} bytes become {after} ({share:.2})"
        );
    }
    Ok(ExitCode::SUCCESS)
}

fn read_all(files: &[PathBuf]) -> Result<Vec<Vec<u8>>, Failure> {
    let progress = ProgressBar::new(files.len() as u64);
    let mut samples = Vec::new();
    for file in files {
        let named = |error: io::Error| format!("{}: {error}", file.display());
        if is_recording(file) {
            let reader = BufReader::new(fs::File::open(file).map_err(named)?);
            for line in reader.lines() {
                let line = line.map_err(named)?;
                samples.extend(sample(&line));
            }
        } else {
            let bytes = fs::read(file).map_err(named)?;
            if bytes.len() <= MAX_SAMPLE_BYTES {
                samples.push(bytes);
            }
        }
        progress.inc(1);
    }
    progress.finish_and_clear();
    Ok(samples)
}

fn is_recording(file: &Path) -> bool {
    file.extension()
        .is_some_and(|end| end == "jsonl" || end == "ndjson")
}

/// A line of a recording: what `rect sub --json` prints has the message's value in it.
fn sample(line: &str) -> Option<Vec<u8>> {
    if line.trim().is_empty() || line.len() > MAX_SAMPLE_BYTES {
        return None;
    }
    let parsed = serde_json::from_str::<serde_json::Value>(line);
    let value = parsed.ok().and_then(|mut message| {
        let heard = message.get("topic").is_some() && message.get("encoding").is_some();
        heard.then(|| message["value"].take())
    });
    Some(value.map_or_else(
        || line.as_bytes().to_vec(),
        |value| value.to_string().into_bytes(),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_may_be_what_was_heard_or_messages_themselves() {
        let heard = r#"{"topic":"a","encoding":"application/json","value":{"x":1}}"#;
        assert_eq!(sample(heard), Some(br#"{"x":1}"#.to_vec()));
        assert_eq!(sample(r#"{"x":2}"#), Some(br#"{"x":2}"#.to_vec()));
        assert_eq!(sample("  "), None);
    }
}
