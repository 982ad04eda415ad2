//! Owns dictionaries: what many small messages have in common.
use std::{ffi::c_void, mem::MaybeUninit, sync::Arc};

use rect::core::dictionary::Dictionary as Trained;

use crate::{
    argument::items,
    boundary::{call, give, wanted, ErrorOut},
    failure::{Code, Failure},
    handle::{self, Object},
    payload::PayloadView,
};

/// A dictionary, with which small messages of the same kind become much smaller. `rect_drop(&dictionary.id, ..)` when it is
/// not needed any more; robots that pack with it keep it.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Dictionary {
    /// Its handle.
    pub id: u64,
}

struct Held(Arc<Trained>);

impl Object for Held {
    const KIND: &'static str = "dictionary";
}

/// What the handle is of.
pub fn live(dictionary: Dictionary) -> Result<Arc<Trained>, Failure> {
    Ok(handle::get::<Held>(dictionary.id)?.0.clone())
}

fn hold(dictionary: Trained) -> Dictionary {
    let id = handle::insert(Held(Arc::new(dictionary)));
    Dictionary { id }
}

/// Makes one, at most `size` bytes large (512 to 131072; 4 to 16 kB is good for JSON), of messages like those to come: some
/// hundred, ten times its size together.
///
/// Thread: any. Takes a while.
#[no_mangle]
pub unsafe extern "C" fn rect_dictionary_train(
    samples: *const PayloadView,
    samples_len: usize,
    size: usize,
    dictionary: Option<&mut MaybeUninit<Dictionary>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("dictionary", &dictionary)?;
        // SAFETY: as rect.h asks.
        let samples = unsafe { items("samples", samples, samples_len) }?;
        let mut all = Vec::with_capacity(samples.len());
        for sample in samples {
            // SAFETY: as rect.h asks.
            all.push(unsafe { sample.parts() }?.0);
        }
        give("dictionary", dictionary, hold(Trained::train(&all, size)?))
    })
}

/// Reads a standard zstd dictionary of `len` bytes.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_dictionary_read(
    data: *const c_void,
    len: usize,
    dictionary: Option<&mut MaybeUninit<Dictionary>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("dictionary", &dictionary)?;
        // SAFETY: as rect.h asks.
        let bytes = unsafe { items("data", data.cast::<u8>(), len) }?;
        give("dictionary", dictionary, hold(Trained::new(bytes)?))
    })
}

/// The number that messages name it by: made from its content, so that it is the same everywhere.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_dictionary_number(
    dictionary: Dictionary,
    number: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || give("number", number, live(dictionary)?.id()))
}
