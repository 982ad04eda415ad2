//! A table for a terminal: it leaves out optional columns and shortens cells until its lines fit.
use std::io::{self, IsTerminal};

use unicode_width::UnicodeWidthStr;

use super::style::{has_colours, painted, Style};
use crate::core::display;

/// The space between two columns.
const GAP: usize = 2;
/// The width to which a column can shrink.
const LEAST_WIDTH: usize = 6;
/// Before each line of a note.
const NOTE_INDENT: usize = 4;
/// Takes the place of the rest of a shortened cell.
const ELLIPSIS: &str = "\u{2026}";

/// Rows below a heading.
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

/// One cell.
#[derive(Clone, Debug)]
pub struct Cell {
    text: String,
    style: Option<Style>,
}

impl Cell {
    /// A cell in the colour of `style`.
    pub fn styled(style: Style, text: impl AsRef<str>) -> Self {
        Self {
            style: Some(style),
            ..Self::from(text.as_ref())
        }
    }
}

impl From<&str> for Cell {
    /// An empty text is shown as `-`.
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
    /// A table with these columns. One whose name begins with `?` is left out where the terminal is too narrow, the last
    /// of them first.
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

    /// Adds a row with a cell for each column.
    pub fn row(&mut self, mut cells: Vec<Cell>) {
        cells.resize_with(self.columns.len(), || Cell::from(""));
        self.rows.push(Row::Cells(cells));
    }

    /// Adds a text of several words below the last row.
    pub fn note(&mut self, text: &str) {
        self.rows.push(Row::Note(display::line(text).into_owned()));
    }

    /// Prints the table, for a reader that may be gone.
    pub fn print(&self) {
        let has_colours = has_colours(io::stdout().is_terminal());
        for line in self.lines(super::width(), has_colours) {
            crate::outln!("{line}");
        }
    }

    /// The lines of the table, none wider than `width`.
    fn lines(&self, width: Option<usize>, has_colours: bool) -> Vec<String> {
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

    /// The columns that are shown, and how wide each is.
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
        // The widest column gives way, again and again.
        while widths.iter().sum::<usize>() + GAP * widths.len().saturating_sub(1) > width {
            match widths.iter_mut().max() {
                Some(widest) if *widest > LEAST_WIDTH => *widest -= 1,
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

/// One line; the last cell has no space after it.
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

/// The beginning of the text, if it is too wide.
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

/// The text in lines that begin with an indentation and fit.
fn wrapped(text: &str, width: Option<usize>) -> Vec<String> {
    let lines = wrap(text, width.map(|width| width.saturating_sub(NOTE_INDENT)));
    let indent = " ".repeat(NOTE_INDENT);
    lines.iter().map(|line| format!("{indent}{line}")).collect()
}

/// Returns the words of a text in lines of at most `width` columns; a word that is longer is shortened.
pub fn wrap(text: &str, width: Option<usize>) -> Vec<String> {
    let room = width.map_or(usize::MAX, |width| width.max(LEAST_WIDTH));
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
    fn without_a_terminal_everything_is_shown_on_one_line_each() {
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
    fn a_cell_cannot_break_out_of_its_line() {
        let mut table = Table::new(&["VERSION"]);
        table.row(vec!["v1\n\x1b[2Jwombat-9".into()]);
        table.note("a\nb");
        assert_eq!(
            table.lines(None, false),
            ["VERSION", "v1\u{fffd}\u{fffd}[2Jwombat-9", "    a\u{fffd}b"]
        );
    }

    #[test]
    fn colours_take_no_room() {
        let mut table = Table::new(&["STATE", "PEER"]);
        table.row(vec![
            Cell::styled(Style::Good, "connected"),
            "wombat-1".into(),
        ]);
        let lines = table.lines(Some(80), true);
        assert_eq!(lines[1], "\x1b[32mconnected\x1b[0m  wombat-1");
    }
}
