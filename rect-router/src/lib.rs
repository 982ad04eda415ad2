//! What RECT makes of a Zenoh router, for its two hosts: `rect-router` (`main.rs`) and the plugin in a stock zenohd
//! (`plugin/`). A robot's named connections and its registry are one code for both.

pub mod args;
pub mod commands;
pub mod config;
mod config_service;
pub mod connections;
pub mod limits;
pub mod logging;
pub mod registry;
mod regular_file;
pub mod robot;
pub mod router;
mod signals;
pub mod status;
pub mod threads;
mod topics;
pub mod version;
