//! Pictures and frames of videos in the form in which viewers show them: `foxglove.CompressedImage` and
//! `foxglove.CompressedVideo`, in Protocol Buffers.
//!
//! The definitions are in <https://github.com/foxglove/foxglove-sdk/tree/main/schemas/proto/foxglove>.
use bytes::Bytes;
use prost::Message;
use prost_types::{
    field_descriptor_proto::{Label, Type},
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};
use rect_core::message::encoding::{Encoding, EncodingKind};

use crate::{entry::Entry, schema::Schema};

/// MCAP's name of the encoding.
pub const PROTOBUF: &str = "protobuf";

/// The two kinds of payloads that viewers show as pictures.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A picture.
    Image,
    /// A frame of a video.
    Video,
}

impl Kind {
    /// Returns what payloads of that encoding are; `None` if they are neither.
    pub fn of(encoding: &Encoding) -> Option<Self> {
        known(encoding).map(|(kind, _)| kind)
    }

    /// Returns the schema of the messages.
    pub fn schema(self) -> Schema {
        Schema {
            name: format!("foxglove.{}", self.message()),
            encoding: PROTOBUF.into(),
            text: definition(self),
        }
    }

    fn message(self) -> &'static str {
        match self {
            Self::Image => "CompressedImage",
            Self::Video => "CompressedVideo",
        }
    }
}

/// Returns what viewers show of an encoding, and its name in their schemas.
fn known(encoding: &Encoding) -> Option<(Kind, &'static str)> {
    Some(match encoding.kind() {
        EncodingKind::Jpeg => (Kind::Image, "jpeg"),
        EncodingKind::Png => (Kind::Image, "png"),
        EncodingKind::Webp => (Kind::Image, "webp"),
        EncodingKind::H264 => (Kind::Video, "h264"),
        _ => return None,
    })
}

#[derive(Clone, PartialEq, Message)]
struct CompressedImage {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(bytes = "bytes", tag = "2")]
    data: Bytes,
    #[prost(string, tag = "3")]
    format: String,
    #[prost(string, tag = "4")]
    frame_id: String,
}

#[derive(Clone, PartialEq, Message)]
struct CompressedVideo {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(bytes = "bytes", tag = "3")]
    data: Bytes,
    #[prost(string, tag = "4")]
    format: String,
}

/// Returns the viewers' name of the encoding of a picture, such as `jpeg`; `None` if it is not that of a picture.
pub fn format(encoding: &Encoding) -> Option<&'static str> {
    let (kind, format) = known(encoding)?;
    (kind == Kind::Image).then_some(format)
}

/// Returns the message that a viewer shows for a picture or a frame; `None` if it shows the payload as it is.
pub fn wrap(entry: &Entry) -> Option<Vec<u8>> {
    let (kind, format) = known(&entry.payload.encoding)?;
    let timestamp = Some(Timestamp {
        seconds: i64::try_from(entry.sent.as_secs()).unwrap_or(i64::MAX),
        nanos: i32::try_from(entry.sent.subsec_nanos()).unwrap_or(0),
    });
    let (data, frame_id) = (entry.payload.bytes.clone(), entry.topic.clone());
    let format = format.to_owned();
    Some(match kind {
        Kind::Image => CompressedImage {
            timestamp,
            data,
            format,
            frame_id,
        }
        .encode_to_vec(),
        Kind::Video => CompressedVideo {
            timestamp,
            data,
            format,
            frame_id,
        }
        .encode_to_vec(),
    })
}

/// Returns the picture or frame in a message. `None`: the bytes are something else, such as a picture without a message around
/// it.
pub fn unwrap(kind: Kind, message: &[u8]) -> Option<Bytes> {
    let (format, data) = match kind {
        Kind::Image => {
            let image = CompressedImage::decode(message).ok()?;
            (image.format, image.data)
        }
        Kind::Video => {
            let video = CompressedVideo::decode(message).ok()?;
            (video.format, video.data)
        }
    };
    (!format.is_empty()).then_some(data)
}

/// Returns the definition of the message, for readers that do not know it.
fn definition(kind: Kind) -> Vec<u8> {
    // The two messages have the same fields, but not the same numbers.
    let [frame_id, data, format] = match kind {
        Kind::Image => [4, 2, 3],
        Kind::Video => [2, 3, 4],
    };
    let field = |name: &str, number, kind: Type| FieldDescriptorProto {
        name: Some(name.to_owned()),
        number: Some(number),
        label: Some(Label::Optional.into()),
        r#type: Some(kind.into()),
        ..FieldDescriptorProto::default()
    };
    let file = |name: &str, package: &str, message: &str, fields| FileDescriptorProto {
        name: Some(name.to_owned()),
        package: Some(package.to_owned()),
        message_type: vec![DescriptorProto {
            name: Some(message.to_owned()),
            field: fields,
            ..DescriptorProto::default()
        }],
        syntax: Some("proto3".to_owned()),
        ..FileDescriptorProto::default()
    };
    let timestamp = FieldDescriptorProto {
        type_name: Some(".google.protobuf.Timestamp".to_owned()),
        ..field("timestamp", 1, Type::Message)
    };
    let timestamp_file = "google/protobuf/timestamp.proto";
    let set = FileDescriptorSet {
        file: vec![
            file(
                timestamp_file,
                "google.protobuf",
                "Timestamp",
                vec![
                    field("seconds", 1, Type::Int64),
                    field("nanos", 2, Type::Int32),
                ],
            ),
            FileDescriptorProto {
                dependency: vec![timestamp_file.to_owned()],
                ..file(
                    &format!("foxglove/{}.proto", kind.message()),
                    "foxglove",
                    kind.message(),
                    vec![
                        timestamp,
                        field("frame_id", frame_id, Type::String),
                        field("data", data, Type::Bytes),
                        field("format", format, Type::String),
                    ],
                )
            },
        ],
    };
    set.encode_to_vec()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_without_a_message_are_no_picture() {
        let jpeg: &[u8] = b"\xff\xd8\xff\xe0";
        let png: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR";
        let webp: &[u8] = b"RIFF\x24\0\0\0WEBPVP8 ";
        for bytes in [jpeg, png, webp, b""] {
            for kind in [Kind::Image, Kind::Video] {
                assert_eq!(unwrap(kind, bytes), None, "{bytes:?}");
            }
        }
    }
}
