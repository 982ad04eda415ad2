//! Checks that every protocol of stock Zenoh listens, connects and carries data through this crate:
//! `cargo test -p zenoh-link --test protocols`.

mod support;

use std::time::{Duration, Instant};

use support::{
    free_tcp_port, free_udp_port, no_vsock_loopback, path_in, Certificates, SerialCable,
};
use zenoh::{qos::CongestionControl, Config, Session};

/// Timeout far above the duration of any test.
const DEADLINE: Duration = Duration::from_secs(30);

#[tokio::test(flavor = "multi_thread")]
async fn tcp_carries_data() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_tcp_port());
    carries_data(&endpoint, &endpoint, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn udp_carries_data() {
    let endpoint = format!("udp/127.0.0.1:{}", free_udp_port());
    carries_data(&endpoint, &endpoint, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn ws_carries_data() {
    let endpoint = format!("ws/127.0.0.1:{}", free_tcp_port());
    carries_data(&endpoint, &endpoint, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn tls_carries_data() {
    carries_data_encrypted(&format!("tls/localhost:{}", free_tcp_port())).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn quic_carries_data() {
    carries_data_encrypted(&format!("quic/localhost:{}", free_udp_port())).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn quic_datagrams_carry_data() {
    carries_data_encrypted(&format!("quic/localhost:{}?rel=0", free_udp_port())).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn unixsock_stream_carries_data() {
    let dir = tempfile::tempdir().expect("a directory");
    let endpoint = format!("unixsock-stream/{}", path_in(dir.path(), "socket"));
    carries_data(&endpoint, &endpoint, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn unixpipe_carries_data() {
    let dir = tempfile::tempdir().expect("a directory");
    let endpoint = format!("unixpipe/{}", path_in(dir.path(), "pipe"));
    carries_data(&endpoint, &endpoint, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn serial_carries_data() {
    let cable = SerialCable::new();
    let [listen, connect] =
        // The listener is not ready at once, so the timeout `tout`, in microseconds, is long.
        cable.ends.each_ref().map(|end| format!("serial/{}#baudrate=115200;exclusive=false;tout=5000000", end.display()));
    carries_data(&listen, &connect, &[]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn vsock_carries_data() {
    if let Some(reason) = no_vsock_loopback() {
        println!("skipped: {reason}");
        return;
    }
    let endpoint = format!(
        "vsock/VMADDR_CID_LOCAL:{}",
        20_000 + u32::from(free_tcp_port())
    );
    carries_data(&endpoint, &endpoint, &[]).await;
}

/// Runs [`carries_data`] with certificates.
async fn carries_data_encrypted(endpoint: &str) {
    let certificates = Certificates::new();
    let settings = certificates.settings();
    carries_data(endpoint, endpoint, &[("transport/link/tls", &settings)]).await;
}

/// Asserts that a listening and a connecting session exchange a small message and one that needs fragments.
async fn carries_data(listen: &str, connect: &str, settings: &[(&str, &str)]) {
    let listener = session("peer", &[("listen/endpoints", &list(listen))], settings).await;
    let connector = session("client", &[("connect/endpoints", &list(connect))], settings).await;

    let protocol = listen.split('/').next().unwrap_or(listen);
    let links: Vec<String> = connector
        .info()
        .links()
        .await
        .map(|link| link.dst().to_string())
        .collect();
    assert!(
        links.iter().any(|l| l.starts_with(&format!("{protocol}/"))),
        "{protocol}: {links:?}"
    );

    // A serial line buffers 1500 bytes, and drops what arrives faster than it sends.
    let large = if protocol == "serial" { 4_000 } else { 100_000 };
    for size in [1, large] {
        assert_arrives(&connector, &listener, size).await;
        assert_arrives(&listener, &connector, size).await;
    }
}

async fn session(mode: &str, endpoints: &[(&str, &str)], settings: &[(&str, &str)]) -> Session {
    let mut config = Config::default();
    let mode = format!("'{mode}'");
    // Only the link under test: scouting is disabled.
    let alone = [
        ("mode", mode.as_str()),
        ("scouting/multicast/enabled", "false"),
        ("scouting/gossip/enabled", "false"),
        ("listen/endpoints", "[]"),
        ("connect/timeout_ms", "20000"),
    ];
    for (key, value) in alone.iter().chain(endpoints).chain(settings) {
        config
            .insert_json5(key, value)
            .unwrap_or_else(|error| panic!("{key} {value}: {error}"));
    }
    match tokio::time::timeout(DEADLINE, zenoh::open(config)).await {
        Ok(Ok(session)) => session,
        Ok(Err(error)) => panic!("{endpoints:?}: {error}"),
        Err(_) => panic!("{endpoints:?}: not open after {DEADLINE:?}"),
    }
}

/// Sends until the message arrives: some of these links may lose a message, and a subscription takes effect after a
/// moment.
async fn assert_arrives(from: &Session, to: &Session, size: usize) {
    let key = format!("test/{}/{size}", to.zid());
    let payload: Vec<u8> = (0..size).map(|i| (i % 251) as u8).collect();
    let subscriber = to.declare_subscriber(&key).await.expect("a subscription");
    let deadline = Instant::now() + DEADLINE;
    loop {
        assert!(Instant::now() < deadline, "{size} bytes do not arrive");
        from.put(&key, payload.clone())
            .congestion_control(CongestionControl::Block)
            .await
            .expect("a put");
        let arrival =
            tokio::time::timeout(Duration::from_millis(500), subscriber.recv_async()).await;
        if let Ok(sample) = arrival {
            let sample = sample.expect("the session is open");
            assert!(
                sample.payload().to_bytes() == payload,
                "{size} bytes arrive damaged"
            );
            return;
        }
    }
}

fn list(endpoint: &str) -> String {
    format!("['{endpoint}']")
}
