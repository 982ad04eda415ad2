//! Defines the names of robots and fleets.
pub mod instance;
pub mod key;
pub mod parameter;
pub mod topic;

use std::{fmt, str::FromStr, sync::Arc};

/// The maximum length of a name, in bytes: the capacity of a Bluetooth scan response.
pub const MAX_BYTES: usize = 29;

/// The name of a robot or a fleet: 1 to 29 letters, digits, `-`, `_` or `.`. It must not be `.` or `..`, nor look like
/// a Bluetooth adapter (`hci0`, `sim...`), because that distinguishes `ble/<name>` from `ble/<adapter>`.
///
/// ```
/// use rect_core::name::Name;
/// let name: Name = "wombat-1".parse()?;
/// assert!("wombat 1".parse::<Name>().is_err());
/// # Ok::<(), rect_core::name::NameError>(())
/// ```
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<str>);

/// The text is not a valid name. Choose another one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// The name is empty or too long.
    #[error("the name {0:?} must be 1 to {MAX_BYTES} bytes long")]
    Length(String),
    /// The name contains a character that is not allowed.
    #[error(
        "the name {name:?} contains {found:?}: use only letters (a to z), digits, `-`, `_` and `.`"
    )]
    Character {
        /// The rejected name.
        name: String,
        /// The first such character.
        found: char,
    },
    /// The name is `.` or `..`, which have a meaning in file systems; names are also used for folders.
    #[error("{0:?} has a special meaning in file systems: choose another name")]
    Folder(String),
    /// The name looks like a Bluetooth adapter.
    #[error("{0:?} looks like the name of a Bluetooth adapter: choose another name")]
    Adapter(String),
}

impl Name {
    /// Creates a name after checking the text.
    ///
    /// # Errors
    /// Returns a [`NameError`] that explains why the text is not a valid name.
    pub fn new(text: &str) -> Result<Self, NameError> {
        if !(1..=MAX_BYTES).contains(&text.len()) {
            // Long names are not quoted in full.
            return Err(NameError::Length(text.chars().take(MAX_BYTES).collect()));
        }
        let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
        if let Some(found) = text.chars().find(|&c| !allowed(c)) {
            let name = text.to_owned();
            return Err(NameError::Character { name, found });
        }
        if matches!(text, "." | "..") {
            return Err(NameError::Folder(text.to_owned()));
        }
        if is_adapter(text) {
            return Err(NameError::Adapter(text.to_owned()));
        }
        Ok(Self(text.into()))
    }

    /// Returns the name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Matches the locators of the `ble/` link: `hci` and a number, or `sim...`.
fn is_adapter(text: &str) -> bool {
    let number = text.strip_prefix("hci");
    let hci =
        number.is_some_and(|n| (1..=5).contains(&n.len()) && n.bytes().all(|b| b.is_ascii_digit()));
    hci || text.starts_with("sim")
}

impl FromStr for Name {
    type Err = NameError;

    fn from_str(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl TryFrom<&str> for Name {
    type Error = NameError;

    fn try_from(text: &str) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl TryFrom<&Name> for Name {
    type Error = NameError;

    fn try_from(name: &Name) -> Result<Self, NameError> {
        Ok(name.clone())
    }
}

impl From<std::convert::Infallible> for NameError {
    fn from(never: std::convert::Infallible) -> Self {
        match never {}
    }
}

impl AsRef<str> for Name {
    fn as_ref(&self) -> &str {
        self.as_str()
    }
}

impl serde::Serialize for Name {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl PartialEq<str> for Name {
    fn eq(&self, other: &str) -> bool {
        self.as_str() == other
    }
}

impl PartialEq<&str> for Name {
    fn eq(&self, other: &&str) -> bool {
        self.as_str() == *other
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

impl fmt::Debug for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_can_be_advertised_and_are_one_part_of_a_key() {
        for good in [
            "a",
            "wombat-1",
            "Team.7_b",
            "hci",
            "hcix",
            "x".repeat(29).as_str(),
        ] {
            assert_eq!(Name::new(good).expect(good).as_str(), good);
        }
        for bad in [
            "",
            "a b",
            "a/b",
            "*",
            "ä",
            ".",
            "..",
            "hci0",
            "sim",
            "sim-a",
            "@rect",
            "x".repeat(30).as_str(),
        ] {
            assert!(Name::new(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn errors_name_the_invalid_character() {
        let error = Name::new("my robot").expect_err("a space").to_string();
        assert!(
            error.contains("my robot") && error.contains("' '"),
            "{error}"
        );
    }
}
