//! Reads records: the channels of a file, and the messages that refer to them.
use std::{collections::HashMap, sync::Arc, time::Duration};

use bytes::Bytes;
use mcap::{
    records::{op, Record},
    McapError,
};
use rect_core::message::payload::Payload;

use crate::{
    channel::{Channel, Form},
    entry::Entry,
    picture,
    schema::{Foreign, Schema},
    view,
};

/// The channels of a file.
#[derive(Default)]
pub(super) struct Contents {
    schemas: HashMap<u16, Arc<Schema>>,
    channels: HashMap<u16, Described>,
}

#[derive(PartialEq)]
struct Described {
    channel: Channel,
    foreign: Option<Arc<Foreign>>,
}

impl Contents {
    /// Handles a record of a schema or a channel. Others are ignored.
    pub(super) fn on_record(&mut self, kind: u8, data: &[u8]) -> Result<(), McapError> {
        if !matches!(kind, op::SCHEMA | op::CHANNEL) {
            return Ok(());
        }
        match parsed(kind, data)? {
            Record::Schema { header, data } => {
                let schema = Schema {
                    name: header.name,
                    encoding: header.encoding.into(),
                    text: data.into_owned(),
                };
                if self.schemas.get(&header.id).map(|known| &**known) != Some(&schema) {
                    self.schemas.insert(header.id, Arc::new(schema));
                }
            }
            Record::Channel(record) => {
                let id = record.id;
                let schema = self.schemas.get(&record.schema_id).cloned();
                let (channel, foreign) = Channel::read(record, schema);
                let foreign = foreign.map(Arc::new);
                let described = Described { channel, foreign };
                // The same channel is described in several places of a file.
                if self.channels.get(&id) != Some(&described) {
                    self.channels.insert(id, described);
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// Returns the entry of a message. `original` is the payload behind it, if there is one.
    pub(super) fn entry(&self, data: &[u8], original: Option<&[u8]>) -> Result<Entry, McapError> {
        let Record::Message { header, data } = parsed(op::MESSAGE, data)? else {
            return Err(McapError::UnexpectedEoc);
        };
        let described = self.channels.get(&header.channel_id);
        let unknown = || McapError::UnknownChannel(header.sequence, header.channel_id);
        let Described { channel, foreign } = described.ok_or_else(unknown)?;
        let plain =
            |bytes: &[u8]| Payload::new(Bytes::copy_from_slice(bytes), channel.encoding.clone());
        let payload = match (channel.form, original) {
            (Form::View, Some(original)) => plain(original),
            (Form::View, None) => view::restored(&channel.encoding, &data),
            (Form::Picture(kind), _) => match picture::unwrap(kind, &data) {
                Some(picture) => Payload::new(picture, channel.encoding.clone()),
                None => plain(&data),
            },
            (Form::Payload | Form::Object, _) => plain(&data),
        };
        Ok(Entry {
            topic: channel.topic.clone(),
            recipient: channel.recipient.clone(),
            payload,
            urgency: channel.urgency,
            sequence: header.sequence,
            publisher: channel.publisher,
            logged: Duration::from_nanos(header.log_time),
            sent: Duration::from_nanos(header.publish_time),
            retained: channel.retained,
            foreign: foreign.clone(),
        })
    }
}

/// Returns the time of recording in a message, in nanoseconds.
pub(super) fn log_time(message: &[u8]) -> Result<u64, McapError> {
    // After the numbers of the channel and the message.
    let time = message.get(6..).and_then(|rest| rest.first_chunk());
    time.map(|time| u64::from_le_bytes(*time))
        .ok_or(McapError::UnexpectedEoc)
}

/// Parses a record. The library's parser believes the lengths of strings, and reserves memory for them.
pub(super) fn parsed(kind: u8, data: &[u8]) -> Result<Record<'_>, McapError> {
    if !strings_fit(kind, data) {
        return Err(McapError::UnexpectedEoc);
    }
    mcap::parse_record(kind, data)
}

/// Returns whether the strings of a record are no longer than the record, since a parser would reserve memory for them.
fn strings_fit(opcode: u8, data: &[u8]) -> bool {
    let two_strings = |at: usize| {
        let rest = data.get(at..).and_then(without_string);
        rest.and_then(without_string)
    };
    let rest = match opcode {
        // The numbers of the channel and its schema, the topic, and the encoding.
        op::CHANNEL => two_strings(4),
        op::METADATA => without_string(data),
        // The times, the size and the checksum, and the compression; then the records.
        op::CHUNK => return data.get(28..).and_then(without_string).is_some(),
        op::HEADER => return two_strings(0).is_some(),
        // The number, the name and the encoding; then the definition, after its length.
        op::SCHEMA => return two_strings(2).is_some_and(|rest| rest.len() >= 4),
        _ => return true,
    };
    // Pairs of a name and a value, after their length in bytes. The parser looks for a missing value behind them.
    let rest = rest.and_then(|rest| rest.split_first_chunk());
    let map = rest.and_then(|(length, rest)| rest.get(..u32::from_le_bytes(*length) as usize));
    let Some(mut rest) = map else { return false };
    while !rest.is_empty() {
        match without_string(rest).and_then(without_string) {
            Some(after) => rest = after,
            None => return false,
        }
    }
    true
}

/// Returns the bytes after a string and its length.
fn without_string(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = bytes.split_first_chunk()?;
    rest.get(u32::from_le_bytes(*length) as usize..)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a metadata record without a name, whose map has that length, followed by these bytes.
    fn metadata(length: u32, rest: &[u8]) -> Vec<u8> {
        [[0; 4].as_slice(), &length.to_le_bytes(), rest].concat()
    }

    #[test]
    fn a_name_without_a_value_is_refused() {
        // Behind the map is what the parser would take for the length of a string.
        let record = metadata(4, &[[0; 4], [0xaa; 4]].concat());
        assert!(matches!(
            parsed(op::METADATA, &record),
            Err(McapError::UnexpectedEoc)
        ));
        let pair = metadata(8, &[0; 8]);
        assert!(matches!(
            parsed(op::METADATA, &pair),
            Ok(Record::Metadata(_))
        ));
    }

    #[test]
    fn long_strings_of_schemas_and_headers_are_refused() {
        let long = [0xff; 4];
        for (kind, record) in [
            (op::HEADER, [&[0; 4][..], &long].concat()),
            (op::SCHEMA, [&[1, 0, 0, 0, 0, 0][..], &long].concat()),
            (op::SCHEMA, vec![1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]),
        ] {
            let refused = parsed(kind, &record);
            assert!(matches!(refused, Err(McapError::UnexpectedEoc)));
        }
    }
}
