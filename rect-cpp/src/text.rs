//! Owns text and names as C gets them.
use rect::Name;

use crate::{failure::Failure, handle::Object};

/// Text that RECT gives: UTF-8, without a zero byte at its end, `printf("%.*s", (int)text.len, text.data)`. What is not
/// there has the length 0. It lives as long as what it belongs to.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Text {
    /// The first byte; NULL where there is none.
    pub data: *const u8,
    /// How many bytes.
    pub len: usize,
}

impl Text {
    /// Nothing.
    pub const NONE: Self = Self {
        data: std::ptr::null(),
        len: 0,
    };

    /// Of a text that outlives it.
    pub fn of(text: &str) -> Self {
        Self {
            data: text.as_ptr(),
            len: text.len(),
        }
    }

    /// The same, of what may not be there.
    pub fn of_some(text: Option<&str>) -> Self {
        text.map_or(Self::NONE, Self::of)
    }
}

/// A text of its own, as JSON. `rect_drop(&string.id, ..)` when it is not needed any more.
#[repr(C)]
pub struct StringView {
    /// Its handle.
    pub id: u64,
    /// The text.
    pub text: Text,
}

/// Names of robots. `rect_drop(&names.id, ..)` when they are not needed any more.
#[repr(C)]
pub struct Names {
    /// Their handle.
    pub id: u64,
    /// The first.
    pub items: *const Text,
    /// How many.
    pub len: usize,
}

struct HeldString {
    _text: String,
}

impl Object for HeldString {
    const KIND: &'static str = "string";
}

/// Gives C a text.
pub fn hold_string(text: String) -> StringView {
    let shown = Text::of(&text);
    StringView {
        id: crate::handle::insert(HeldString { _text: text }),
        text: shown,
    }
}

struct HeldNames {
    _names: Vec<Name>,
    _views: Vec<Text>,
}

// SAFETY: the views point into the names beside them, which never change.
unsafe impl Send for HeldNames {}
// SAFETY: as above.
unsafe impl Sync for HeldNames {}

impl Object for HeldNames {
    const KIND: &'static str = "list of names";
}

/// Gives C names.
pub fn hold_names(names: Vec<Name>) -> Names {
    let views: Vec<Text> = names.iter().map(|name| Text::of(name.as_str())).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = crate::handle::insert(HeldNames {
        _names: names,
        _views: views,
    });
    Names { id, items, len }
}

/// What one of C's numbers stands for.
pub fn choice<T: Copy>(name: &'static str, all: &[(u32, T)], given: u32) -> Result<T, Failure> {
    let found = all.iter().find(|(number, _)| *number == given);
    found.map(|(_, choice)| *choice).ok_or_else(|| {
        let most = all.len() - 1;
        Failure::argument(name, format!("is {given}, and may be 0 to {most}"))
    })
}

/// C's number of a choice.
pub fn number<T: PartialEq>(all: &[(u32, T)], choice: &T) -> u32 {
    let found = all.iter().find(|(_, one)| one == choice);
    found.map_or(0, |(number, _)| *number)
}
