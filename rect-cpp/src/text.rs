//! Converts text, and lists of robot names, into the form that C receives.
use rect::Name;

use crate::{failure::Failure, handle::Object};

/// A text with its length: UTF-8 without a terminating zero byte. To print it:
/// `printf("%.*s", (int)text.len, (const char *)text.data)`.
///
/// An absent text has the length 0. A text that RECT returns is valid as long as the object that it belongs to.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Text {
    /// The first byte; may be NULL if `len` is 0.
    pub data: *const u8,
    /// Length in bytes.
    pub len: usize,
}

impl Text {
    /// An absent text.
    pub const NONE: Self = Self {
        data: std::ptr::null(),
        len: 0,
    };

    /// Points to a text, which must outlive the result.
    pub fn of(text: &str) -> Self {
        Self {
            data: text.as_ptr(),
            len: text.len(),
        }
    }

    /// Points to a text, or returns [`Self::NONE`].
    pub fn of_some(text: Option<&str>) -> Self {
        text.map_or(Self::NONE, Self::of)
    }
}

/// A text with a handle of its own; it contains JSON, or the name of a codec. Release it with `rect_drop(&string.id, ..)`.
#[repr(C)]
pub struct StringView {
    /// The handle.
    pub id: u64,
    /// The text.
    pub text: Text,
}

/// A list of robot names. Release it with `rect_drop(&names.id, ..)`.
#[repr(C)]
pub struct Names {
    /// The handle.
    pub id: u64,
    /// The first name.
    pub items: *const Text,
    /// Number of names.
    pub len: usize,
}

struct OwnedString {
    _text: String,
}

impl Object for OwnedString {
    const KIND: &'static str = "string";
}

/// Moves a text into the handle table and returns its C form.
pub fn string_into_c(text: String) -> StringView {
    let view = Text::of(&text);
    StringView {
        id: crate::handle::insert(OwnedString { _text: text }),
        text: view,
    }
}

struct OwnedNames {
    _names: Vec<Name>,
    _views: Vec<Text>,
}

// SAFETY: the views point into the names stored next to them, which never change.
unsafe impl Send for OwnedNames {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedNames {}

impl Object for OwnedNames {
    const KIND: &'static str = "list of names";
}

/// Moves names into the handle table and returns their C form.
pub fn names_into_c(names: Vec<Name>) -> Names {
    let views: Vec<Text> = names.iter().map(|name| Text::of(name.as_str())).collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = crate::handle::insert(OwnedNames {
        _names: names,
        _views: views,
    });
    Names { id, items, len }
}

/// Returns the value that a number from C stands for.
pub fn choice<T: Copy>(name: &'static str, all: &[(u32, T)], given: u32) -> Result<T, Failure> {
    let found = all.iter().find(|(number, _)| *number == given);
    found.map(|(_, choice)| *choice).ok_or_else(|| {
        let max = all.len() - 1;
        Failure::argument(name, format!("is {given}, but must be 0 to {max}"))
    })
}

/// Returns C's number for a value.
pub fn number<T: PartialEq>(all: &[(u32, T)], choice: &T) -> u32 {
    let found = all.iter().find(|(_, value)| value == choice);
    found.map_or(0, |(number, _)| *number)
}
