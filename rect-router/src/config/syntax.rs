//! Explains in words, with the line, why a configuration file is not valid JSON5. Zenoh's parser names only what it expected where it
//! gave up, which for a missing comma is another place.

/// Maximum depth of nested objects and lists.
const MAX_DEPTH: usize = 64;
/// Maximum number of characters of the file that a message quotes.
const MAX_QUOTED: usize = 40;

/// Returns what is wrong with the text of a configuration, beginning with the line; `None` if it is an object in JSON5.
pub(super) fn problem(text: &str) -> Option<String> {
    let mut scanner = Scanner { text, at: 0 };
    let problem = scanner.document().err()?;
    Some(format!(
        "line {}: {}",
        line_of(text, problem.at),
        problem.what
    ))
}

/// Returns Zenoh's error about a value, `JSON error: Message { msg: "...", location: Some(Location { line: 27, column: 5 }) }`, in
/// words. Returns `None` if it has another form.
pub(super) fn value_problem(error: &str) -> Option<String> {
    let (_, rest) = error.split_once("JSON error: Message { msg: ")?;
    let (message, rest) = rest.rsplit_once(", location: ")?;
    // The message is quoted and escaped as in Rust.
    let message = message.strip_prefix('"').unwrap_or(message);
    let message = message.strip_suffix('"').unwrap_or(message);
    let message = message.replace("\\\"", "\"");
    let line: String = rest
        .split_once("line: ")
        .map_or_else(String::new, |(_, rest)| {
            rest.chars().take_while(char::is_ascii_digit).collect()
        });
    Some(match line.as_str() {
        "" => message,
        line => format!("line {line}: {message}"),
    })
}

fn line_of(text: &str, at: usize) -> usize {
    1 + text.as_bytes()[..at]
        .iter()
        .filter(|&&byte| byte == b'\n')
        .count()
}

#[derive(Debug)]
struct Problem {
    /// The position in the text, in bytes.
    at: usize,
    what: String,
}

fn problem_at<T>(at: usize, what: impl Into<String>) -> Result<T, Problem> {
    Err(Problem {
        at,
        what: what.into(),
    })
}

/// The kinds of brackets.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Bracket {
    Object,
    List,
}

impl Bracket {
    fn opening(self) -> char {
        match self {
            Self::Object => '{',
            Self::List => '[',
        }
    }

    fn closing(self) -> char {
        match self {
            Self::Object => '}',
            Self::List => ']',
        }
    }
}

/// Reads a text from its beginning.
struct Scanner<'a> {
    text: &'a str,
    at: usize,
}

impl Scanner<'_> {
    fn document(&mut self) -> Result<(), Problem> {
        self.blanks()?;
        let begin = self.at;
        if self.peek() != Some('{') {
            return problem_at(begin, "a configuration is an object in braces, { ... }");
        }
        self.value("the configuration", 0)?;
        self.blanks()?;
        match self.peek() {
            None => Ok(()),
            Some(_) => {
                let what = format!(
                    "{} follows the end of the configuration; is there a bracket too many before it?",
                    self.quoted()
                );
                problem_at(self.at, what)
            }
        }
    }

    fn value(&mut self, of: &str, depth: usize) -> Result<(), Problem> {
        self.blanks()?;
        match self.peek() {
            _ if depth > MAX_DEPTH => problem_at(self.at, "too many brackets in each other"),
            Some('{') => self.brackets(Bracket::Object, depth),
            Some('[') => self.brackets(Bracket::List, depth),
            Some(quote @ ('"' | '\'')) => self.string(quote),
            Some(c) if is_in_word(c) => self.word(),
            Some(_) => problem_at(
                self.at,
                format!("the value of {of} is missing before {}", self.quoted()),
            ),
            None => problem_at(
                self.at,
                format!("the file ends where the value of {of} is expected"),
            ),
        }
    }

    /// Reads an object or a list.
    fn brackets(&mut self, bracket: Bracket, depth: usize) -> Result<(), Problem> {
        let (begin, closing) = (self.at, bracket.closing());
        self.at += 1;
        loop {
            self.blanks()?;
            if self.take(closing) {
                return Ok(());
            }
            self.not_the_end(begin, bracket)?;
            let name = match bracket {
                Bracket::Object => self.name()?,
                Bracket::List => "a list".to_owned(),
            };
            self.value(&name, depth + 1)?;
            let end = self.at;
            self.blanks()?;
            if self.take(',') {
                continue;
            }
            if self.take(closing) {
                return Ok(());
            }
            self.not_the_end(begin, bracket)?;
            let next = self.quoted();
            return match self.peek() {
                Some('}' | ']') => problem_at(
                    self.at,
                    format!(
                        "{next} does not fit the `{}` of line {}",
                        bracket.opening(),
                        line_of(self.text, begin)
                    ),
                ),
                _ if line_of(self.text, end) < line_of(self.text, self.at) => {
                    problem_at(end, format!("a comma is missing at its end, before {next}"))
                }
                _ => problem_at(end, format!("a comma is missing before {next}")),
            };
        }
    }

    /// Fails at the end of the text, inside the brackets that begin at `begin`.
    fn not_the_end(&self, begin: usize, bracket: Bracket) -> Result<(), Problem> {
        if self.at < self.text.len() {
            return Ok(());
        }
        problem_at(
            begin,
            format!(
                "the `{}` is not closed: the file ends without its `{}`",
                bracket.opening(),
                bracket.closing()
            ),
        )
    }

    /// Reads the name of a field and its colon, and returns them in quotes for a message.
    fn name(&mut self) -> Result<String, Problem> {
        let begin = self.at;
        match self.peek() {
            Some(quote @ ('"' | '\'')) => self.string(quote)?,
            Some(c) if is_in_word(c) => self.skip(is_in_word),
            _ => {
                let what = format!("the name of a setting is expected, not {}", self.quoted());
                return problem_at(begin, what);
            }
        }
        let name = format!("`{}`", &self.text[begin..self.at]);
        let end = self.at;
        self.blanks()?;
        match self.take(':') {
            true => Ok(name),
            false => problem_at(end, format!("a colon is missing after {name}")),
        }
    }

    fn string(&mut self, quote: char) -> Result<(), Problem> {
        let begin = self.at;
        self.at += 1;
        while let Some(c) = self.peek() {
            self.at += c.len_utf8();
            match c {
                '\\' => self.at += self.peek().map_or(0, char::len_utf8),
                '\n' => break,
                c if c == quote => return Ok(()),
                _ => {}
            }
        }
        problem_at(
            begin,
            format!("the text that begins with {quote} has no closing {quote}"),
        )
    }

    /// Reads a number, `true`, `false` or `null`.
    fn word(&mut self) -> Result<(), Problem> {
        let begin = self.at;
        self.skip(is_in_word);
        let word = &self.text[begin..self.at];
        let digits = word.trim_start_matches(['+', '-']);
        let is_number = digits.starts_with(|c: char| c.is_ascii_digit() || c == '.');
        if is_number || matches!(digits, "true" | "false" | "null" | "Infinity" | "NaN") {
            return Ok(());
        }
        let word = cut(word);
        problem_at(
            begin,
            format!("`{word}` is neither a number nor true, false or null; a text needs quotes: \"{word}\""),
        )
    }

    /// Skips white space and comments.
    fn blanks(&mut self) -> Result<(), Problem> {
        loop {
            self.skip(|c| c.is_whitespace() || c == '\u{feff}');
            let rest = &self.text[self.at..];
            if rest.starts_with("//") {
                self.skip(|c| c != '\n');
            } else if rest.starts_with("/*") {
                let Some(end) = rest.find("*/") else {
                    return problem_at(self.at, "the comment /* has no closing */");
                };
                self.at += end + 2;
            } else {
                return Ok(());
            }
        }
    }

    fn peek(&self) -> Option<char> {
        self.text[self.at..].chars().next()
    }

    /// Skips `c` if it is next.
    fn take(&mut self, c: char) -> bool {
        let is_next = self.peek() == Some(c);
        self.at += if is_next { c.len_utf8() } else { 0 };
        is_next
    }

    fn skip(&mut self, is_skipped: impl Fn(char) -> bool) {
        let rest = &self.text[self.at..];
        self.at += rest.find(|c| !is_skipped(c)).unwrap_or(rest.len());
    }

    /// Returns the next word in quotes for a message.
    fn quoted(&self) -> String {
        let rest = &self.text[self.at..];
        let word = rest.find(|c: char| c.is_whitespace() || ":,{}[]".contains(c));
        let end = match word.unwrap_or(rest.len()) {
            0 => self.peek().map_or(0, char::len_utf8),
            end => end,
        };
        format!("`{}`", cut(&rest[..end]))
    }
}

/// Returns whether a character can be part of a number or a name without quotes. A missing quote often leaves the others.
fn is_in_word(c: char) -> bool {
    c.is_alphanumeric() || "_$+-./".contains(c)
}

fn cut(text: &str) -> &str {
    let end = text.char_indices().nth(MAX_QUOTED).map(|(end, _)| end);
    &text[..end.unwrap_or(text.len())]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_line_and_cause() {
        for (text, expected) in [
            ("{\n a: \"x\"\n b: 1 }", "line 2: a comma is missing at its end, before `b`"),
            ("{ a: [1\n\n 2] }", "line 1: a comma is missing at its end, before `2`"),
            ("{ a: 1 b: 2 }", "line 1: a comma is missing before `b`"),
            ("{\n a: { b: 1 }, // c\n", "line 1: the `{` is not closed: the file ends without its `}`"),
            ("{ a: [1,\n2,\n", "line 1: the `[` is not closed: the file ends without its `]`"),
            ("{ a: [1, 2}", "line 1: `}` does not fit the `[` of line 1"),
            ("{ a: 1 }\n}", "line 2: `}` follows the end of the configuration; is there a bracket too many before it?"),
            ("{\n a 1 }", "line 2: a colon is missing after `a`"),
            ("{ a: tru }", "line 1: `tru` is neither a number nor true, false or null; a text needs quotes: \"tru\""),
            ("{ a: tcp/127.0.0.1 }", "line 1: `tcp/127.0.0.1` is neither a number nor true, false or null; a text needs quotes: \"tcp/127.0.0.1\""),
            ("{ a: \"x }\n", "line 1: the text that begins with \" has no closing \""),
            ("{ a: }", "line 1: the value of `a` is missing before `}`"),
            ("{\n\"a\":", "line 2: the file ends where the value of `\"a\"` is expected"),
            ("{ a: 1,, }", "line 1: the name of a setting is expected, not `,`"),
            ("/* {", "line 1: the comment /* has no closing */"),
            ("[]", "line 1: a configuration is an object in braces, { ... }"),
            ("7", "line 1: a configuration is an object in braces, { ... }"),
        ] {
            assert_eq!(problem(text).as_deref(), Some(expected), "{text}");
        }
        let deep = format!("{{ a: {}", "[".repeat(100_000));
        assert!(problem(&deep).is_some_and(|what| what.contains("too many brackets")));
    }

    #[test]
    fn accepts_json5_and_cuts_of_it_are_explained() {
        let valid = "// c\n{ a: 'x\\'y', \"b\": [1, -2.5e3, .5, 0xff, +Infinity,], /* ä */ c: { d: null, }, \
                     e: \"two \\\nlines\" }";
        assert_eq!(problem(valid), None);
        for shipped in ["robot", "base-station", "simulation", "cloud"] {
            let path = format!("{}/../config/{shipped}.json5", env!("CARGO_MANIFEST_DIR"));
            let text =
                std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{path}: {error}"));
            assert_eq!(problem(&text), None, "{path}");
            let last = text.rfind('}').expect("an object");
            for (end, _) in text[..last].char_indices().step_by(7) {
                assert!(problem(&text[..end]).is_some(), "{path} until byte {end}");
            }
        }
    }

    #[test]
    fn errors_about_values_name_the_line() {
        let error = "JSON error: Message { msg: \"unknown field `a`, expected \\\"b\\\"\", location: Some(Location { line: 27, column: 5 }) }";
        let shown = value_problem(error);
        assert_eq!(
            shown.as_deref(),
            Some("line 27: unknown field `a`, expected \"b\"")
        );
        assert_eq!(value_problem("YAML error: x"), None);
    }
}
