//! Tests the command `rect`, connected to robots in the test's own process: `cargo test -p rect-cli --test command`
#[path = "../../../rect/tests/pair/mod.rs"]
mod pair;
mod program;
mod recording;
mod tool;
