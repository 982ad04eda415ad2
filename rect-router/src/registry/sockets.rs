//! Reads the kernel's traffic counters and round-trip times of TCP links, as `ss --info` does (sock_diag(7)).
//!
//! The counters cover dialled and accepted links, and the links of a plugin's host. The kernel replies at once, and only
//! knows the sockets of this computer.
use std::{
    io,
    net::{IpAddr, SocketAddr},
};

use netlink_packet_core::{NetlinkMessage, NetlinkPayload, NLM_F_REQUEST};
use netlink_packet_sock_diag::{
    constants::{AF_INET, AF_INET6, IPPROTO_TCP},
    inet::{nlas::Nla, ExtensionFlags, InetRequest, SocketId, StateFlags},
    SockDiagMessage,
};
use netlink_sys::{protocols::NETLINK_SOCK_DIAG, Socket, SocketAddr as Netlink};
use rect_core::registry::connection::Traffic;
use zenoh::session::Link;

use super::LinkTraffic;

/// Methods that use a TCP socket.
const TCP_METHODS: [&str; 3] = ["tcp", "tls", "ws"];
/// Size of the buffer for a reply, larger than any reply.
const MAX_REPLY_BYTES: usize = 4096;
/// Offsets of fields in `struct tcp_info` of linux/tcp.h, in bytes. New kernels only append fields; the last two of these
/// exist since Linux 4.1.
const ROUND_TRIP_US: usize = 68;
const BYTES_ACKED: usize = 120;
const BYTES_RECEIVED: usize = 128;

/// A netlink socket for requests to the kernel; `None` if there are no counters.
pub struct Sockets(Option<Socket>);

impl Sockets {
    /// Opens a netlink socket. If that fails, no traffic is reported.
    pub fn open() -> Self {
        let socket = open().inspect_err(|error| {
            tracing::debug!("no traffic of TCP links: cannot open a netlink socket: {error}");
        });
        Self(socket.ok())
    }

    /// Returns a source without counters, for callers that do not need them.
    pub fn disabled() -> Self {
        Self(None)
    }

    /// Returns the traffic of a TCP link: the bytes that the peer has acknowledged, the bytes received, and the smoothed
    /// round-trip time.
    pub fn carried(&self, link: &Link) -> Option<LinkTraffic> {
        if !TCP_METHODS.contains(&link.dst().protocol().as_str()) {
            return None;
        }
        let end = |address: &str| address.parse().ok();
        let own = end(link.src().address().as_str())?;
        let other = end(link.dst().address().as_str())?;
        self.between(own, other)
    }

    fn between(&self, own: SocketAddr, other: SocketAddr) -> Option<LinkTraffic> {
        let socket = self.0.as_ref()?;
        socket.send(&request(own, other), 0).ok()?;
        let mut reply = Vec::with_capacity(MAX_REPLY_BYTES);
        socket.recv(&mut reply, 0).ok()?;
        read(&reply)
    }
}

/// Opens a netlink socket for requests about sockets.
fn open() -> io::Result<Socket> {
    let mut socket = Socket::new(NETLINK_SOCK_DIAG)?;
    socket.bind_auto()?;
    socket.connect(&Netlink::new(0, 0))?;
    // The kernel replies before the system call that sends the request returns.
    socket.set_non_blocking(true)?;
    Ok(socket)
}

/// Returns a request for the counters of the socket between two addresses.
fn request(own: SocketAddr, other: SocketAddr) -> Vec<u8> {
    let interface_id = match own {
        SocketAddr::V6(own) => own.scope_id(),
        SocketAddr::V4(_) => 0,
    };
    // An IPv4 connection to a dual-stack socket has mapped addresses.
    let (own_ip, other_ip) = (own.ip().to_canonical(), other.ip().to_canonical());
    let request = InetRequest {
        family: match own_ip {
            IpAddr::V4(_) => AF_INET,
            IpAddr::V6(_) => AF_INET6,
        },
        protocol: IPPROTO_TCP,
        extensions: ExtensionFlags::INFO,
        states: StateFlags::ESTABLISHED,
        socket_id: SocketId {
            source_port: own.port(),
            destination_port: other.port(),
            source_address: own_ip,
            destination_address: other_ip,
            interface_id,
            cookie: [0xff; 8],
        },
    };
    let mut message = NetlinkMessage::from(SockDiagMessage::InetRequest(request));
    message.header.flags = NLM_F_REQUEST;
    message.finalize();
    let mut bytes = vec![0; message.buffer_len()];
    message.serialize(&mut bytes);
    bytes
}

/// Parses the reply to a request; `None` if it has another form.
fn read(reply: &[u8]) -> Option<LinkTraffic> {
    let reply = NetlinkMessage::<SockDiagMessage>::deserialize(reply).ok()?;
    let NetlinkPayload::InnerMessage(SockDiagMessage::InetResponse(socket)) = reply.payload else {
        return None;
    };
    let info = socket.nlas.iter().find_map(|part| match part {
        Nla::TcpInfo(info) => Some(info.as_slice()),
        _ => None,
    })?;
    let of_bytes = |bytes| Traffic {
        batches: None,
        bytes,
    };
    let round_trip_us = u32::from_ne_bytes(at(info, ROUND_TRIP_US)?);
    Some(LinkTraffic {
        sent: of_bytes(u64::from_ne_bytes(at(info, BYTES_ACKED)?)),
        received: of_bytes(u64::from_ne_bytes(at(info, BYTES_RECEIVED)?)),
        round_trip_ms: (round_trip_us > 0).then(|| f64::from(round_trip_us) / 1000.0),
    })
}

fn at<const BYTES: usize>(info: &[u8], offset: usize) -> Option<[u8; BYTES]> {
    info.get(offset..offset + BYTES)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use std::{
        io::{Read, Write},
        net::{TcpListener, TcpStream},
    };

    use super::*;

    /// Returns both ends of a TCP connection.
    fn connected(listen: &str, dial: &str) -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind(listen).expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let dialled = TcpStream::connect(format!("{dial}:{port}")).expect("connected");
        (dialled, listener.accept().expect("accepted").0)
    }

    #[test]
    fn reports_both_ends_of_ipv4_and_ipv6_connections() {
        for (listen, dial) in [
            ("127.0.0.1:0", "127.0.0.1"),
            ("[::1]:0", "[::1]"),
            ("[::]:0", "127.0.0.1"),
        ] {
            let (mut dialled, mut accepted) = connected(listen, dial);
            dialled.write_all(&[0; 5000]).expect("written");
            accepted.read_exact(&mut [0; 5000]).expect("read");
            let sockets = Sockets::open();
            let counted = |stream: &TcpStream| {
                let (own, other) = (stream.local_addr(), stream.peer_addr());
                let ends = (own.expect("an address"), other.expect("an address"));
                sockets.between(ends.0, ends.1).expect("counted")
            };
            let (of_dialled, of_accepted) = (counted(&dialled), counted(&accepted));
            // The kernel counts the SYN of a connection as one byte.
            assert!((5000..=5001).contains(&of_dialled.sent.bytes), "{listen}");
            assert_eq!(of_dialled.received.bytes, 0, "{listen}");
            assert!((0..=1).contains(&of_accepted.sent.bytes), "{listen}");
            assert_eq!(of_accepted.received.bytes, 5000, "{listen}");
            assert!(of_dialled.round_trip_ms > Some(0.0), "{of_dialled:?}");
        }
    }

    #[test]
    fn reports_nothing_for_unknown_connections() {
        let (dialled, accepted) = connected("127.0.0.1:0", "127.0.0.1");
        let own = dialled.local_addr().expect("an address");
        let other = dialled.peer_addr().expect("an address");
        drop((dialled, accepted));
        let sockets = Sockets::open();
        let nowhere = SocketAddr::from(([127, 0, 0, 1], 1));
        assert_eq!(sockets.between(own, nowhere), None);
        let of_two_families = SocketAddr::from(([0; 16], other.port()));
        assert_eq!(sockets.between(own, of_two_families), None);
        assert_eq!(Sockets::disabled().between(own, other), None);
    }

    #[test]
    fn ignores_malformed_replies() {
        let own = SocketAddr::from(([127, 0, 0, 1], 1));
        assert_eq!(read(&request(own, own)), None);
        for length in 0..100 {
            assert_eq!(read(&vec![0xff; length]), None);
            assert_eq!(read(&vec![0; length]), None);
        }
    }
}
