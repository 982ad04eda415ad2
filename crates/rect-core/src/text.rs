//! Contains texts for people: texts of others that are safe to print, and formats of sizes, durations and reasons.
pub mod display;
pub mod humanize;
