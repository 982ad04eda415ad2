//! Prints lines, colours and tables for the programs `rect` and `rect-router`. Text from other robots has to pass
//! [`core::display`](rect_core::text::display) first, which replaces control characters.
//!
//! The programs use [`outln!`](crate::outln) and [`errln!`](crate::errln) instead of `println!` and `eprintln!`, which panic
//! if the reading end of a pipe is closed.
pub mod clock;
mod connections;
mod output;
mod style;
mod table;

pub use connections::{connections_of_robot, connections_of_robots};
pub use output::{json, json_line, try_write, write_err, write_out, CLOSED_PIPE};
pub use style::{
    choose_colours, colours_by_environment, colours_on_stderr, paint, paint_err, Colours, Style,
};
pub use table::{wrap, Cell, Table};

/// Returns the width of the terminal in columns, or `None` if the standard output is not a terminal.
pub fn width() -> Option<usize> {
    let (terminal_size::Width(columns), _) = terminal_size::terminal_size_of(std::io::stdout())?;
    // A terminal of unknown size reports 0.
    (columns > 0).then_some(usize::from(columns))
}
