//! Owns telling what may be a name, a topic or a pattern, before it is used.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::{Name, Pattern, Topic};

use crate::{
    argument::text,
    boundary::{call, ErrorOut},
    failure::Code,
};

/// Whether a text may be the name of a robot or a fleet; if not, why.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_check_name(
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        Name::new(unsafe { text("name", name) }?)?;
        Ok(())
    })
}

/// Whether a text may be the topic of a message; if not, why.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_check_topic(
    topic: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        Topic::new(unsafe { text("topic", topic) }?)?;
        Ok(())
    })
}

/// Whether a text may be the pattern of a subscription; if not, why.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_check_pattern(
    pattern: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        Pattern::new(unsafe { text("pattern", pattern) }?)?;
        Ok(())
    })
}
