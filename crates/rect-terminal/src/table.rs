//! Renders tables for a terminal. If the lines are wider than the terminal, optional columns are left out, and then
//! cells are shortened.
use std::io::{self, IsTerminal};

use rect_core::text::display;
use unicode_width::UnicodeWidthStr;

use crate::style::{has_colours, painted, Style};

/// Number of spaces between two columns.
const GAP: usize = 2;
/// Smallest width of a shortened column.
const MIN_WIDTH: usize = 6;
/// Number of spaces before each line of a note.
const NOTE_INDENT: usize = 4;
/// Replaces the rest of a shortened cell.
const ELLIPSIS: &str = "\u{2026}";

/// A table with a heading, rows and notes.
#[derive(Clone, Debug)]
pub struct Table {
    columns: Vec<Column>,
    rows: Vec<Row>,
}

#[derive(Clone, Debug)]
struct Column {
    name: &'static str,
    is_optional: bool,
}

#[derive(Clone, Debug)]
enum Row {
    Cells(Vec<Cell>),
    Note(String),
}

/// A cell of a table. Control characters in its text are replaced.
#[derive(Clone, Debug)]
pub struct Cell {
    text: String,
    style: Option<Style>,
}

impl Cell {
    /// Creates a cell in the colour of `style`.
    pub fn styled(style: Style, text: impl AsRef<str>) -> Self {
        Self {
            style: Some(style),
            ..Self::from(text.as_ref())
        }
    }
}

impl From<&str> for Cell {
    /// Creates a cell; an empty text is shown as `-`.
    fn from(text: &str) -> Self {
        let text = if text.is_empty() { "-" } else { text };
        Self {
            text: display::line(text).into_owned(),
            style: None,
        }
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::from(text.as_str())
    }
}

impl From<Option<String>> for Cell {
    fn from(text: Option<String>) -> Self {
        Self::from(text.unwrap_or_default())
    }
}

impl Table {
    /// Creates a table with the given column names. A column whose name begins with `?` is optional: if the terminal is too
    /// narrow, optional columns are left out, starting with the last one.
    pub fn new(names: &[&'static str]) -> Self {
        let columns = names.iter().map(|&name| match name.strip_prefix('?') {
            Some(name) => Column {
                name,
                is_optional: true,
            },
            None => Column {
                name,
                is_optional: false,
            },
        });
        Self {
            columns: columns.collect(),
            rows: Vec::new(),
        }
    }

    /// Adds a row with a cell for each column. Missing cells are shown as `-`, and surplus ones are ignored.
    pub fn row(&mut self, mut cells: Vec<Cell>) {
        cells.resize_with(self.columns.len(), || Cell::from(""));
        self.rows.push(Row::Cells(cells));
    }

    /// Adds a text below the last row, which is wrapped at the width of the terminal.
    pub fn note(&mut self, text: &str) {
        self.rows.push(Row::Note(display::line(text).into_owned()));
    }

    /// Prints the table with [`outln!`](crate::outln).
    pub fn print(&self) {
        let has_colours = has_colours(io::stdout().is_terminal());
        for line in self.lines(crate::width(), has_colours) {
            crate::outln!("{line}");
        }
    }

    /// Returns the lines of the table, no wider than `width` unless it is too narrow for the shortest possible cells.
    pub(crate) fn lines(&self, width: Option<usize>, has_colours: bool) -> Vec<String> {
        let (shown, widths) = self.layout(width);
        let mut lines = Vec::with_capacity(self.rows.len() + 1);
        let heading = shown
            .iter()
            .map(|&n| (self.columns[n].name, Some(Style::Heading)));
        lines.push(joined(heading, &widths, has_colours));
        for row in &self.rows {
            match row {
                Row::Cells(cells) => {
                    let cells = shown
                        .iter()
                        .map(|&n| (cells[n].text.as_str(), cells[n].style));
                    lines.push(joined(cells, &widths, has_colours));
                }
                Row::Note(text) => lines.extend(wrapped(text, width)),
            }
        }
        lines
    }

    /// Returns the indices of the shown columns, and their widths.
    fn layout(&self, width: Option<usize>) -> (Vec<usize>, Vec<usize>) {
        let mut shown: Vec<usize> = (0..self.columns.len()).collect();
        let natural: Vec<usize> = shown.iter().map(|&n| self.natural_width(n)).collect();
        let total = |shown: &[usize], widths: &dyn Fn(usize) -> usize| {
            let gaps = GAP * shown.len().saturating_sub(1);
            shown.iter().map(|&n| widths(n)).sum::<usize>() + gaps
        };
        let Some(width) = width else {
            return (shown, natural);
        };
        while total(&shown, &|n| natural[n]) > width {
            let Some(last) = shown.iter().rposition(|&n| self.columns[n].is_optional) else {
                break;
            };
            shown.remove(last);
        }
        let mut widths: Vec<usize> = shown.iter().map(|&n| natural[n]).collect();
        // The widest column is shortened by one character at a time until the line fits.
        while widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1) > width {
            match widths.iter_mut().max() {
                Some(widest) if *widest > MIN_WIDTH => *widest -= 1,
                _ => break,
            }
        }
        (shown, widths)
    }

    fn natural_width(&self, column: usize) -> usize {
        let cells = self.rows.iter().filter_map(|row| match row {
            Row::Cells(cells) => Some(cells[column].text.width()),
            Row::Note(_) => None,
        });
        cells.fold(self.columns[column].name.width(), usize::max)
    }
}

/// Returns the cells as one line, without spaces after the last cell.
fn joined<'a>(
    cells: impl Iterator<Item = (&'a str, Option<Style>)>,
    widths: &[usize],
    has_colours: bool,
) -> String {
    let mut line = String::new();
    for (n, ((text, style), &width)) in cells.zip(widths).enumerate() {
        let text = shortened(text, width);
        line.push_str(&match style {
            Some(style) => painted(style, &text, has_colours),
            None => text.clone(),
        });
        if n + 1 < widths.len() {
            let padding = width.saturating_sub(text.width()) + GAP;
            line.extend(std::iter::repeat_n(' ', padding));
        }
    }
    line
}

/// Returns the text, cut to `width` columns if it is wider.
fn shortened(text: &str, width: usize) -> String {
    if text.width() <= width {
        return text.to_owned();
    }
    let mut short = String::new();
    for c in text.chars() {
        if short.width() + c.to_string().width() + ELLIPSIS.width() > width {
            break;
        }
        short.push(c);
    }
    short + ELLIPSIS
}

/// Returns a note as indented lines that fit `width`.
fn wrapped(text: &str, width: Option<usize>) -> Vec<String> {
    let lines = wrap(text, width.map(|width| width.saturating_sub(NOTE_INDENT)));
    let indent = " ".repeat(NOTE_INDENT);
    lines.iter().map(|line| format!("{indent}{line}")).collect()
}

/// Returns the words of a text in lines of at most `width` columns, or in one line if `width` is `None`. A longer word
/// is shortened. A width below 6 counts as 6.
pub fn wrap(text: &str, width: Option<usize>) -> Vec<String> {
    let room = width.map_or(usize::MAX, |width| width.max(MIN_WIDTH));
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let word = shortened(word, room);
        match lines.last_mut() {
            Some(line) if line.is_empty() => line.push_str(&word),
            Some(line) if line.width() + 1 + word.width() <= room => {
                line.push(' ');
                line.push_str(&word);
            }
            _ => lines.push(word),
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new(&["NAME", "ADDRESS", "?SIGNAL", "?SENT"]);
        let address = "tcp/a-very-long-host-name.example.org:7447";
        table.row(vec![
            "radio".into(),
            "wombat-1".into(),
            "-60 dBm".into(),
            "12 kB".into(),
        ]);
        table.row(vec![
            "base".into(),
            address.into(),
            "".into(),
            "900 B".into(),
        ]);
        table.note("cannot connect to wombat-1: no advertisement was received within 8 s on hci0");
        table
    }

    #[test]
    fn rows_are_printed_in_full_without_a_terminal() {
        let lines = table().lines(None, false);
        assert_eq!(lines.len(), 4, "{lines:#?}");
        assert!(
            lines[0].contains("SIGNAL") && lines[0].ends_with("SENT"),
            "{lines:#?}"
        );
        assert!(lines[2].contains("example.org:7447  -  "), "{lines:#?}");
    }

    #[test]
    fn no_line_is_wider_than_the_terminal() {
        for width in [30, 40, 60, 80] {
            for line in table().lines(Some(width), false) {
                assert!(line.width() <= width, "{width}: {line}");
            }
        }
    }

    #[test]
    fn optional_columns_are_left_out_before_cells_are_shortened() {
        let lines = table().lines(Some(60), false);
        assert!(
            lines[0].contains("SIGNAL") && !lines[0].contains("SENT"),
            "{lines:#?}"
        );
        assert!(lines[2].contains("example.org:7447"), "{lines:#?}");
        let narrow = table().lines(Some(40), false);
        assert!(!narrow[0].contains("SIGNAL"), "{narrow:#?}");
        assert!(narrow[2].ends_with(ELLIPSIS), "{narrow:#?}");
    }

    #[test]
    fn control_characters_in_cells_are_replaced() {
        let mut table = Table::new(&["VERSION"]);
        table.row(vec!["v1\n\x1b[2Jwombat-9".into()]);
        table.note("a\nb");
        assert_eq!(
            table.lines(None, false),
            ["VERSION", "v1\u{fffd}\u{fffd}[2Jwombat-9", "    a\u{fffd}b"]
        );
    }

    #[test]
    fn colour_codes_do_not_count_as_width() {
        let mut table = Table::new(&["STATE", "PEER"]);
        table.row(vec![
            Cell::styled(Style::Good, "connected"),
            "wombat-1".into(),
        ]);
        let lines = table.lines(Some(80), true);
        assert_eq!(lines[1], "\x1b[32mconnected\x1b[0m  wombat-1");
    }
}
