//! Passes the compiler's version to the program, because zenohd accepts a plugin only from the same compiler.
fn main() {
    let rustc = rustc_version::version_meta().map_or_else(
        |_| "an unknown rustc".to_owned(),
        |meta| meta.short_version_string,
    );
    println!("cargo:rustc-env=RUSTC_VERSION={rustc}");
    println!("cargo:rerun-if-changed=build.rs");
}
