//! Summarises a recording: its topics, and how many messages and bytes each of them has.
use std::{collections::BTreeMap, sync::Arc, time::Duration};

use serde::Serialize;

use crate::{
    entry::Entry,
    file::About,
    log,
    reader::{ReadError, Reader},
};

/// The content of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// The description of the recording.
    pub about: About,
    /// Whether all its files are complete.
    pub is_complete: bool,
    /// When the first message was recorded, in seconds since 1970.
    pub started_s: f64,
    /// The time from the first to the last message, in seconds.
    pub duration_s: f64,
    /// The number of messages.
    pub messages: u64,
    /// The bytes of their payloads.
    pub bytes: u64,
    /// The number of reports of robots about events and links, which are not among the messages and topics.
    pub reports: u64,
    /// The number of lines that programs have logged, which are not among them either.
    pub log_lines: u64,
    /// The topics, as `<robot>/<topic>`.
    pub topics: BTreeMap<String, TopicSummary>,
}

/// The messages of one topic in a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TopicSummary {
    /// The encoding of the last message.
    pub encoding: String,
    /// The number of messages.
    pub messages: u64,
    /// The bytes of their payloads.
    pub bytes: u64,
    /// The number of messages that are missing between the first and the last one of each publisher, by their numbers.
    pub missed: u64,
    /// The last number of each publisher, or of each channel of a recording by another program.
    #[serde(skip)]
    last: BTreeMap<(Option<u16>, Option<usize>), u32>,
}

impl Summary {
    /// Reads a whole recording.
    ///
    /// # Errors
    /// Returns the first error of the reader; the summary has what was read before.
    pub fn read(mut reader: Reader) -> (Self, Option<ReadError>) {
        let mut summary = Self::default();
        let mut range: Option<(Duration, Duration)> = None;
        let mut error = None;
        for entry in reader.by_ref() {
            match entry {
                Ok(entry) => {
                    let (first, last) = range.get_or_insert((entry.logged, entry.logged));
                    (*first, *last) = ((*first).min(entry.logged), (*last).max(entry.logged));
                    summary.on_entry(&entry);
                }
                Err(failed) => {
                    error = Some(failed);
                    break;
                }
            }
        }
        summary.about = reader.about().clone();
        summary.is_complete = reader.is_complete();
        if let Some((first, last)) = range {
            summary.started_s = first.as_secs_f64();
            summary.duration_s = (last - first).as_secs_f64();
        }
        (summary, error)
    }

    fn on_entry(&mut self, entry: &Entry) {
        if log::is_log(&entry.topic) {
            self.log_lines += 1;
            return;
        }
        if entry.is_report() {
            self.reports += 1;
            return;
        }
        let bytes = entry.payload.bytes.len() as u64;
        self.messages += 1;
        self.bytes += bytes;
        let topic = self.topics.entry(entry.topic.clone()).or_default();
        topic.messages += 1;
        topic.bytes += bytes;
        if topic.encoding != entry.payload.encoding.as_str() {
            topic.encoding = entry.payload.encoding.as_str().to_owned();
        }
        // A reader has one description of each channel.
        let channel = entry
            .foreign
            .as_ref()
            .map(|foreign| Arc::as_ptr(foreign).addr());
        let last = topic
            .last
            .insert((entry.publisher, channel), entry.sequence);
        // Two recordings that were merged may have the same messages.
        let after = last.and_then(|last| entry.sequence.checked_sub(last));
        topic.missed += u64::from(after.unwrap_or(1).saturating_sub(1));
    }
}
