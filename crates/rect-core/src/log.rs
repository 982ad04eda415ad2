//! The lines that the programs of a robot log: which of them its router keeps, and how others read them.
//!
//! A program gives its lines to the router of its robot ([`outbox`]), which keeps the last ones of each program, also after its end
//! ([`keeper`]). Others ask for them, newest first, and follow new ones ([`reader`]). Nothing crosses a link unless somebody reads.
//!
//! | key | contents |
//! |---|---|
//! | `<fleet>/<robot>/@rect/@set/log/<program>` | lines for the router, a [`Batch`](batch::Batch) |
//! | `<fleet>/<robot>/@rect/@log` | queries: a [`Question`](page::Question), answered with a [`Page`](page::Page) |
//! | `<fleet>/<robot>/@rect/@log/<level>/<program>` | publications: new lines, as a [`Page`](page::Page) |
//! | `<fleet>/<robot>/@rect/@log/@private...` | the same with private lines, which access control keeps on the robot |
pub mod batch;
pub mod clean;
pub mod keeper;
pub mod level;
pub mod line;
pub mod outbox;
pub mod page;
pub mod reader;
pub mod seen;
#[cfg(test)]
mod tests;

use crate::{
    message::urgency::Qos,
    name::{key::KeySpace, Name},
};

/// The maximum number of lines that a router keeps of one program.
pub const MAX_LINES: usize = 1000;
/// The maximum size of the lines that a router keeps of all programs of its robot, in bytes.
pub const MAX_BYTES: usize = 2 << 20;
/// The maximum number of programs of which a router keeps lines.
pub const MAX_PROGRAMS: usize = 64;
/// The maximum number of lines that one reader asks for.
pub const MAX_LAST: usize = 10_000;
/// The name under which the lines of programs without a name are kept.
pub const UNNAMED: &str = "unnamed";

/// The part after `@rect/` of the keys at which a program gives lines to its router.
const GIVEN: &str = "@set/log";
/// The part after `@rect/` of the keys at which lines are read.
const READ: &str = "@log";
/// The same for private lines.
const READ_PRIVATE: &str = "@log/@private";

/// Lines never delay anything else, and are dropped if there is no room; their numbers show that.
const QOS: Qos = Qos {
    priority: 7,
    express: false,
    droppable: true,
};

/// Returns the key at which lines of `robot`, or of all robots (`None`), are asked for.
fn read_key(place: &KeySpace, robot: Option<&Name>, is_private: bool) -> String {
    let rest = if is_private { READ_PRIVATE } else { READ };
    place.own(robot, rest)
}
