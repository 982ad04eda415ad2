//! Provides the version texts for `--version` and the log.

/// The short version for `-V`. The version of Zenoh is pinned in Cargo.toml.
pub const SHORT: &str = concat!(env!("CARGO_PKG_VERSION"), " (zenoh 1.10.2)");

/// Returns the long version for `--version`, with the compiler and the features of Zenoh, which must be the same in a plugin.
pub fn long() -> String {
    format!(
        "{SHORT} built with {}\nzenoh features:{}",
        env!("RUSTC_VERSION"),
        zenoh::FEATURES
    )
}
