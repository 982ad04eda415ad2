//! Checks that `include/rect.h` matches the Rust sources.
//!
//!     cargo test -p rect-cpp --test header
//!     RECT_UPDATE_DOCS=1 cargo test -p rect-cpp --test header    # regenerates it; review the diff
use std::{fs, path::Path};

#[test]
fn header_matches_the_sources() {
    let crate_ = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(crate_.join("cbindgen.toml")).expect("valid settings");
    let builder = cbindgen::Builder::new()
        .with_crate(crate_)
        .with_config(config);
    let mut written = Vec::new();
    builder.generate().expect("a header").write(&mut written);
    let written = String::from_utf8(written).expect("UTF-8");
    let path = crate_.join("include/rect.h");
    if std::env::var_os("RECT_UPDATE_DOCS").is_some() {
        fs::write(&path, &written).expect("a writable file");
    }
    let current = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        current == written,
        "include/rect.h does not match the sources; run RECT_UPDATE_DOCS=1 cargo test -p rect-cpp --test header"
    );
}
