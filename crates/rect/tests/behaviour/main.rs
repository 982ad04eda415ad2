//! Tests what programs observe of the library, with robots in one process: `cargo test -p rect-robot --test behaviour`
#[path = "../pair/mod.rs"]
mod pair;
#[path = "../timing/wire/mod.rs"]
mod wire;

mod action;
mod blocked_link;
mod blocking;
mod codec;
mod joining;
mod log;
mod parameters;
mod program;
mod replies;
mod request;
mod retained;
mod retry;
mod safety;
mod session;
mod state;
mod typed;
mod udp;
mod user_program;
