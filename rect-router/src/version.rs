//! What this program is made of, as `--version` and the log show it.

/// For `-V`. The zenoh in use is pinned in Cargo.toml.
pub const SHORT: &str = concat!(env!("CARGO_PKG_VERSION"), " (zenoh 1.10.2)");

/// For `--version`: with what a plugin must have in common with the router.
pub fn long() -> String {
    format!(
        "{SHORT} built with {}\nzenoh features:{}",
        env!("RUSTC_VERSION"),
        zenoh::FEATURES
    )
}
