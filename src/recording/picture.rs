//! Pictures in the form in which viewers show them: `foxglove.CompressedImage`, in Protocol Buffers.
//!
//! The definition is <https://github.com/foxglove/foxglove-sdk/blob/main/schemas/proto/foxglove/CompressedImage.proto>.
use bytes::Bytes;
use prost::Message;
use prost_types::{
    field_descriptor_proto::{Label, Type},
    DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet, Timestamp,
};

use super::entry::Entry;
use crate::core::encoding::Encoding;

/// The name of the schema.
pub const SCHEMA: &str = "foxglove.CompressedImage";
/// MCAP's name of the encoding.
pub const PROTOBUF: &str = "protobuf";

/// The encodings that viewers show, and their names in the schema.
const FORMATS: [(Encoding, &str); 3] = [
    (Encoding::JPEG, "jpeg"),
    (Encoding::PNG, "png"),
    (Encoding::WEBP, "webp"),
];

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

/// Returns whether payloads of that encoding are recorded as pictures.
pub fn is_picture(encoding: &Encoding) -> bool {
    format(encoding).is_some()
}

/// Returns the viewers' name of a picture's encoding, such as `jpeg`; `None` if it is not that of a picture.
pub fn format(encoding: &Encoding) -> Option<&'static str> {
    let found = FORMATS.iter().find(|(known, _)| known == encoding);
    found.map(|(_, format)| *format)
}

/// Returns the message that a viewer shows for a picture.
pub fn wrap(entry: &Entry) -> Vec<u8> {
    let format = format(&entry.payload.encoding).unwrap_or_default();
    let image = CompressedImage {
        timestamp: Some(Timestamp {
            seconds: i64::try_from(entry.sent.as_secs()).unwrap_or(i64::MAX),
            nanos: i32::try_from(entry.sent.subsec_nanos()).unwrap_or(0),
        }),
        data: entry.payload.bytes.clone(),
        format: format.to_owned(),
        frame_id: entry.topic.clone(),
    };
    image.encode_to_vec()
}

/// Returns the picture in a message. `None`: the bytes are something else, such as a picture without a message around it.
pub fn unwrap(message: &[u8]) -> Option<Bytes> {
    let image = CompressedImage::decode(message).ok()?;
    (!image.format.is_empty()).then_some(image.data)
}

/// Returns the definition of the message, for readers that do not know it.
pub fn schema() -> Vec<u8> {
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
                    "foxglove/CompressedImage.proto",
                    "foxglove",
                    "CompressedImage",
                    vec![
                        timestamp,
                        field("frame_id", 4, Type::String),
                        field("data", 2, Type::Bytes),
                        field("format", 3, Type::String),
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
            assert_eq!(unwrap(bytes), None, "{bytes:?}");
        }
    }
}
