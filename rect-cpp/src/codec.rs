//! Encodes and decodes payloads explicitly, without a robot.
use std::{ffi::c_char, mem::MaybeUninit};

use rect_core::codec::{self, dictionary::Dictionaries};

use crate::{
    argument::{require, text},
    boundary::{call, require_out, write_out, ErrorOut},
    dictionary::{self, Dictionary},
    failure::Code,
    payload::{into_c, Buffer, PayloadView},
    picture::CodecLimits,
    text::{string_into_c, StringView},
};

/// Encodes a payload with a codec, e.g. `zstd:9`, `jpeg:60`, `webp:60`, `png` or `quantised:0.01`, and writes the result to
/// `buffer`. A handle of `rect_robot_with_codec` encodes the payloads of all its messages and requests.
///
/// Returns `RECT_CODE_CODEC` if the codec is unknown or does not suit the payload. May be called on any thread. The time it
/// takes depends on the codec.
#[no_mangle]
pub unsafe extern "C" fn rect_encode(
    codec: *const c_char,
    payload: Option<&PayloadView>,
    buffer: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("buffer", &buffer)?;
        // SAFETY: the caller follows the rules of rect.h.
        let (codec, payload) =
            unsafe { (text("codec", codec)?, require("payload", payload)?.read()?) };
        write_out(
            "buffer",
            buffer,
            into_c(codec::parse(codec)?.encode(&payload)?),
        )
    })
}

/// Decodes a payload that was encoded with a codec (its encoding ends with e.g. `;zstd`), and writes the result to `buffer`.
/// Messages and frames that a robot receives are already decoded; use this for payloads that were stored elsewhere.
///
/// `dictionary` is the dictionary that the payload was encoded with, or NULL. `limits` may be NULL for the defaults.
///
/// Returns `RECT_CODE_CODEC` if the payload is damaged, exceeds the limits, or needs another dictionary. May be called on
/// any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_decode(
    payload: Option<&PayloadView>,
    dictionary: Option<&Dictionary>,
    limits: Option<&CodecLimits>,
    buffer: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("buffer", &buffer)?;
        // SAFETY: the caller follows the rules of rect.h.
        let payload = unsafe { require("payload", payload)?.read() }?;
        let dictionaries = match dictionary {
            None => Dictionaries::default(),
            Some(&handle) => Dictionaries::of(dictionary::resolve(handle)?),
        };
        let decoded = codec::decode(&payload, &CodecLimits::read(limits), &dictionaries)?;
        write_out("buffer", buffer, into_c(decoded))
    })
}

/// Writes the full name of a codec to `name`, including the options that were omitted: `zstd:3` for `zstd`.
///
/// Returns `RECT_CODE_CODEC` if there is no such codec. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_codec_name(
    codec: *const c_char,
    name: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("name", &name)?;
        // SAFETY: the caller follows the rules of rect.h.
        let codec = codec::parse(unsafe { text("codec", codec) }?)?;
        write_out("name", name, string_into_c(codec.name()))
    })
}
