//! Sets the soname of the shared library to `librect.so.<major>`, the name by which programs load it. In cargo's target
//! folder the file has another name.
fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    let major = std::env::var("CARGO_PKG_VERSION_MAJOR").unwrap_or_default();
    println!("cargo:rustc-cdylib-link-arg=-Wl,-soname,librect.so.{major}");
}
