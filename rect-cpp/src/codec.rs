//! Owns making payloads smaller, and undoing it, by hand.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::core::{codec, dictionary::Dictionaries};

use crate::{
    argument::{text, there},
    boundary::{call, give, wanted, ErrorOut},
    dictionary::{self, Dictionary},
    failure::Code,
    payload::{hold, Buffer, PayloadView},
    picture::CodecLimits,
    text::{hold_string, StringView},
};

/// A payload made smaller by a codec: `zstd:9`, `jpeg:60`, `webp:60`, `png`, `quantised:0.01`. `rect_robot_encoded` does so
/// for all that a robot says.
///
/// Thread: any. Takes as long as the codec.
#[no_mangle]
pub unsafe extern "C" fn rect_encode(
    codec: *const c_char,
    payload: Option<&PayloadView>,
    buffer: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("buffer", &buffer)?;
        // SAFETY: as rect.h asks.
        let (codec, payload) =
            unsafe { (text("codec", codec)?, there("payload", payload)?.read()?) };
        give(
            "buffer",
            buffer,
            hold(codec::parse(codec)?.encode(&payload)?),
        )
    })
}

/// A payload without its packings (`;zstd`). What comes by a robot has none any more: this is for what was kept elsewhere.
/// `dictionary`: NULL, or the one that it was packed with; `limits`: NULL for the default.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_unpack(
    payload: Option<&PayloadView>,
    dictionary: Option<&Dictionary>,
    limits: Option<&CodecLimits>,
    buffer: Option<&mut MaybeUninit<Buffer>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("buffer", &buffer)?;
        // SAFETY: as rect.h asks.
        let payload = unsafe { there("payload", payload)?.read() }?;
        let known = match dictionary {
            None => Dictionaries::default(),
            Some(&one) => Dictionaries::of(dictionary::live(one)?),
        };
        let unpacked = codec::decode(&payload, &CodecLimits::read(limits), &known)?;
        give("buffer", buffer, hold(unpacked))
    })
}

/// The whole name of a codec, with the options that were left out: `zstd:3` for `zstd`.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_codec_name(
    codec: *const c_char,
    name: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("name", &name)?;
        // SAFETY: as rect.h asks.
        let codec = codec::parse(unsafe { text("codec", codec) }?)?;
        give("name", name, hold_string(codec.name()))
    })
}
