//! Implements `rect dictionary`, which trains a dictionary from sample messages.
use std::{
    fs,
    io::{self, BufRead, BufReader},
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{Args, Subcommand};
use indicatif::ProgressBar;
use rect::{Encoding, Payload};
use rect_core::codec::{dictionary::Dictionary, dictionary_codec::DictionaryCodec, Codec as _};

use crate::{Done, Failure};

/// Largest size of a sample, in bytes; larger lines and files are skipped, since dictionaries are for small messages.
const MAX_SAMPLE_BYTES: usize = 64 << 10;
/// Interval of the samples that are not used for training, but to measure how well other messages are compressed.
const TEST_INTERVAL: usize = 5;

/// Train dictionaries, which make small messages much smaller
#[derive(Args)]
pub struct DictionaryArguments {
    #[command(subcommand)]
    command: DictionaryCommand,
}

#[derive(Subcommand)]
enum DictionaryCommand {
    /// Train a dictionary from typical messages
    Train {
        /// Recordings (.jsonl, one message or one line of `rect sub --json` per line), or files with one message each
        #[arg(required = true)]
        samples: Vec<PathBuf>,
        /// The file to write the dictionary to
        #[arg(long, short)]
        output: PathBuf,
        /// The largest size of the dictionary, in bytes
        #[arg(long, default_value_t = 8192)]
        size: usize,
    },
}

/// Runs `rect dictionary`.
pub fn run(arguments: DictionaryArguments) -> Done {
    let DictionaryCommand::Train {
        samples,
        output,
        size,
    } = arguments.command;
    let all = read_all(&samples)?;
    let is_test = |n: usize| n % TEST_INTERVAL == TEST_INTERVAL - 1;
    let (mut training, mut test) = (Vec::new(), Vec::new());
    for (n, sample) in all.into_iter().enumerate() {
        if is_test(n) { &mut test } else { &mut training }.push(sample);
    }
    let spinner = ProgressBar::new_spinner()
        .with_message(format!("training with {} messages", training.len()));
    spinner.enable_steady_tick(std::time::Duration::from_millis(100));
    let dictionary = Dictionary::train(&training, size)?;
    spinner.finish_and_clear();
    dictionary.write(&output)?;
    let (id, bytes) = (dictionary.id(), dictionary.as_bytes().len());
    rect_terminal::outln!(
        "{}: dictionary {id}, {bytes} bytes, trained with {} messages",
        output.display(),
        training.len()
    );
    let codec = DictionaryCodec::new(dictionary.into());
    let (mut before, mut after) = (0, 0);
    for sample in test.iter() {
        let compressed = codec.encode(&Payload::new(sample.clone(), Encoding::JSON))?;
        before += sample.len();
        after += compressed.bytes.len();
    }
    if before > 0 {
        let (count, share) = (test.len(), after as f64 / before as f64);
        rect_terminal::outln!(
            "{count} other messages for comparison: {before} bytes are compressed to {after} ({share:.2})"
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

/// Returns the sample in a line of a recording: the value of a message printed by `rect sub --json`, or the whole line.
fn sample(line: &str) -> Option<Vec<u8>> {
    if line.trim().is_empty() || line.len() > MAX_SAMPLE_BYTES {
        return None;
    }
    let parsed = serde_json::from_str::<serde_json::Value>(line);
    let value = parsed.ok().and_then(|mut message| {
        let is_recorded = message.get("topic").is_some() && message.get("encoding").is_some();
        is_recorded.then(|| message["value"].take())
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
    fn recordings_contain_subscribed_or_plain_messages() {
        let recorded = r#"{"topic":"a","encoding":"application/json","value":{"x":1}}"#;
        assert_eq!(sample(recorded), Some(br#"{"x":1}"#.to_vec()));
        assert_eq!(sample(r#"{"x":2}"#), Some(br#"{"x":2}"#.to_vec()));
        assert_eq!(sample("  "), None);
    }
}
