//! Owns what the kernel counts on the sockets of TCP links, whoever dialled them, and in the host of a plugin too: what
//! `ss --info` shows (sock_diag(7)). The kernel answers at once, about this computer alone.
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
use rect::core::connection::Traffic;
use zenoh::session::Link;

use super::Carried;

/// Methods with a socket of TCP.
const OVER_TCP: [&str; 3] = ["tcp", "tls", "ws"];
/// More than an answer has.
const ANSWER_BYTES: usize = 4096;
/// Where `struct tcp_info` of linux/tcp.h has them. Kernels only ever add to its end; the last two came with 4.1.
const ROUND_TRIP_US: usize = 68;
const BYTES_ACKED: usize = 120;
const BYTES_RECEIVED: usize = 128;

/// Where the kernel is asked.
pub struct Sockets(Option<Socket>);

impl Sockets {
    /// A kernel that is not to be asked counts nothing.
    pub fn open() -> Self {
        let socket = open().inspect_err(|error| {
            tracing::debug!("the kernel can't be asked about sockets: {error}");
        });
        Self(socket.ok())
    }

    /// For who has no use for what they carry.
    pub fn unasked() -> Self {
        Self(None)
    }

    /// What is counted on the socket of that link: the bytes that the other end has acknowledged, those that came, and
    /// what it takes until it acknowledges them, smoothed.
    pub fn carried(&self, link: &Link) -> Option<Carried> {
        if !OVER_TCP.contains(&link.dst().protocol().as_str()) {
            return None;
        }
        let end = |address: &str| address.parse().ok();
        let own = end(link.src().address().as_str())?;
        let other = end(link.dst().address().as_str())?;
        self.between(own, other)
    }

    fn between(&self, own: SocketAddr, other: SocketAddr) -> Option<Carried> {
        let socket = self.0.as_ref()?;
        socket.send(&question(own, other), 0).ok()?;
        let mut answer = Vec::with_capacity(ANSWER_BYTES);
        socket.recv(&mut answer, 0).ok()?;
        read(&answer)
    }
}

fn open() -> io::Result<Socket> {
    let mut socket = Socket::new(NETLINK_SOCK_DIAG)?;
    socket.bind_auto()?;
    socket.connect(&Netlink::new(0, 0))?;
    // The answer is there when the question has been sent.
    socket.set_non_blocking(true)?;
    Ok(socket)
}

fn question(own: SocketAddr, other: SocketAddr) -> Vec<u8> {
    let interface_id = match own {
        SocketAddr::V6(own) => own.scope_id(),
        SocketAddr::V4(_) => 0,
    };
    // What came by IPv4 to a socket for both.
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

fn read(answer: &[u8]) -> Option<Carried> {
    let answer = NetlinkMessage::<SockDiagMessage>::deserialize(answer).ok()?;
    let NetlinkPayload::InnerMessage(SockDiagMessage::InetResponse(socket)) = answer.payload else {
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
    Some(Carried {
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

    /// Both ends of a connection.
    fn connected(listen: &str, dial: &str) -> (TcpStream, TcpStream) {
        let listener = TcpListener::bind(listen).expect("a port");
        let port = listener.local_addr().expect("an address").port();
        let dialled = TcpStream::connect(format!("{dial}:{port}")).expect("connected");
        (dialled, listener.accept().expect("accepted").0)
    }

    #[test]
    fn both_ends_are_counted_by_every_family() {
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
            // The kernel counts the first packet of a connection as a byte.
            assert!((5000..=5001).contains(&of_dialled.sent.bytes), "{listen}");
            assert_eq!(of_dialled.received.bytes, 0, "{listen}");
            assert!((0..=1).contains(&of_accepted.sent.bytes), "{listen}");
            assert_eq!(of_accepted.received.bytes, 5000, "{listen}");
            assert!(of_dialled.round_trip_ms > Some(0.0), "{of_dialled:?}");
        }
    }

    #[test]
    fn what_is_no_connection_is_not_counted() {
        let (dialled, accepted) = connected("127.0.0.1:0", "127.0.0.1");
        let own = dialled.local_addr().expect("an address");
        let other = dialled.peer_addr().expect("an address");
        drop((dialled, accepted));
        let sockets = Sockets::open();
        let nowhere = SocketAddr::from(([127, 0, 0, 1], 1));
        assert_eq!(sockets.between(own, nowhere), None);
        let of_two_families = SocketAddr::from(([0; 16], other.port()));
        assert_eq!(sockets.between(own, of_two_families), None);
        assert_eq!(Sockets::unasked().between(own, other), None);
    }

    #[test]
    fn an_answer_of_any_other_form_counts_nothing() {
        let own = SocketAddr::from(([127, 0, 0, 1], 1));
        assert_eq!(read(&question(own, own)), None);
        for length in 0..100 {
            assert_eq!(read(&vec![0xff; length]), None);
            assert_eq!(read(&vec![0; length]), None);
        }
    }
}
