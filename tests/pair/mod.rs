//! Two robots' programs in one process, linked over TCP.
#![allow(dead_code)] // each test file uses its part

use std::{net::TcpListener, time::Duration};

use rect::{Options, Robot};

/// No step of any test takes this long, not even on a busy machine.
pub const PATIENCE: Duration = Duration::from_secs(30);

/// A port of this computer that is free now.
pub fn free_endpoint() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    format!("tcp/{}", listener.local_addr().expect("bound"))
}

/// A program that listens there, without a login.
pub async fn listening(name: &str, endpoint: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options.listen(endpoint).connect().await.expect("joined")
}

/// One that dials there.
pub async fn dialling(name: &str, endpoint: &str) -> Robot {
    let options = Options::new(name).expect("a name").login_file("/none");
    options.endpoint(endpoint).connect().await.expect("joined")
}

/// Two that know of each other.
pub async fn pair(one: &str, other: &str) -> (Robot, Robot) {
    let endpoint = free_endpoint();
    let one = listening(one, &endpoint).await;
    let other = dialling(other, &endpoint).await;
    let met = async {
        while one.peers().await.expect("asked").is_empty()
            || other.peers().await.expect("asked").is_empty()
        {
            tokio::time::sleep(Duration::from_millis(10)).await;
        }
    };
    tokio::time::timeout(PATIENCE, met)
        .await
        .expect("linked in time");
    (one, other)
}
