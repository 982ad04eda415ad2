//! Sets the soname of the shared library, by which programs find it: its file has another name in cargo's target folder.
fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let major = std::env::var("CARGO_PKG_VERSION_MAJOR").unwrap_or_default();
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,librect.so.{major}");
}
