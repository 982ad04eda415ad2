//! Runs the MQTT broker: rumqttd with the settings of its example, without TLS.
use std::{
    collections::HashMap, fs, net::SocketAddr, net::TcpStream, os::fd::BorrowedFd, thread,
    time::Duration,
};

use rumqttd::{Broker, Config, ConnectionSettings, RouterConfig, ServerSettings};

use super::peer::Outcome;

pub fn run(address: SocketAddr) -> Outcome<()> {
    let connections = ConnectionSettings {
        connection_timeout_ms: 60_000,
        max_payload_size: 20_480,
        max_inflight_count: 100,
        auth: None,
        external_auth: None,
        dynamic_filters: true,
    };
    let server = ServerSettings {
        name: "v4-1".to_owned(),
        listen: address,
        tls: None,
        next_connection_delay_ms: 1,
        connections,
    };
    let router = RouterConfig {
        max_connections: 10_010,
        max_outgoing_packet_count: 200,
        max_segment_size: 104_857_600,
        max_segment_count: 10,
        ..RouterConfig::default()
    };
    let config = Config {
        id: 0,
        router,
        v4: Some(HashMap::from([("1".to_owned(), server)])),
        v5: None,
        ws: None,
        cluster: None,
        console: None,
        bridge: None,
        prometheus: None,
        metrics: None,
    };
    thread::spawn(move || {
        while !disable_nagle(address) {
            thread::sleep(Duration::from_millis(10));
        }
    });
    Ok(Broker::new(config).start()?)
}

/// Sets TCP_NODELAY on the broker's listener, as all other programs do: rumqttd does not set it and has no option for it.
/// On Linux accepted sockets inherit it. Returns `false` if the broker does not listen yet.
fn disable_nagle(address: SocketAddr) -> bool {
    let open = fs::read_dir("/proc/self/fd")
        .into_iter()
        .flatten()
        .flatten();
    let numbers = open.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    numbers.into_iter().any(|number: i32| {
        // SAFETY: the descriptor is only duplicated, at once; if it has been closed, duplicating fails.
        let borrowed = unsafe { BorrowedFd::borrow_raw(number) };
        borrowed.try_clone_to_owned().is_ok_and(|owned| {
            let socket = TcpStream::from(owned);
            socket.local_addr().is_ok_and(|local| local == address)
                && socket.set_nodelay(true).is_ok()
        })
    })
}
