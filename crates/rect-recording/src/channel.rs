//! Translates between entries and the channels of MCAP: a channel has a topic, an encoding, an urgency, a recipient and a
//! publisher.
use std::collections::BTreeMap;

use rect_core::message::{encoding::Encoding, urgency::Urgency};

use crate::{
    entry::Entry,
    picture::{self, Kind},
};

/// The names of MCAP for the encodings that it knows, see <https://mcap.dev/spec/registry>.
const KNOWN: [(&str, Encoding); 2] = [("json", Encoding::JSON), ("cbor", Encoding::CBOR)];

const ENCODING: &str = "encoding";
const URGENCY: &str = "urgency";
const RECIPIENT: &str = "recipient";
const PUBLISHER: &str = "publisher";

/// The properties that the messages of one MCAP channel share.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Channel {
    /// The robot and the topic.
    pub topic: String,
    /// The encoding of the payloads.
    pub encoding: Encoding,
    /// The urgency.
    pub urgency: Urgency,
    /// The recipient, if the messages were sent to one robot.
    pub recipient: Option<String>,
    /// The number that identifies the publisher, if it uses RECT.
    pub publisher: Option<u16>,
}

impl Channel {
    /// Returns the channel of an entry.
    pub fn of(entry: &Entry) -> Self {
        Self {
            topic: entry.topic.clone(),
            encoding: entry.payload.encoding.clone(),
            urgency: entry.urgency,
            recipient: entry.recipient.clone(),
            publisher: entry.publisher,
        }
    }

    /// Returns MCAP's name of the encoding.
    pub fn message_encoding(&self) -> &str {
        if Kind::of(&self.encoding).is_some() {
            return picture::PROTOBUF;
        }
        let known = KNOWN
            .iter()
            .find(|(_, encoding)| encoding == &self.encoding);
        known.map_or(self.encoding.as_str(), |(name, _)| name)
    }

    /// Returns what MCAP stores beside topic and encoding.
    pub fn metadata(&self) -> BTreeMap<String, String> {
        let mut metadata = BTreeMap::from([
            (ENCODING.to_owned(), self.encoding.as_str().to_owned()),
            (URGENCY.to_owned(), urgency_name(self.urgency).to_owned()),
        ]);
        if let Some(recipient) = &self.recipient {
            metadata.insert(RECIPIENT.to_owned(), recipient.clone());
        }
        if let Some(publisher) = self.publisher {
            metadata.insert(PUBLISHER.to_owned(), publisher.to_string());
        }
        metadata
    }

    /// Returns the channel that a file describes. A file of another program has only topic and encoding.
    pub fn read(record: mcap::records::Channel) -> Self {
        let mut metadata = record.metadata;
        let encoding = metadata.remove(ENCODING).unwrap_or_else(|| {
            let known = KNOWN
                .iter()
                .find(|(name, _)| *name == record.message_encoding);
            known
                .map_or(Encoding::BYTES, |(_, encoding)| encoding.clone())
                .as_str()
                .to_owned()
        });
        Self {
            topic: record.topic,
            encoding: Encoding::new(encoding),
            urgency: metadata
                .get(URGENCY)
                .map_or(Urgency::Normal, |name| urgency(name)),
            recipient: metadata.remove(RECIPIENT),
            publisher: metadata
                .get(PUBLISHER)
                .and_then(|number| number.parse().ok()),
        }
    }
}

fn urgency_name(urgency: Urgency) -> &'static str {
    match urgency {
        Urgency::Bulk => "bulk",
        Urgency::Normal => "normal",
        Urgency::Urgent => "urgent",
    }
}

fn urgency(name: &str) -> Urgency {
    let all = [Urgency::Bulk, Urgency::Normal, Urgency::Urgent];
    let found = all
        .into_iter()
        .find(|urgency| urgency_name(*urgency) == name);
    found.unwrap_or_default()
}
