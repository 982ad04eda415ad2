//! The table of Zenoh's links, to which a program adds its own with [`register`].
//!
//! Zenoh's links are a closed enum in the crate `zenoh-link` (zenoh#2707). Two crates of that name and version replace it by
//! this table, through `[patch.crates-io]`: `crates/zenoh-link`, and `crates/zenoh-link-with-ble` for programs that register
//! no links themselves. All public items of the published crate exist here with the same names.
//!
//! `table` dispatches to the crates of Zenoh's links (`zenoh-link-tcp`, ...), and `registry` to the registered ones.
//! [`admission`] limits the accepted links that are passed on to Zenoh, and [`succession`] lets a link follow another one only after
//! both sides have released that one, if a program asks for it.

use std::collections::HashMap;

use zenoh_config::Config;
pub use zenoh_link_commons::*;
// The glob above also imports a trait with the name of the struct below; only its methods are needed.
#[allow(unused_imports)] // in a build without any of Zenoh's links
use zenoh_link_commons::LocatorInspector as _;
pub use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::{bail, Error, ZResult};

pub mod admission;
mod registry;
pub mod succession;
#[macro_use]
mod table;

pub use registry::{register, RegisteredLink};

link_table! {
    #[cfg(feature = "transport_quic")]
    Quic: zenoh_link_quic as quic, QUIC_LOCATOR_PREFIX, QuicLocatorInspector, LinkManagerUnicastQuic,
        config QuicConfigurator, only reliable, else "transport_quic_datagram";

    #[cfg(feature = "transport_quic_datagram")]
    QuicDatagram: zenoh_link_quic_datagram as quic_datagram, QUIC_DATAGRAM_LOCATOR_PREFIX,
        QuicDatagramLocatorInspector, LinkManagerUnicastQuicDatagram,
        config QuicDatagramConfigurator, only best_effort, else "transport_quic";

    #[cfg(feature = "transport_tcp")]
    Tcp: zenoh_link_tcp as tcp, TCP_LOCATOR_PREFIX, TcpLocatorInspector, LinkManagerUnicastTcp,
        config TcpConfigurator;

    #[cfg(feature = "transport_tls")]
    Tls: zenoh_link_tls as tls, TLS_LOCATOR_PREFIX, TlsLocatorInspector, LinkManagerUnicastTls,
        config TlsConfigurator;

    #[cfg(feature = "transport_udp")]
    Udp: zenoh_link_udp as udp, UDP_LOCATOR_PREFIX, UdpLocatorInspector, LinkManagerUnicastUdp;

    #[cfg(feature = "transport_ws")]
    Ws: zenoh_link_ws as ws, WS_LOCATOR_PREFIX, WsLocatorInspector, LinkManagerUnicastWs;

    #[cfg(all(feature = "transport_unixsock-stream", target_family = "unix"))]
    UnixsockStream: zenoh_link_unixsock_stream as unixsock_stream, UNIXSOCKSTREAM_LOCATOR_PREFIX,
        UnixSockStreamLocatorInspector, LinkManagerUnicastUnixSocketStream;

    #[cfg(feature = "transport_serial")]
    Serial: zenoh_link_serial as serial, SERIAL_LOCATOR_PREFIX, SerialLocatorInspector, LinkManagerUnicastSerial;

    #[cfg(feature = "transport_unixpipe")]
    Unixpipe: zenoh_link_unixpipe as unixpipe, UNIXPIPE_LOCATOR_PREFIX, UnixPipeLocatorInspector,
        LinkManagerUnicastPipe, config UnixPipeConfigurator;

    #[cfg(all(feature = "transport_vsock", target_os = "linux"))]
    Vscock: zenoh_link_vsock as vsock, VSOCK_LOCATOR_PREFIX, VsockLocatorInspector, LinkManagerUnicastVsock;
}

/// All links of Zenoh, whether or not this build includes them, and the registered ones.
#[allow(missing_docs)] // each variant is named after its locator prefix
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LinkKind {
    Quic,
    QuicDatagram,
    Serial,
    /// Any link that the program has [registered](crate::register).
    Registered,
    Tcp,
    Tls,
    Udp,
    Unixpipe,
    UnixsockStream,
    /// `vsock/`. The spelling is that of the published crate.
    Vscock,
    Ws,
}

impl TryFrom<&EndPoint> for LinkKind {
    type Error = Error;

    fn try_from(endpoint: &EndPoint) -> ZResult<Self> {
        LinkKind::try_from(&endpoint.to_locator())
    }
}

/// Reports properties of a locator without opening it.
#[derive(Debug, Default, Clone)]
pub struct LocatorInspector;

/// Collects the settings of the links from Zenoh's config.
#[derive(Debug, Default)]
pub struct LinkConfigurator;

/// Creates the manager of links to one peer.
#[derive(Debug)]
pub struct LinkManagerBuilderUnicast;

/// Creates the manager of links to a multicast group.
#[derive(Debug)]
pub struct LinkManagerBuilderMulticast;

impl LinkManagerBuilderMulticast {
    /// Creates the link manager of `kind`.
    ///
    /// # Errors
    /// Fails if the link does not support multicast; only `udp/` does.
    pub fn make(kind: LinkKind) -> ZResult<LinkManagerMulticast> {
        match kind {
            #[cfg(feature = "transport_udp")]
            LinkKind::Udp => Ok(std::sync::Arc::new(zenoh_link_udp::LinkManagerMulticastUdp)),
            _ => bail!("Multicast not supported for link {kind:?}"),
        }
    }
}

fn not_in_this_build<T>(kind: LinkKind) -> ZResult<T> {
    bail!("this build has no {kind:?} link")
}
