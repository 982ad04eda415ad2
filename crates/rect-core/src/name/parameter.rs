//! Checks the names of groups of parameters, and of parameters.

/// The maximum length of the name of a group or parameter, in characters.
pub const MAX_NAME: usize = 40;

/// Returns whether a text may name a group or a parameter: letters, digits, `_`, `-` and `.`, at most [`MAX_NAME`].
pub fn is_name(text: &str) -> bool {
    let allowed = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    (1..=MAX_NAME).contains(&text.len()) && text.chars().all(allowed) && !matches!(text, "." | "..")
}

/// Returns the error that a text cannot be a name. `what`: its use, such as `the name of a group`.
pub fn wrong_name(text: &str, what: &str) -> String {
    let text: String = text.chars().take(MAX_NAME).collect();
    format!("{text:?} cannot be {what}: use 1 to {MAX_NAME} letters, digits, `_`, `-` and `.`")
}
