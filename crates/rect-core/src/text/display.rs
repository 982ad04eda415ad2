//! Makes text from other robots and programs safe to print on a terminal: topics, payloads, errors of services, reports
//! of a router. `rect` and `rect-router` pass every such text through one of these functions.
//!
//! A terminal interprets control characters, and Unicode's bidirectional and invisible format characters make text read
//! differently. A peer must be able to use neither.
use std::{borrow::Cow, fmt::Write as _};

/// Replaces each character that must not be printed.
const REPLACEMENT: char = '\u{fffd}';
/// Begins every line of a paragraph except the first, so that no line can be mistaken for one of the program itself.
const INDENT: &str = "\n    ";

/// Returns `text` as one line. Each harmful character and each line break becomes U+FFFD.
pub fn line(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let shown = |c: char| if is_harmful(c) { REPLACEMENT } else { c };
    Cow::Owned(text.chars().map(shown).collect())
}

/// Returns `text` with its line breaks and tabs, but without line breaks at the end. All lines but the first are
/// indented; harmful characters become U+FFFD.
pub fn paragraph(text: &str) -> Cow<'_, str> {
    if !text.contains(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len());
    for c in text
        .trim_end_matches(['\r', '\n'])
        .replace("\r\n", "\n")
        .chars()
    {
        match c {
            '\n' => shown.push_str(INDENT),
            '\t' => shown.push('\t'),
            c if is_harmful(c) => shown.push(REPLACEMENT),
            c => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

/// Returns JSON of the same value in which each harmful character is an escape sequence. Line breaks between the parts
/// of the JSON stay.
pub fn json(json: &str) -> Cow<'_, str> {
    let is_escaped = |c: char| c != '\n' && is_harmful(c);
    if !json.contains(is_escaped) {
        return Cow::Borrowed(json);
    }
    let mut escaped = String::with_capacity(json.len());
    for c in json.chars() {
        if is_escaped(c) {
            for unit in c.encode_utf16(&mut [0; 2]) {
                // Writing to a string cannot fail.
                let _ = write!(escaped, "\\u{unit:04x}");
            }
        } else {
            escaped.push(c);
        }
    }
    Cow::Owned(escaped)
}

/// Returns whether a terminal would interpret the character, or display other text because of it. The joiners U+200C
/// and U+200D are part of ordinary text and are allowed. Topics must not contain harmful characters.
pub fn is_harmful(c: char) -> bool {
    c.is_control()
        || matches!(c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}' | '\u{200e}' | '\u{200f}'
            // Line and paragraph separator, and the bidirectional embeddings and overrides.
            | '\u{2028}'..='\u{202e}'
            // Invisible operators, and the bidirectional isolates.
            | '\u{2060}'..='\u{206f}'
            | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
            // Tags, which are invisible letters.
            | '\u{e0000}'..='\u{e007f}')
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sets the title of the window, clears the screen, and imitates a message of another robot.
    const ATTACK: &str = "a\x1b]0;pwned\x07\x1b[2Jb\nfake/c: 12.5";

    #[test]
    fn ordinary_text_is_unchanged() {
        for text in ["", "arm/angle", "hä 日本 👨\u{200d}👩", "a\\nb"] {
            assert_eq!(line(text), text);
            assert_eq!(paragraph(text), text);
            assert_eq!(json(text), text);
        }
    }

    #[test]
    fn a_topic_cannot_write_a_second_line_or_control_the_terminal() {
        let shown = line(ATTACK);
        assert_eq!(
            shown,
            "a\u{fffd}]0;pwned\u{fffd}\u{fffd}[2Jb\u{fffd}fake/c: 12.5"
        );
    }

    #[test]
    fn characters_that_reorder_or_hide_text_are_replaced() {
        for c in [
            '\u{7f}',
            '\u{85}',
            '\u{9b}',
            '\u{200b}',
            '\u{200f}',
            '\u{2028}',
            '\u{202e}',
            '\u{2066}',
            '\u{2069}',
            '\u{feff}',
            '\u{e0041}',
            '\t',
            '\r',
        ] {
            assert_eq!(line(&format!("a{c}b")), "a\u{fffd}b", "{c:?}");
        }
    }

    #[test]
    fn lines_of_a_paragraph_are_indented() {
        assert_eq!(
            paragraph("x\r\nwombat-9/b: 1\ty\n"),
            "x\n    wombat-9/b: 1\ty"
        );
        assert!(!paragraph(ATTACK).contains('\x1b'));
    }

    #[test]
    fn escaped_json_keeps_its_value() {
        let value = serde_json::json!({ "topic": ATTACK, "name": "a\u{202e}b\u{9b}\u{e0041}" });
        let pretty = format!("{value:#}");
        let shown = json(&pretty);
        assert!(
            !shown.chars().any(|c| c != '\n' && is_harmful(c)),
            "{shown:?}"
        );
        let read: serde_json::Value = serde_json::from_str(&shown).expect("JSON");
        assert_eq!(read, value);
    }
}
