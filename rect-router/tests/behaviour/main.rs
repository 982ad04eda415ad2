//! Tests what routers and their commands do, one module for each subject. They start programs and wait for what these
//! answer or log, so that they may run side by side: `cargo test -p rect-router --test behaviour`

#[path = "../support/mod.rs"]
mod support;

mod access;
mod any;
mod bad_input;
mod ble;
mod cloud;
mod commands;
mod config_files;
mod config_service;
mod connections;
mod examples;
mod first_start;
mod flags;
mod library;
mod logging;
mod names;
mod odd_files;
mod plugin;
mod replay;
mod running;
mod scenarios;
mod sniffer;
mod stock;
mod systemd_unit;
mod tool;
mod topics;
mod zenohd_with_ble;
