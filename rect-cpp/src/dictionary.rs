//! Trains and loads compression dictionaries.
use std::{ffi::c_void, mem::MaybeUninit, sync::Arc};

use rect_core::codec::dictionary::Dictionary as LibraryDictionary;

use crate::{
    argument::items,
    boundary::{call, require_out, write_out, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
};

/// A compression dictionary for small messages of similar content. Release it with `rect_drop(&dictionary.id, ..)`; robots
/// that use it keep it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Dictionary {
    /// The handle.
    pub id: u64,
}

struct OwnedDictionary(Arc<LibraryDictionary>);

impl Object for OwnedDictionary {
    const KIND: &'static str = "dictionary";
}

/// Returns the dictionary behind a handle.
pub fn resolve(dictionary: Dictionary) -> Result<Arc<LibraryDictionary>, Failure> {
    Ok(handle::get::<OwnedDictionary>(dictionary.id)?.0.clone())
}

fn into_c(dictionary: LibraryDictionary) -> Dictionary {
    let id = handle::insert(OwnedDictionary(Arc::new(dictionary)));
    Dictionary { id }
}

/// Trains a dictionary of at most `size` bytes (512 to 131072; 4 to 16 kB suit JSON) and writes it to `dictionary`.
///
/// The samples are a few hundred messages of the kind that will be sent, about ten times `size` in total. Their encodings do
/// not matter.
///
/// Returns `RECT_CODE_DICTIONARY` if the samples are too few or too different. May be called on any thread. Training takes
/// long enough that a program should do it only once, when it starts.
#[no_mangle]
pub unsafe extern "C" fn rect_dictionary_train(
    samples: *const PayloadView,
    samples_len: usize,
    size: usize,
    dictionary: Option<&mut MaybeUninit<Dictionary>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("dictionary", &dictionary)?;
        // SAFETY: the caller follows the rules of rect.h.
        let samples = unsafe { items("samples", samples, samples_len) }?;
        let mut all = Vec::with_capacity(samples.len());
        for sample in samples {
            // SAFETY: the caller follows the rules of rect.h.
            all.push(unsafe { sample.parts() }?.0);
        }
        write_out(
            "dictionary",
            dictionary,
            into_c(LibraryDictionary::train(&all, size)?),
        )
    })
}

/// Loads a standard zstd dictionary of `len` bytes.
///
/// Returns `RECT_CODE_DICTIONARY` if the bytes are not a dictionary. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_dictionary_read(
    data: *const c_void,
    len: usize,
    dictionary: Option<&mut MaybeUninit<Dictionary>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("dictionary", &dictionary)?;
        // SAFETY: the caller follows the rules of rect.h.
        let bytes = unsafe { items("data", data.cast::<u8>(), len) }?;
        write_out(
            "dictionary",
            dictionary,
            into_c(LibraryDictionary::new(bytes)?),
        )
    })
}

/// Writes the id of a dictionary to `id`. Payloads refer to the dictionary by this id, which is computed from its content
/// and is therefore the same on every robot.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_dictionary_id(
    dictionary: Dictionary,
    id: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || write_out("id", id, resolve(dictionary)?.id()))
}
