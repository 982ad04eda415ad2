//! Translates between entries and the channels of MCAP: a channel has a topic, an encoding, an urgency, a recipient, a publisher, a
//! form, and the kind of its entries if the topic is retained.
use std::{collections::BTreeMap, sync::Arc};

use rect_core::message::{encoding::Encoding, urgency::Urgency};

use crate::{
    entry::Entry,
    entry::RetainedKind,
    picture::{self, Kind},
    schema::{Foreign, Schema},
    view::JSON,
};

/// The names of MCAP for the encodings that it knows, see <https://mcap.dev/spec/registry>.
const KNOWN: [(&str, Encoding); 2] = [(JSON, Encoding::JSON), ("cbor", Encoding::CBOR)];

const ENCODING: &str = "encoding";
const URGENCY: &str = "urgency";
const RECIPIENT: &str = "recipient";
const PUBLISHER: &str = "publisher";
const FORM: &str = "form";
const RETAINED: &str = "retained";
/// The value of [`FORM`] for [`Form::View`].
const VIEW: &str = "view";

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
    /// The kind of the entries, if the topic is retained.
    pub retained: Option<RetainedKind>,
    /// The form of the messages.
    pub form: Form,
}

/// The form of the messages of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Form {
    /// Payloads of an encoding that viewers do not show.
    Payload,
    /// Payloads that are JSON objects.
    Object,
    /// JSON objects that a viewer shows in place of the payloads. The payload follows each of them.
    View,
    /// Pictures, or frames of a video.
    Picture(Kind),
}

impl Channel {
    /// Returns the channel of an entry whose messages have this form.
    pub fn of(entry: &Entry, form: Form) -> Self {
        Self {
            topic: entry.topic.clone(),
            encoding: entry.payload.encoding.clone(),
            urgency: entry.urgency,
            recipient: entry.recipient.clone(),
            publisher: entry.publisher,
            retained: entry.retained,
            form,
        }
    }

    /// Returns MCAP's name of the encoding.
    pub fn message_encoding(&self) -> &str {
        match self.form {
            Form::Payload => self.encoding.as_str(),
            Form::Object | Form::View => JSON,
            Form::Picture(_) => picture::PROTOBUF,
        }
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
        if let Some(kind) = self.retained {
            metadata.insert(RETAINED.to_owned(), kind.name().to_owned());
        }
        if self.form == Form::View {
            metadata.insert(FORM.to_owned(), VIEW.to_owned());
        }
        metadata
    }

    /// Returns the channel that a file describes, and the description of one that another program has recorded.
    pub fn read(
        record: mcap::records::Channel,
        schema: Option<Arc<Schema>>,
    ) -> (Self, Option<Foreign>) {
        let mut metadata = record.metadata;
        let (Some(encoding), Some(urgency)) = (metadata.get(ENCODING), metadata.get(URGENCY))
        else {
            let known = KNOWN
                .into_iter()
                .find(|(name, _)| *name == record.message_encoding);
            let channel = Self {
                topic: record.topic,
                encoding: known.map_or(Encoding::BYTES, |(_, encoding)| encoding),
                urgency: Urgency::Normal,
                recipient: None,
                publisher: None,
                retained: None,
                form: Form::Payload,
            };
            let foreign = Foreign {
                message_encoding: record.message_encoding,
                schema,
                metadata,
            };
            return (channel, Some(foreign));
        };
        let encoding = Encoding::new(encoding.clone());
        let form = match metadata.get(FORM) {
            Some(form) if form == VIEW => Form::View,
            _ => Kind::of(&encoding).map_or(Form::Payload, Form::Picture),
        };
        let channel = Self {
            topic: record.topic,
            urgency: named_urgency(urgency),
            recipient: metadata.remove(RECIPIENT),
            publisher: metadata
                .get(PUBLISHER)
                .and_then(|number| number.parse().ok()),
            retained: metadata.get(RETAINED).map(|name| RetainedKind::named(name)),
            encoding,
            form,
        };
        (channel, None)
    }
}

fn urgency_name(urgency: Urgency) -> &'static str {
    match urgency {
        Urgency::Bulk => "bulk",
        Urgency::Normal => "normal",
        Urgency::Urgent => "urgent",
    }
}

fn named_urgency(name: &str) -> Urgency {
    let all = [Urgency::Bulk, Urgency::Normal, Urgency::Urgent];
    let found = all
        .into_iter()
        .find(|urgency| urgency_name(*urgency) == name);
    found.unwrap_or_default()
}
