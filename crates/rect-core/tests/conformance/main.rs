//! Runs what every language must pass: the test vectors in `tests/conformance/*.json`, and the scenarios of the drivers in
//! `tests/conformance/drivers/`: `cargo test -p rect-core --test conformance`
mod drivers;
mod vectors;

/// The folder of the vectors, which Python and C++ read, too.
const FOLDER: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/conformance");
