//! Terminal output of both programs, `rect` and `rect-router`: lines, colours and tables. Text that came from outside
//! is made safe by [`core::display`](crate::core::display).
//!
//! Neither program prints by `println!`, which panics once nobody reads the other end of a pipe: [`outln!`](crate::outln)
//! and [`errln!`](crate::errln) take its place.
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

/// The width of the terminal in columns; `None` if the standard output is not a terminal.
pub fn width() -> Option<usize> {
    let (terminal_size::Width(columns), _) = terminal_size::terminal_size_of(std::io::stdout())?;
    // A terminal that does not know its size reports 0.
    (columns > 0).then_some(usize::from(columns))
}
