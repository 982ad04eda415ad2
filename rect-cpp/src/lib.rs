//! The C interface of the Rust library, which `include/rect.h` declares. The C++ headers in `include/rect/` are based on it.
//!
//! No decisions are made here. Every `extern "C"` function is a shell: `boundary` stops panics and converts errors to codes,
//! `argument` checks what C passes, and a safe function does the work. Objects are kept in a table (`handle`), and C refers
//! to them by numbers. The structs that C receives (`message`, `frame` and so on) point into these objects. An `unsafe`
//! function requires that its caller follows the rules at the top of rect.h: pointers are NULL, or valid for the duration of
//! the call.
mod action;
mod action_run;
mod alert;
mod argument;
mod array;
mod boundary;
mod callback;
mod cancellable;
mod catalogue;
mod codec;
mod connection;
mod deadman;
mod declared_parameters;
mod dictionary;
mod event;
mod failure;
mod frame;
mod gathered;
mod handle;
mod log;
mod logs;
mod message;
mod name;
mod options;
mod parameter_values;
mod parameters;
mod payload;
mod picture;
mod program;
mod publisher;
mod recorder;
mod reply;
mod robot;
mod sender_counts;
mod service;
mod state;
mod stop;
mod stream;
mod subscriber;
mod subscription;
mod text;
mod transfer;
mod urgency;
mod watch;
