//! Extends a Zenoh router with RECT's named connections, registry and limits. Both hosts use this library: the program
//! `rect-router` (`main.rs`) and the plugin for a stock zenohd (`plugin/`).

pub mod args;
mod catalogue;
pub mod commands;
pub mod config;
mod config_service;
pub mod connections;
pub mod doctor;
pub mod limits;
pub mod links;
pub mod logging;
pub mod memory;
mod paths;
pub mod privileges;
pub mod registry;
mod reply;
pub mod robot_services;
pub mod router;
mod self_check;
mod sessions;
mod signals;
mod state;
pub mod status;
pub mod threads;
mod topics;
pub mod version;
