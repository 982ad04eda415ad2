//! Creates pairs of robots in one process, linked over TCP.
#![allow(dead_code)] // each test file uses a part of this module

use std::{net::TcpListener, time::Duration};

use rect::{Options, Robot};
use zenoh::Wait;

/// Timeout of one step of a test, long enough for a busy computer.
pub const TIMEOUT: Duration = Duration::from_secs(30);

/// Returns a TCP endpoint with a free port of this computer.
pub fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    format!("tcp/{}", listener.local_addr().expect("bound"))
}

/// Connects a robot that accepts links at `endpoint`.
pub async fn listening(name: &str, endpoint: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options.listen(endpoint).connect().await.expect("connected")
}

/// Connects a robot that dials `endpoint`.
pub async fn dialling(name: &str, endpoint: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options
        .endpoint(endpoint)
        .connect()
        .await
        .expect("connected")
}

/// Connects a stock Zenoh client to `endpoint`.
pub fn stock_client(endpoint: &str) -> zenoh::Session {
    let mut config = zenoh::Config::default();
    let settings = [
        ("mode", "\"client\"".to_owned()),
        ("connect/endpoints", format!("[\"{endpoint}\"]")),
    ];
    for (key, value) in settings {
        config.insert_json5(key, &value).expect("a setting");
    }
    zenoh::open(config).wait().expect("connected")
}

/// Returns two linked robots that have discovered each other.
pub async fn pair(one: &str, other: &str) -> (Robot, Robot) {
    let endpoint = free_endpoint();
    let one = listening(one, &endpoint).await;
    let other = dialling(other, &endpoint).await;
    let discovered = async {
        while one.peers().await.expect("asked").is_empty()
            || other.peers().await.expect("asked").is_empty()
        {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(TIMEOUT, discovered)
        .await
        .expect("linked in time");
    (one, other)
}
