//! Compresses and decompresses with zstd, with and without a dictionary: one standard frame (RFC 8878), whose
//! decompressed size is limited.
//!
//! If a frame states the size of its content, as RECT's frames do, a buffer of exactly that size is used. For other
//! frames (of programs that compress a stream), the buffer grows up to the limit.
use std::cell::RefCell;

use zstd::zstd_safe::{self, CCtx, DCtx, DParameter, InBuffer, OutBuffer};

use super::{damaged, number, Codec, CodecError, Limits};
use crate::{
    cause::Cause,
    codec::dictionary::{Dictionaries, Prepared},
    message::{
        encoding::{self, Encoding},
        payload::Payload,
    },
};

/// The name of the codec, and the last part of the encoding of its output.
pub const NAME: &str = Encoding::COMPRESSED;

/// A lossless codec for any payload. Higher levels compress better and take longer: 3 suits most payloads; 19 takes
/// several hundred times as long.
#[derive(Clone, Copy, Debug)]
pub struct Zstd {
    level: u8,
}

impl Zstd {
    /// Creates a codec with a level of 1 to 19. Other values are clamped.
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
        smaller_of(payload, compress(&payload.bytes, self.level, None)?)
    }

    fn decode(&self, payload: &Payload, limits: &Limits) -> Result<Payload, CodecError> {
        let encoding = inner_encoding(payload, NAME)?;
        let bytes = decompress(&payload.bytes, limits.max_bytes, &Dictionaries::default())?;
        Ok(Payload::new(bytes, encoding))
    }
}

/// Returns the compressed payload, or the original one if compression saves nothing or the encoding would become too
/// long.
pub(super) fn smaller_of(payload: &Payload, frame: Vec<u8>) -> Result<Payload, CodecError> {
    let encoding = payload.encoding.with_suffix(NAME);
    let suffix_bytes = encoding.as_str().len() - payload.encoding.as_str().len();
    let is_smaller = frame.len() + suffix_bytes < payload.bytes.len();
    if !is_smaller || encoding.as_str().len() > encoding::MAX_BYTES {
        return Ok(payload.clone());
    }
    Ok(Payload::new(frame, encoding))
}

/// Returns the encoding of the decompressed payload.
pub(super) fn inner_encoding(
    payload: &Payload,
    codec: &'static str,
) -> Result<Encoding, CodecError> {
    payload
        .encoding
        .without_suffix(NAME)
        .ok_or_else(|| CodecError::Kind {
            codec,
            found: payload.encoding.clone(),
            expected: "an encoding that ends in `;zstd`",
        })
}

// A context keeps the memory that it has used, and creating one costs more than compressing a small message. So each
// thread keeps one for small messages.
const SMALL: usize = 64 << 10;
thread_local! {
    static COMPRESS: RefCell<CCtx<'static>> = RefCell::new(CCtx::create());
    static DECOMPRESS: RefCell<DCtx<'static>> = RefCell::new(DCtx::create());
}

/// Compresses `bytes` into a frame, which states their length and the id of the dictionary. It has no checksum, because
/// every link has one.
pub(super) fn compress(
    bytes: &[u8],
    level: u8,
    dictionary: Option<&Prepared>,
) -> Result<Vec<u8>, CodecError> {
    let mut frame = Vec::with_capacity(zstd_safe::compress_bound(bytes.len()));
    let mut run = |context: &mut CCtx<'_>| match dictionary {
        None => context.compress(&mut frame, bytes, level.into()),
        Some(prepared) => context.compress_using_cdict(&mut frame, bytes, prepared.compress()),
    };
    let done = if bytes.len() <= SMALL {
        COMPRESS.with_borrow_mut(run)
    } else {
        run(&mut CCtx::create())
    };
    done.map_err(|code| CodecError::Failed {
        codec: NAME,
        reason: Cause::new(zstd_safe::get_error_name(code)),
    })?;
    frame.shrink_to_fit();
    Ok(frame)
}

/// Decompresses a frame to at most `max_bytes`.
pub(super) fn decompress(
    frame: &[u8],
    max_bytes: usize,
    dictionaries: &Dictionaries,
) -> Result<Vec<u8>, CodecError> {
    // Skippable frames have no content, and frames in formats from before 2016 are not supported.
    if !frame.starts_with(&[0x28, 0xB5, 0x2F, 0xFD]) {
        return Err(damaged(NAME, "it does not begin with the magic number"));
    }
    let length = zstd_safe::find_frame_compressed_size(frame).map_err(invalid)?;
    if length != frame.len() {
        return Err(damaged(NAME, "there is data after its end"));
    }
    let prepared = match zstd_safe::get_dict_id_from_frame(frame) {
        None => None,
        Some(id) => {
            let id = id.get();
            let unknown = CodecError::Dictionary { id };
            Some(dictionaries.get(id).ok_or(unknown)?.prepared())
        }
    };
    let length = zstd_safe::get_frame_content_size(frame)
        .map_err(|_| damaged(NAME, "the length of its content cannot be read"))?;
    match length {
        Some(length) => {
            let limits = Limits {
                max_bytes,
                ..Limits::default()
            };
            decompress_sized(frame, limits.bytes(NAME, length)?, prepared)
        }
        None => decompress_unsized(frame, max_bytes, prepared),
    }
}

/// Decompresses a frame that states the length of its content.
fn decompress_sized(
    frame: &[u8],
    length: usize,
    prepared: Option<&Prepared>,
) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(length);
    DECOMPRESS
        .with_borrow_mut(|context| match prepared {
            None => context.decompress(&mut bytes, frame),
            Some(prepared) => {
                context.decompress_using_ddict(&mut bytes, frame, prepared.decompress())
            }
        })
        .map_err(invalid)?;
    if bytes.len() != length {
        return Err(damaged(NAME, "its content does not have the stated length"));
    }
    Ok(bytes)
}

/// Decompresses a frame that does not state the length of its content.
fn decompress_unsized(
    frame: &[u8],
    max_bytes: usize,
    prepared: Option<&Prepared>,
) -> Result<Vec<u8>, CodecError> {
    let mut context = DCtx::create();
    // The window needs memory, too. RFC 8878 recommends that every decoder supports 8 MiB.
    let window_log = max_bytes.max(1).ilog2().clamp(23, 27);
    context
        .set_parameter(DParameter::WindowLogMax(window_log))
        .map_err(invalid)?;
    if let Some(prepared) = prepared {
        context.ref_ddict(prepared.decompress()).map_err(invalid)?;
    }
    let mut input = InBuffer::around(frame);
    let mut bytes = Vec::new();
    let mut piece = Vec::with_capacity(DCtx::out_size());
    loop {
        let mut output = OutBuffer::around(&mut piece);
        let rest = context
            .decompress_stream(&mut output, &mut input)
            .map_err(invalid)?;
        let chunk = output.as_slice();
        if bytes.len() + chunk.len() > max_bytes {
            return Err(CodecError::TooLarge {
                format: NAME,
                found: format!("more than {max_bytes} bytes"),
                limit: format!("{max_bytes} bytes"),
            });
        }
        let is_stuck = chunk.is_empty() && input.pos() == frame.len();
        bytes.extend_from_slice(chunk);
        if rest == 0 {
            return Ok(bytes);
        }
        if is_stuck {
            return Err(damaged(NAME, "it is truncated"));
        }
    }
}

fn invalid(code: zstd_safe::ErrorCode) -> CodecError {
    damaged(NAME, zstd_safe::get_error_name(code))
}
