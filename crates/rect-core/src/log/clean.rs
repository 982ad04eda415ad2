//! Makes the text of a line safe to keep and to show: without the sequences that control a terminal, and of limited length.
use crate::text::display::is_harmful;

const ESCAPE: char = '\u{1b}';
const REPLACEMENT: char = '\u{fffd}';
/// Room for the note that a text was cut, in bytes.
const NOTE: usize = 32;

/// Returns `text` without terminal sequences, with U+FFFD for each other character that must not be printed, and cut so that it has at
/// most `max` bytes. Line breaks and tabs stay.
pub fn text(text: &str, max: usize) -> String {
    let mut cleaned = String::with_capacity(text.len().min(max));
    let mut chars = text.trim_end_matches(['\r', '\n']).chars().peekable();
    while let Some(c) = chars.next() {
        let c = match c {
            ESCAPE => {
                skip_sequence(&mut chars);
                continue;
            }
            '\r' if chars.peek() == Some(&'\n') => continue,
            '\n' | '\t' => c,
            c if is_harmful(c) => REPLACEMENT,
            c => c,
        };
        cleaned.push(c);
        if cleaned.len() > max {
            cut(&mut cleaned, max.saturating_sub(NOTE));
            cleaned.push_str(&format!("… ({} bytes)", text.len()));
            break;
        }
    }
    cleaned
}

/// Cuts a text after that many bytes or before, between two characters.
fn cut(text: &mut String, at: usize) {
    let is_boundary = |at: &usize| text.is_char_boundary(*at);
    let at = (0..=at).rev().find(is_boundary).unwrap_or_default();
    text.truncate(at);
}

/// Returns `text` as one line.
pub fn word(word: &str, max: usize) -> String {
    text(word, max).replace(['\n', '\t'], " ")
}

/// Skips the rest of a sequence that sets a colour, moves the cursor or sets the title of a window. An unfinished one ends with the
/// line.
fn skip_sequence(chars: &mut std::iter::Peekable<std::str::Chars<'_>>) {
    match chars.next() {
        // Parameters, and one final byte.
        Some('[') => {
            while chars
                .next_if(|c| matches!(c, '\u{20}'..='\u{3f}'))
                .is_some()
            {}
            chars.next_if(|c| matches!(c, '\u{40}'..='\u{7e}'));
        }
        // A text that ends with BEL, or with ESC and a backslash.
        Some(']' | 'P' | '^' | '_') => {
            while let Some(c) = chars.next_if(|c| *c != '\n') {
                match c {
                    '\u{7}' => break,
                    ESCAPE => {
                        chars.next_if_eq(&'\\');
                        break;
                    }
                    _ => {}
                }
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_and_titles_are_removed_and_other_controls_replaced() {
        for (given, expected) in [
            ("\x1b[31mred\x1b[0m and \x1b[1;4mbold", "red and bold"),
            ("\x1b]0;title\x07a\x1b]8;;x\x1b\\b", "ab"),
            ("a\x00b\u{202e}c", "a\u{fffd}b\u{fffd}c"),
            ("one\r\ntwo\tthree\n\n", "one\ntwo\tthree"),
            ("\x1b[", ""),
            ("\x1b", ""),
            ("hä 日本", "hä 日本"),
        ] {
            assert_eq!(text(given, 100), expected, "{given:?}");
        }
    }

    #[test]
    fn long_text_is_cut_between_characters_and_says_so() {
        let long = "ä".repeat(40);
        let cut = text(&long, 41);
        assert_eq!(cut, "ääää… (80 bytes)");
        assert_eq!(text(&cut, 41), cut, "it is cut once");
        assert_eq!(word("a\nb", 5), "a b");
    }
}
