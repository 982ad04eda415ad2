//! Connects programs of the library `rect` to the routers of a test.
use rect::{Options, Robot};

/// Connects a program to the router of its robot.
pub async fn joined(name: &str, router: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options.router(router).connect().await.expect("joined")
}
