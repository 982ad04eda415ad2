//! Splits the output of a program into lines.

/// The maximum length of a line, in bytes. The rest of a longer one is counted and dropped.
const MAX_LINE: usize = 64 << 10;
/// The maximum number of lines that belong together, such as those of a stack trace.
const MAX_TOGETHER: usize = 200;

/// How a stack trace of Python begins. Its last line, which names the exception, is not indented.
const TRACEBACK: &str = "Traceback (most recent call last)";

/// Splits the bytes that a program writes into texts: single lines, each with the indented ones that follow it at once.
#[derive(Debug, Default)]
pub struct Lines {
    line: Vec<u8>,
    dropped: usize,
    text: String,
    lines: usize,
}

impl Lines {
    /// Adds bytes, and returns the texts that are complete. Lines may follow that belong to the last one.
    pub fn add(&mut self, bytes: &[u8]) -> Vec<String> {
        let mut texts = Vec::new();
        for part in bytes.split_inclusive(|byte| *byte == b'\n') {
            let room = MAX_LINE.saturating_sub(self.line.len());
            let kept = part.len().min(room);
            self.line.extend(&part[..kept]);
            self.dropped += part.len() - kept;
            if part.ends_with(b"\n") {
                self.end_line(&mut texts);
            }
        }
        texts
    }

    /// Returns whether a text waits for lines that belong to it.
    pub fn is_waiting(&self) -> bool {
        !self.text.is_empty()
    }

    /// Returns the text that waits, because no lines have followed it at once.
    pub fn settle(&mut self) -> Vec<String> {
        let mut texts = Vec::new();
        self.end_text(&mut texts);
        texts
    }

    /// Returns everything, also what has no line break at its end.
    pub fn finish(&mut self) -> Vec<String> {
        let mut texts = Vec::new();
        if !self.line.is_empty() {
            self.end_line(&mut texts);
        }
        self.end_text(&mut texts);
        texts
    }

    fn end_line(&mut self, texts: &mut Vec<String>) {
        let line = String::from_utf8_lossy(&self.line);
        let line = line.trim_end_matches(['\r', '\n']);
        // A progress bar writes over itself.
        let line = line.rsplit('\r').next().unwrap_or_default();
        let is_indented = line.starts_with([' ', '\t']);
        let is_last = !is_indented && self.lines > 1 && self.text.starts_with(TRACEBACK);
        let is_continued = (is_indented && !self.text.is_empty()) || is_last;
        let line = match self.dropped {
            0 => line.to_owned(),
            dropped => format!("{line}… ({} bytes)", self.line.len() + dropped),
        };
        self.line.clear();
        self.dropped = 0;
        if is_continued && self.lines < MAX_TOGETHER {
            self.text.push('\n');
            self.text.push_str(&line);
            self.lines += 1;
            if is_last {
                self.end_text(texts);
            }
        } else {
            self.end_text(texts);
            self.text = line;
            self.lines = 1;
        }
    }

    fn end_text(&mut self, texts: &mut Vec<String>) {
        let text = std::mem::take(&mut self.text);
        self.lines = 0;
        if !text.trim().is_empty() {
            texts.push(text);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stack_trace_stays_together_and_other_lines_do_not() {
        let mut lines = Lines::default();
        let given = "one\ntwo\nTraceback (most recent call last):\n  File \"a.py\", line 1\n    x\nValueError: bad\n";
        let trace =
            "Traceback (most recent call last):\n  File \"a.py\", line 1\n    x\nValueError: bad";
        assert_eq!(lines.add(given.as_bytes()), ["one", "two", trace]);
        assert!(!lines.is_waiting());
        // The rest of it may be written a moment later.
        assert!(lines.add(b"terminate called\n").is_empty());
        assert!(lines.is_waiting());
        assert!(lines.add(b"  what():  bad\n").is_empty());
        assert_eq!(lines.settle(), ["terminate called\n  what():  bad"]);
        assert!(lines.finish().is_empty());
    }

    #[test]
    fn lines_may_arrive_in_pieces_and_without_an_end() {
        let mut lines = Lines::default();
        assert!(lines.add(b"Ent").is_empty());
        assert_eq!(lines.add(b"er:\r\n10 %\r50 %\r100 %\n"), ["Enter:"]);
        assert_eq!(lines.settle(), ["100 %"]);
        assert!(lines.add(b"last").is_empty());
        assert_eq!(lines.finish(), ["last"]);
    }

    #[test]
    fn long_and_binary_lines_are_bounded() {
        let mut lines = Lines::default();
        let mut texts = Vec::new();
        for _ in 0..100 {
            texts.extend(lines.add(&[0xff; 10_000]));
        }
        assert!(texts.is_empty());
        texts.extend(lines.add(b"\n"));
        texts.extend(lines.settle());
        let [text] = &texts[..] else {
            panic!("{texts:?}");
        };
        assert!(text.ends_with("… (1000001 bytes)"), "{text}");
    }
}
