//! Tests the command `rect`, connected to robots in the test's own process: `cargo test -p rect-cli --test command`
mod action;
mod log;
#[path = "../../../rect/tests/pair/mod.rs"]
mod pair;
mod parameter;
mod program;
mod recording;
mod stop;
mod tool;
