//! Tests that measure the time of the computer: streams and transfers. They are a program of their own, so that no other test
//! takes their processor time: `cargo test -p rect-robot --test timing`
#[path = "../pair/mod.rs"]
mod pair;
mod stream;
mod transfer;
mod wire;
