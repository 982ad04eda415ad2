//! Checks names, topics and patterns before they are used.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::{Name, Pattern, Topic};

use crate::{
    argument::text,
    boundary::{call, ErrorOut},
    failure::Code,
};

/// Checks whether a text is a valid name of a robot or fleet. Returns `RECT_CODE_NAME` with the reason if it is not. May be
/// called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_check_name(
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        Name::new(unsafe { text("name", name) }?)?;
        Ok(())
    })
}

/// Checks whether a text is a valid topic. Returns `RECT_CODE_TOPIC` with the reason if it is not. May be called on any
/// thread.
#[no_mangle]
pub unsafe extern "C" fn rect_check_topic(
    topic: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        Topic::new(unsafe { text("topic", topic) }?)?;
        Ok(())
    })
}

/// Checks whether a text is a valid pattern for subscribing. Returns `RECT_CODE_TOPIC` or `RECT_CODE_NAME` with the reason
/// if it is not. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_check_pattern(
    pattern: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        Pattern::new(unsafe { text("pattern", pattern) }?)?;
        Ok(())
    })
}
