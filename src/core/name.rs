//! Owns what a robot or a fleet may be called.
use std::{fmt, str::FromStr, sync::Arc};

/// The longest name, in bytes: what fits a Bluetooth scan response.
pub const MAX_BYTES: usize = 29;

/// The name of a robot, or of a fleet: 1 to 29 letters, digits, `-`, `_` or `.`; not `.` or `..`, and not that of a
/// Bluetooth adapter (`hci0`, `sim...`), since `ble/<name>` and `ble/<adapter>` are told apart by it.
///
/// ```
/// use rect::core::name::Name;
/// let name: Name = "wombat-1".parse()?;
/// assert!("wombat 1".parse::<Name>().is_err());
/// # Ok::<(), rect::core::name::NameError>(())
/// ```
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Name(Arc<str>);

/// The text can't name a robot or a fleet. Choose another.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NameError {
    /// Empty, or too long.
    #[error("the name {0:?} is to be 1 to {MAX_BYTES} bytes long")]
    Length(String),
    /// A character that is not for names.
    #[error("the name {name:?} has {found:?} in it: letters (a to z), digits, `-`, `_` and `.` are for names")]
    Character {
        /// What was given.
        name: String,
        /// The first such character.
        found: char,
    },
    /// What every folder calls itself or the one above it: a name may become a file's.
    #[error("{0:?} is what file systems call a folder: choose another name")]
    Folder(String),
    /// That of a Bluetooth adapter.
    #[error("{0:?} is what a Bluetooth adapter is called: choose another name")]
    Adapter(String),
}

impl Name {
    /// Checks a text.
    ///
    /// # Errors
    /// [`NameError`]: what is wrong with it.
    pub fn new(text: &str) -> Result<Self, NameError> {
        if !(1..=MAX_BYTES).contains(&text.len()) {
            // A long one is not repeated whole.
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

    /// As text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// As the `ble/` link reads locators: `hci` and a number, or `sim...`.
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
    fn names_are_what_can_be_advertised_and_is_one_part_of_a_key() {
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
    fn what_is_wrong_is_named() {
        let error = Name::new("my robot").expect_err("a space").to_string();
        assert!(
            error.contains("my robot") && error.contains("' '"),
            "{error}"
        );
    }
}
