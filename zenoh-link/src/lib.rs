//! Drop-in for the published crate `zenoh-link` 1.10.2: every link of Zenoh's, `ble` and `slot`.
//!
//! Zenoh's links are a closed enum (zenoh#2707), so a new one gets in only by standing where this crate stands:
//! `[patch.crates-io] zenoh-link = { path = "zenoh-link" }`. Here is a table and no more; a link's work is done in its
//! own crate (`zenoh-link-tcp`, ..., `zenoh-link-ble`, `zenoh-link-slot`). A router may limit which accepted links get to Zenoh
//! (`admission`). What Zenoh calls of the published crate exists here under the
//! same name, and so does everything else public in it; `tests/` holds the proof.

use std::{collections::HashMap, sync::Arc};

use zenoh_config::Config;
pub use zenoh_link_commons::*;
// The glob above also brings a trait of the name of our own struct below: it is needed for its methods only.
use zenoh_link_commons::LocatorInspector as _;
pub use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::{bail, Error, ZResult};

pub mod admission;
#[macro_use]
mod table;

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

    Ble: zenoh_link_ble as ble, BLE_LOCATOR_PREFIX, BleLocatorInspector, LinkManagerUnicastBle;

    Slot: zenoh_link_slot as slot, SLOT_LOCATOR_PREFIX, SlotLocatorInspector, LinkManagerUnicastSlot;
}

/// Every link there is, whether or not this build has it.
#[allow(missing_docs)] // each is its locator's prefix
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum LinkKind {
    Ble,
    Quic,
    QuicDatagram,
    Serial,
    /// `slot/`: a peer chosen while the router runs.
    Slot,
    Tcp,
    Tls,
    Udp,
    Unixpipe,
    UnixsockStream,
    /// `vsock/`, spelled as the published crate spells it.
    Vscock,
    Ws,
}

impl TryFrom<&EndPoint> for LinkKind {
    type Error = Error;

    fn try_from(endpoint: &EndPoint) -> ZResult<Self> {
        LinkKind::try_from(&endpoint.to_locator())
    }
}

/// Answers questions about a locator without opening it.
#[derive(Debug, Default, Clone)]
pub struct LocatorInspector;

/// Gathers what the links read from Zenoh's config.
#[derive(Debug, Default)]
pub struct LinkConfigurator;

/// Makes the manager of a link to one peer.
#[derive(Debug)]
pub struct LinkManagerBuilderUnicast;

/// Makes the manager of a link to a group.
#[derive(Debug)]
pub struct LinkManagerBuilderMulticast;

impl LinkManagerBuilderMulticast {
    /// The manager of `kind`, if that link knows groups: `udp/` alone does.
    pub fn make(kind: LinkKind) -> ZResult<LinkManagerMulticast> {
        match kind {
            #[cfg(feature = "transport_udp")]
            LinkKind::Udp => Ok(Arc::new(zenoh_link_udp::LinkManagerMulticastUdp)),
            _ => bail!("Multicast not supported for link {kind:?}"),
        }
    }
}

fn not_in_this_build<T>(kind: LinkKind) -> ZResult<T> {
    bail!("this build has no {kind:?} link")
}
