//! The C ABI of the Rust library: all that `include/rect.h` declares. `include/rect/` are the C++ headers on top of it.
//!
//! Nothing is decided here. Every `extern "C"` function is a shell: `boundary` stops panics and turns errors into codes,
//! `argument` checks what C gives, and a safe function does it. Objects live in a table (`handle`), from where C has their
//! numbers; what C is shown of them (`message`, `frame`, ...) points into them. Where a function is `unsafe`, its caller has
//! to give what rect.h says: pointers that are NULL, or point to what their type says for as long as the call takes.
mod argument;
mod array;
mod boundary;
mod callback;
mod codec;
mod connection;
mod dictionary;
mod failure;
mod frame;
mod handle;
mod message;
mod name;
mod options;
mod payload;
mod picture;
mod program;
mod reply;
mod robot;
mod service;
mod state;
mod stream;
mod subscriber;
mod subscription;
mod text;
mod transfer;
mod waiting;
mod watch;
