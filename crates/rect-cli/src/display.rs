//! Renders payloads for the terminal and for JSON output, according to their encoding.
use std::io::{self, IsTerminal};

use rect::Payload;
use rect_core::{
    codec::{picture::Picture, Limits},
    text::display,
};
use serde_json::Value;

/// Largest number of characters of a text that are printed.
const MAX_CHARACTERS: usize = 2000;
/// Width of a picture drawn in a terminal, in characters.
const COLUMNS: u32 = 60;

/// Returns a payload as text for the terminal: its value if it is text, JSON, CBOR or printable bytes, otherwise a
/// summary. The summary of a picture is followed by a drawing if the terminal supports it.
pub fn text(payload: &Payload) -> String {
    let kind = &*display::line(payload.encoding.as_str());
    if let Ok(text) = payload.text() {
        return cut(text);
    }
    let size = payload.bytes.len();
    if let Ok(shown) = payload.picture(&Limits::default()) {
        return picture(&shown, kind, size);
    }
    if let Ok(array) = payload.array(&Limits::default()) {
        let (shape, element) = (array.shape(), array.element().as_str());
        return format!("{kind}, {element} {shape:?}, {size} bytes");
    }
    if let Some(value) = payload.to_json(&Limits::default()) {
        return cut(&value.to_string());
    }
    match std::str::from_utf8(&payload.bytes) {
        Ok(text) if !text.chars().any(char::is_control) => cut(text),
        _ => format!("{kind}, {size} bytes"),
    }
}

/// Returns a summary of a picture that was sent in `size` bytes, and a drawing if the terminal supports it.
pub fn picture(picture: &Picture, kind: &str, size: usize) -> String {
    let (width, height) = (picture.width(), picture.height());
    let summary = format!("{kind}, {width}x{height}, {size} bytes");
    match drawing(picture) {
        Some(drawing) => format!("{summary}\n{drawing}"),
        None => summary,
    }
}

/// Returns a payload as JSON: its value, or otherwise its bytes as `{"hex": ...}`.
pub fn json(payload: &Payload) -> Value {
    payload.to_json(&Limits::default()).unwrap_or_else(|| {
        let hex: String = payload
            .bytes
            .iter()
            .map(|byte| format!("{byte:02x}"))
            .collect();
        serde_json::json!({ "hex": hex })
    })
}

fn cut(text: &str) -> String {
    let end = text.char_indices().nth(MAX_CHARACTERS).map(|(end, _)| end);
    let mut cut = display::paragraph(&text[..end.unwrap_or(text.len())]).into_owned();
    if end.is_some() {
        cut.push_str(" ...");
    }
    cut
}

/// Draws a picture with two pixels per character; returns `None` if the output is not a terminal with 24-bit colours.
fn drawing(picture: &Picture) -> Option<String> {
    let colours = std::env::var("COLORTERM").ok()?;
    if !io::stdout().is_terminal() || !matches!(colours.as_str(), "truecolor" | "24bit") {
        return None;
    }
    let width = COLUMNS.min(picture.width()).max(1);
    let height =
        (u64::from(picture.height()) * u64::from(width) / u64::from(picture.width())).clamp(2, 120);
    let small = picture
        .scaled(width, u32::try_from(height).ok()? & !1)
        .ok()?;
    let (width, channels) = (small.width() as usize, small.format().channels());
    let rows: Vec<&[u8]> = small.pixels().chunks(width * channels).collect();
    let mut drawing = String::new();
    for pair in rows.chunks(2) {
        let [upper, lower] = pair else { break };
        for (above, below) in upper.chunks(channels).zip(lower.chunks(channels)) {
            let ([r, g, b], [r2, g2, b2]) = (colour(above), colour(below));
            drawing += &format!("\x1b[38;2;{r};{g};{b};48;2;{r2};{g2};{b2}m\u{2580}");
        }
        drawing += "\x1b[0m\n";
    }
    Some(drawing)
}

fn colour(pixel: &[u8]) -> [u8; 3] {
    match pixel {
        [r, g, b, ..] => [*r, *g, *b],
        [grey, ..] => [*grey; 3],
        [] => [0; 3],
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rect::{Cbor, Encoding, ToPayload};
    use rect_core::codec::array::Array;

    use super::*;

    #[test]
    fn payloads_are_rendered_according_to_their_encoding() {
        let json = serde_json::json!({"a": 1}).to_payload().expect("JSON");
        assert_eq!(text(&json), r#"{"a":1}"#);
        assert_eq!(text(&"hä".to_payload().expect("text")), "hä");
        assert_eq!(
            text(&[0u8, 1].to_payload().expect("bytes")),
            "zenoh/bytes, 2 bytes"
        );
        assert_eq!(text(&b"plain"[..].to_payload().expect("bytes")), "plain");
        let wrong = Payload::new(vec![255, 216], Encoding::JPEG);
        assert_eq!(text(&wrong), "image/jpeg, 2 bytes");
    }

    #[test]
    fn values_that_json_cannot_express_are_rendered() {
        let cbor = Cbor(BTreeMap::from([(1, f64::NAN)])).to_payload();
        let cbor = cbor.expect("a payload");
        assert_eq!(text(&cbor), r#"{"1":"NaN"}"#);
        let array = Array::of(&[2], &[1u8, 2]).expect("an array");
        let array = array.to_payload().expect("a payload");
        assert_eq!(json(&array), serde_json::json!([1, 2]));
        assert!(
            text(&array).ends_with("u8 [2], 2 bytes"),
            "{}",
            text(&array)
        );
    }

    #[test]
    fn control_characters_are_replaced_and_long_texts_are_cut() {
        let bell = "\x1b[2J\x07".to_payload().expect("text");
        assert!(!text(&bell).contains('\x1b'));
        let two_lines = "1\nwombat-9/b: 12.5".to_payload().expect("text");
        assert_eq!(text(&two_lines), "1\n    wombat-9/b: 12.5");
        let hostile = Payload::new(vec![255], Encoding::new("a\x1b[2J\u{202e}"));
        assert_eq!(text(&hostile), "a\u{fffd}[2J\u{fffd}, 1 bytes");
        let long = "x".repeat(10_000).to_payload().expect("text");
        assert!(text(&long).len() < 2010);
    }
}
