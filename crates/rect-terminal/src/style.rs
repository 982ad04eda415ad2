//! Decides whether output is coloured, and adds the colours.
use std::{
    env,
    io::{self, IsTerminal},
    sync::atomic::{AtomicU8, Ordering},
};

use rect_core::log::level::Level;

/// When output is coloured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Colours {
    /// On a terminal whose `TERM` is set and not `dumb`, or if the environment variable `CLICOLOR_FORCE` is set and not
    /// `0`. Never if `NO_COLOR` is set.
    #[default]
    Auto,
    /// Always.
    Always,
    /// Never.
    Never,
}

/// The meaning of a text, which determines its colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A good state, in green.
    Good,
    /// A state that works but could be better, in yellow.
    Poor,
    /// An error, in red.
    Wrong,
    /// A heading, in bold.
    Heading,
    /// A name that stands out, such as a topic, in cyan.
    Name,
    /// A detail, such as a time, dimmed.
    Faint,
}

impl Style {
    /// Returns the meaning of a level; `None` for that of usual events.
    pub fn of_level(level: Level) -> Option<Self> {
        match level {
            Level::Debug => Some(Self::Faint),
            Level::Info => None,
            Level::Warn => Some(Self::Poor),
            Level::Error => Some(Self::Wrong),
        }
    }
}

const AUTO: u8 = 0;
const ALWAYS: u8 = 1;
const NEVER: u8 = 2;
/// The user's choice on the command line.
static CHOICE: AtomicU8 = AtomicU8::new(AUTO);

/// Sets when output is coloured, for the whole program.
pub fn choose_colours(colours: Colours) {
    let choice = match colours {
        Colours::Auto => AUTO,
        Colours::Always => ALWAYS,
        Colours::Never => NEVER,
    };
    CHOICE.store(choice, Ordering::Relaxed);
}

/// Returns the environment variable and its value that pass the choice on the command line to a child process, or
/// `None` for [`Colours::Auto`].
pub fn colours_by_environment() -> Option<(&'static str, &'static str)> {
    match CHOICE.load(Ordering::Relaxed) {
        ALWAYS => Some(("CLICOLOR_FORCE", "1")),
        NEVER => Some(("NO_COLOR", "1")),
        _ => None,
    }
}

/// Returns the text in its colour, for the standard output.
pub fn paint(style: Style, text: &str) -> String {
    painted(style, text, has_colours(io::stdout().is_terminal()))
}

/// Returns the text in its colour, for stderr.
pub fn paint_err(style: Style, text: &str) -> String {
    painted(style, text, colours_on_stderr())
}

/// Returns whether output to stderr is coloured.
pub fn colours_on_stderr() -> bool {
    has_colours(io::stderr().is_terminal())
}

pub(super) fn painted(style: Style, text: &str, has_colours: bool) -> String {
    if !has_colours || text.is_empty() {
        return text.to_owned();
    }
    let code = match style {
        Style::Good => 32,
        Style::Poor => 33,
        Style::Wrong => 31,
        Style::Heading => 1,
        Style::Name => 36,
        Style::Faint => 2,
    };
    format!("\x1b[{code}m{text}\x1b[0m")
}

pub(super) fn has_colours(is_terminal: bool) -> bool {
    let is_enabled =
        |name: &str| env::var_os(name).is_some_and(|value| !value.is_empty() && value != "0");
    match CHOICE.load(Ordering::Relaxed) {
        ALWAYS => true,
        NEVER => false,
        _ if env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty()) => false,
        _ if is_enabled("CLICOLOR_FORCE") => true,
        _ => is_terminal && env::var_os("TERM").is_some_and(|term| term != "dumb"),
    }
}
