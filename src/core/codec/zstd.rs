//! Owns zstd, with and without a dictionary: one standard frame (RFC 8878), and no more than the limit out of it.
//!
//! A frame that says how long its content is, as RECT's do, is undone into exactly that much; one that does not (stock
//! programs that stream) into a buffer that grows to the limit.
use std::cell::RefCell;

use zstd::zstd_safe::{self, CCtx, DCtx, DParameter, InBuffer, OutBuffer};

use super::{damaged, number, Codec, CodecError, Limits};
use crate::core::{
    dictionary::{Dictionaries, Prepared},
    encoding::{self, Encoding},
    payload::Payload,
};

/// What the user calls it, and the last part of the encoding of what is packed so.
pub const NAME: &str = "zstd";

/// Lossless, for anything: the higher the level, the smaller and the slower. 3 is good for most; 19 takes some hundred
/// times as long.
#[derive(Clone, Copy, Debug)]
pub struct Zstd {
    level: u8,
}

impl Zstd {
    /// With a level of 1 to 19; others become the nearest of these.
    pub fn new(level: u8) -> Self {
        Self {
            level: level.clamp(1, 19),
        }
    }

    pub(super) fn parse(option: Option<&str>) -> Result<Self, CodecError> {
        number(NAME, option, 1..=19, 3, "the level, 1 to 19").map(Self::new)
    }
}

impl Codec for Zstd {
    fn name(&self) -> String {
        format!("{NAME}:{}", self.level)
    }

    fn encode(&self, payload: &Payload) -> Result<Payload, CodecError> {
        packed(payload, pack(&payload.bytes, self.level, None)?)
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        let encoding = unpacked(payload, NAME)?;
        let bytes = unpack(&payload.bytes, limits.max_bytes, &Dictionaries::default())?;
        Ok(Payload::new(bytes, encoding))
    }
}

/// The packed payload, or the payload as it is where packing saves nothing.
pub(super) fn packed(payload: &Payload, frame: Vec<u8>) -> Result<Payload, CodecError> {
    let encoding = payload.encoding.packed(NAME);
    let more = encoding.as_str().len() - payload.encoding.as_str().len();
    let is_smaller = frame.len() + more < payload.bytes.len();
    if !is_smaller || encoding.as_str().len() > encoding::MAX_BYTES {
        return Ok(payload.clone());
    }
    Ok(Payload::new(frame, encoding))
}

/// The encoding below the packing.
pub(super) fn unpacked(payload: &Payload, codec: &'static str) -> Result<Encoding, CodecError> {
    payload
        .encoding
        .unpacked(NAME)
        .ok_or_else(|| CodecError::Kind {
            codec,
            found: payload.encoding.clone(),
            wanted: "what ends in `;zstd`",
        })
}

// What a context took once it keeps, and making one costs more than a small message: each thread has one for these.
const SMALL: usize = 64 << 10;
thread_local! {
    static COMPRESS: RefCell<CCtx<'static>> = RefCell::new(CCtx::create());
    static DECOMPRESS: RefCell<DCtx<'static>> = RefCell::new(DCtx::create());
}

/// A frame with `bytes` in it. It says how long they are and with which dictionary it was made, and has no checksum: every
/// link has one.
pub(super) fn pack(
    bytes: &[u8],
    level: u8,
    dictionary: Option<&Prepared>,
) -> Result<Vec<u8>, CodecError> {
    let mut frame = Vec::with_capacity(zstd_safe::compress_bound(bytes.len()));
    let mut pack = |context: &mut CCtx<'_>| match dictionary {
        None => context.compress(&mut frame, bytes, level.into()),
        Some(prepared) => context.compress_using_cdict(&mut frame, bytes, prepared.compress()),
    };
    let done = if bytes.len() <= SMALL {
        COMPRESS.with_borrow_mut(pack)
    } else {
        pack(&mut CCtx::create())
    };
    done.map_err(|code| CodecError::Failed {
        codec: NAME,
        reason: zstd_safe::get_error_name(code).to_owned(),
    })?;
    frame.shrink_to_fit();
    Ok(frame)
}

/// What is in a frame, if it is at most `max_bytes` long.
pub(super) fn unpack(
    frame: &[u8],
    max_bytes: usize,
    dictionaries: &Dictionaries,
) -> Result<Vec<u8>, CodecError> {
    // Skippable frames have nothing in them, and those of before 2016 are not read.
    if !frame.starts_with(&[0x28, 0xB5, 0x2F, 0xFD]) {
        return Err(damaged(NAME, "it does not begin as a frame does"));
    }
    let length = zstd_safe::find_frame_compressed_size(frame).map_err(wrong)?;
    if length != frame.len() {
        return Err(damaged(NAME, "there is more after its end"));
    }
    let prepared = match zstd_safe::get_dict_id_from_frame(frame) {
        None => None,
        Some(id) => {
            let id = id.get();
            let unknown = CodecError::Dictionary { id };
            Some(dictionaries.get(id).ok_or(unknown)?.prepared())
        }
    };
    let said = zstd_safe::get_frame_content_size(frame)
        .map_err(|_| damaged(NAME, "the length of its content can't be read"))?;
    match said {
        Some(said) => {
            let limits = Limits {
                max_bytes,
                ..Limits::default()
            };
            whole(frame, limits.bytes(NAME, said)?, prepared)
        }
        None => growing(frame, max_bytes, prepared),
    }
}

fn whole(frame: &[u8], said: usize, prepared: Option<&Prepared>) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(said);
    DECOMPRESS
        .with_borrow_mut(|context| match prepared {
            None => context.decompress(&mut bytes, frame),
            Some(prepared) => {
                context.decompress_using_ddict(&mut bytes, frame, prepared.decompress())
            }
        })
        .map_err(wrong)?;
    if bytes.len() != said {
        return Err(damaged(NAME, "its content is not as long as it says"));
    }
    Ok(bytes)
}

fn growing(
    frame: &[u8],
    max_bytes: usize,
    prepared: Option<&Prepared>,
) -> Result<Vec<u8>, CodecError> {
    let mut context = DCtx::create();
    // The window is memory too. RFC 8878 wants 8 MiB of every decoder.
    let window_log = max_bytes.max(1).ilog2().clamp(23, 27);
    context
        .set_parameter(DParameter::WindowLogMax(window_log))
        .map_err(wrong)?;
    if let Some(prepared) = prepared {
        context.ref_ddict(prepared.decompress()).map_err(wrong)?;
    }
    let mut input = InBuffer::around(frame);
    let mut bytes = Vec::new();
    let mut piece = Vec::with_capacity(DCtx::out_size());
    loop {
        let mut output = OutBuffer::around(&mut piece);
        let rest = context
            .decompress_stream(&mut output, &mut input)
            .map_err(wrong)?;
        let came = output.as_slice();
        if bytes.len() + came.len() > max_bytes {
            return Err(CodecError::TooLarge {
                format: NAME,
                found: format!("more than {max_bytes} bytes"),
                limit: format!("{max_bytes} bytes"),
            });
        }
        let is_stuck = came.is_empty() && input.pos() == frame.len();
        bytes.extend_from_slice(came);
        if rest == 0 {
            return Ok(bytes);
        }
        if is_stuck {
            return Err(damaged(NAME, "it is cut off"));
        }
    }
}

fn wrong(code: zstd_safe::ErrorCode) -> CodecError {
    damaged(NAME, zstd_safe::get_error_name(code))
}
