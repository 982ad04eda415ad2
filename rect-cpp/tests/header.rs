//! That `include/rect.h` is what the sources say.
//!
//!     cargo test -p rect-cpp --test header
//!     RECT_UPDATE_DOCS=1 cargo test -p rect-cpp --test header    # writes it anew; look at the diff
use std::{fs, path::Path};

#[test]
fn the_header_is_what_the_sources_say() {
    let crate_ = Path::new(env!("CARGO_MANIFEST_DIR"));
    let config = cbindgen::Config::from_file(crate_.join("cbindgen.toml")).expect("the settings");
    let builder = cbindgen::Builder::new()
        .with_crate(crate_)
        .with_config(config);
    let mut written = Vec::new();
    builder.generate().expect("the header").write(&mut written);
    let written = String::from_utf8(written).expect("text");
    let path = crate_.join("include/rect.h");
    if std::env::var_os("RECT_UPDATE_DOCS").is_some() {
        fs::write(&path, &written).expect("written");
    }
    let there = fs::read_to_string(&path).unwrap_or_default();
    assert!(
        there == written,
        "include/rect.h is not what the sources say: RECT_UPDATE_DOCS=1 cargo test -p rect-cpp --test header"
    );
}
