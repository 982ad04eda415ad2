//! Prints lines of logs.
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use rect::{KeptLine, Level, Name};
use rect_core::text::display;
use rect_terminal::{clock, paint, Style};
use serde_json::json;

/// The lines after which dates are shown with the times.
const A_DAY: Duration = Duration::from_secs(24 * 3600);

/// Which lines are printed.
pub struct Selection {
    pub program: Option<Name>,
    pub level: Level,
    /// A text in lower case that they contain.
    pub text: Option<String>,
    pub last: usize,
}

/// Prints lines in one form.
pub struct Printer {
    is_json: bool,
    shows_robot: bool,
    selection: Selection,
}

impl Printer {
    pub fn new(is_json: bool, shows_robot: bool, selection: Selection) -> Self {
        Self {
            is_json,
            shows_robot,
            selection,
        }
    }

    /// Returns the lines among those of a robot that are to be printed, in their order.
    pub fn last<'a>(
        &self,
        lines: impl DoubleEndedIterator<Item = &'a KeptLine>,
    ) -> Vec<&'a KeptLine> {
        let selected = lines.rev().filter(|kept| self.selects(kept));
        let mut selected: Vec<_> = selected.take(self.selection.last).collect();
        selected.reverse();
        selected
    }

    fn selects(&self, kept: &KeptLine) -> bool {
        let Selection {
            program,
            level,
            text,
            ..
        } = &self.selection;
        let is_program = |name: &Name| name.as_str() == kept.program;
        let has_text = |text: &String| kept.line.text.to_lowercase().contains(text);
        kept.line.level >= *level
            && program.as_ref().is_none_or(is_program)
            && text.as_ref().is_none_or(has_text)
    }

    /// Prints a line, unless its text is not asked for.
    pub fn print(&self, robot: &Name, kept: &KeptLine) {
        if !self.selects(kept) {
            return;
        }
        if self.is_json {
            let mut document = json!(kept);
            document["robot"] = json!(robot.as_str());
            // A document of texts and numbers can be written.
            let _ = rect_terminal::json_line(&document);
            return;
        }
        let line = &kept.line;
        let program = match self.shows_robot {
            true => format!("{robot}/{}", kept.program),
            false => kept.program.clone(),
        };
        let level = format!("{:<5}", line.level);
        let level = match Style::of_level(line.level) {
            Some(style) => paint(style, &level),
            None => level,
        };
        let mut details = String::new();
        for (name, value) in &line.fields {
            details.push_str(&format!(" {name}={value}"));
        }
        if !line.source.is_empty() {
            details.push_str(&format!(" ({})", line.source));
        }
        let logger = match line.logger.as_str() {
            "" | "stdout" | "stderr" => String::new(),
            logger => format!("{logger}: "),
        };
        rect_terminal::outln!(
            "{} {level} {} {}{}{}",
            paint(Style::Faint, &time(line.at)),
            paint(Style::Name, &program),
            paint(Style::Faint, &logger),
            display::paragraph(&line.text),
            paint(Style::Faint, &display::line(&details)),
        );
    }
}

/// Returns the time of day, with the date if that is not today's.
fn time(at_ms: u64) -> String {
    let at = UNIX_EPOCH + Duration::from_millis(at_ms);
    let time = clock::time_of_day(at);
    let date = clock::date(at);
    let now = SystemTime::now();
    let is_near = now.duration_since(at).is_ok_and(|age| age < A_DAY);
    if is_near && date == clock::date(now) {
        return time;
    }
    format!("{date} {time}")
}
