//! Programs of the library `rect` at a test's routers.
use rect::{Options, Robot};

/// A program of that robot's at its router.
pub async fn joined(name: &str, router: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options.router(router).connect().await.expect("joined")
}
