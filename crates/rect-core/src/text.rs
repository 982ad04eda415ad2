//! Contains texts for people: texts of others that are safe to print, and formats of sizes, durations, reasons and lists of names.
pub mod display;
pub mod humanize;
pub mod names;
