//! Reads the messages of a batch of Zenoh, with the number of bytes of each.
use zenoh_buffers::reader::{DidntRead, HasReader, Reader};
use zenoh_codec::{RCodec, Zenoh080, Zenoh080Condition, Zenoh080Header};
use zenoh_protocol::{
    common::{iext, imsg},
    core::{Encoding, ExprId, Timestamp, WireExpr},
    network::{
        declare::DeclareBody, id as network, push, request, response, Mapping, NetworkBody,
        NetworkMessage,
    },
    transport::{id as transport, FragmentHeader, FrameHeader},
    zenoh::{id as zenoh, put},
};

/// A part of a batch. The bytes of the batch's head belong to its first part.
#[derive(Debug)]
pub enum Part {
    /// A message with a key, a request or a reply, and its number of bytes.
    Keyed(WireExpr<'static>, usize),
    /// A declaration of a key with its number, or `None` if it is undeclared; and the number of bytes of the declaration.
    Declared(ExprId, Option<WireExpr<'static>>, usize),
    /// The first fragment of a message with that key, which is the whole batch.
    First(WireExpr<'static>),
    /// A further fragment of a message, which is the whole batch.
    Next,
    /// The number of bytes of another message of Zenoh.
    Zenoh(usize),
    /// The number of bytes that cannot be parsed, at the end of the batch.
    Unknown(usize),
}

/// Iterates over the parts of a batch.
pub struct Batch<'a> {
    rest: &'a [u8],
    is_started: bool,
}

impl<'a> Batch<'a> {
    /// Begins at the first part.
    pub fn new(batch: &'a [u8]) -> Self {
        Self {
            rest: batch,
            is_started: false,
        }
    }

    /// Reads the batch's head, and the first part.
    fn first(&mut self) -> Result<Part, DidntRead> {
        let size = self.rest.len();
        let mut reader = self.rest.reader();
        let header: u8 = Zenoh080::new().read(&mut reader)?;
        let codec = Zenoh080Header::new(header);
        match imsg::mid(header) {
            transport::FRAME => {
                let _: FrameHeader = codec.read(&mut reader)?;
                self.rest = reader;
                self.message(size)
            }
            transport::FRAGMENT => {
                let fragment: FragmentHeader = codec.read(&mut reader)?;
                let part = match fragment.ext_first {
                    Some(_) => Part::First(key_of(&mut reader)?.1),
                    None => Part::Next,
                };
                self.rest = &[];
                Ok(part)
            }
            transport::INIT
            | transport::OPEN
            | transport::CLOSE
            | transport::KEEP_ALIVE
            | transport::JOIN
            | transport::OAM => {
                self.rest = &[];
                Ok(Part::Zenoh(size))
            }
            _ => Err(DidntRead),
        }
    }

    /// Reads the message that begins here. `size` is the number of bytes from the beginning of the part on.
    fn message(&mut self, size: usize) -> Result<Part, DidntRead> {
        // Nearly all messages are values.
        if let Ok((expr, rest)) = value(self.rest) {
            self.rest = rest;
            return Ok(Part::Keyed(expr, size - rest.len()));
        }
        let mut reader = self.rest.reader();
        let message: NetworkMessage = Zenoh080::new().read(&mut reader)?;
        self.rest = reader;
        let size = size - self.rest.len();
        Ok(match message.body {
            NetworkBody::Push(push) => Part::Keyed(push.wire_expr, size),
            NetworkBody::Request(request) => Part::Keyed(request.wire_expr, size),
            NetworkBody::Response(reply) => Part::Keyed(reply.wire_expr, size),
            NetworkBody::Declare(declare) => match declare.body {
                DeclareBody::DeclareKeyExpr(declared) => {
                    Part::Declared(declared.id, Some(declared.wire_expr), size)
                }
                DeclareBody::UndeclareKeyExpr(declared) => Part::Declared(declared.id, None, size),
                _ => Part::Zenoh(size),
            },
            NetworkBody::ResponseFinal(_) | NetworkBody::Interest(_) | NetworkBody::OAM(_) => {
                Part::Zenoh(size)
            }
        })
    }
}

impl Iterator for Batch<'_> {
    type Item = Part;

    fn next(&mut self) -> Option<Part> {
        if self.rest.is_empty() {
            return None;
        }
        let size = self.rest.len();
        let part = match std::mem::replace(&mut self.is_started, true) {
            false => self.first(),
            true => self.message(size),
        };
        Some(part.unwrap_or_else(|DidntRead| {
            self.rest = &[];
            Part::Unknown(size)
        }))
    }
}

/// Reads the key of a message with a value, and returns it with what follows the message. Reading a whole message copies its
/// content.
fn value(message: &[u8]) -> Result<(WireExpr<'static>, &[u8]), DidntRead> {
    let (mut reader, codec) = (message.reader(), Zenoh080::new());
    let (header, expr) = key_of(&mut reader)?;
    if imsg::mid(header) != network::PUSH {
        return Err(DidntRead);
    }
    skip_extensions(&mut reader, imsg::has_flag(header, push::flag::Z))?;
    let body: u8 = codec.read(&mut reader)?;
    if imsg::mid(body) != zenoh::PUT {
        return Err(DidntRead);
    }
    if imsg::has_flag(body, put::flag::T) {
        let _: Timestamp = codec.read(&mut reader)?;
    }
    if imsg::has_flag(body, put::flag::E) {
        let _: Encoding = codec.read(&mut reader)?;
    }
    skip_extensions(&mut reader, imsg::has_flag(body, put::flag::Z))?;
    skip_bytes(&mut reader)?;
    Ok((expr, reader))
}

fn skip_extensions(reader: &mut &[u8], mut has_more: bool) -> Result<(), DidntRead> {
    let codec = Zenoh080::new();
    while has_more {
        let header: u8 = codec.read(&mut *reader)?;
        match header & iext::ENC_MASK {
            iext::ENC_UNIT => {}
            iext::ENC_Z64 => {
                let _: u64 = codec.read(&mut *reader)?;
            }
            iext::ENC_ZBUF => skip_bytes(reader)?,
            _ => return Err(DidntRead),
        }
        has_more = imsg::has_flag(header, iext::FLAG_Z);
    }
    Ok(())
}

/// Skips bytes after their number.
fn skip_bytes(reader: &mut &[u8]) -> Result<(), DidntRead> {
    let count: u32 = Zenoh080::new().read(&mut *reader)?;
    let count = usize::try_from(count).map_err(|_| DidntRead)?;
    *reader = reader.get(count..).ok_or(DidntRead)?;
    Ok(())
}

/// Reads the header and the key of the message that begins here.
fn key_of(reader: &mut impl Reader) -> Result<(u8, WireExpr<'static>), DidntRead> {
    let codec = Zenoh080::new();
    let header: u8 = codec.read(&mut *reader)?;
    let (named, mapping) = match imsg::mid(header) {
        network::PUSH => (push::flag::N, push::flag::M),
        network::REQUEST => {
            let _: u32 = codec.read(&mut *reader)?;
            (request::flag::N, request::flag::M)
        }
        network::RESPONSE => {
            let _: u32 = codec.read(&mut *reader)?;
            (response::flag::N, response::flag::M)
        }
        _ => return Err(DidntRead),
    };
    let is_named = imsg::has_flag(header, named);
    let mut expr: WireExpr<'static> = Zenoh080Condition::new(is_named).read(&mut *reader)?;
    expr.mapping = match imsg::has_flag(header, mapping) {
        true => Mapping::Sender,
        false => Mapping::Receiver,
    };
    Ok((header, expr))
}
