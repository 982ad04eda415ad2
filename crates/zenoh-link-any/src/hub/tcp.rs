//! The TCP side of a hub: its listener, the addresses that it offers, and those that it dials.
use std::{collections::VecDeque, convert::Infallible, io, net::SocketAddr, sync::Arc};

use tokio::net::{TcpListener, TcpStream};
use tokio_util::{sync::CancellationToken, task::AbortOnDropHandle};

use super::{Hub, RETRY};
use crate::{
    connect,
    connection::Connection,
    error::AnyError,
    meeting::{self, MeetingError},
    network_events::NetworkEvents,
    networks, offer,
    proof::{Role, Tag},
    run,
    shared::Shared,
    wifi,
};

/// Number of accepted connections that may be unproven at the same time.
const MAX_UNPROVEN: usize = 8;

/// The TCP listener.
pub(super) struct Tcp {
    port: u16,
    interfaces: Option<Vec<String>>,
    /// Whether connections run through the simulated Wi-Fi.
    is_simulated: bool,
    _accepting: AbortOnDropHandle<()>,
    _watching: AbortOnDropHandle<()>,
}

impl Hub {
    /// Returns the addresses to offer.
    pub(super) fn offer(&self) -> Vec<u8> {
        match &*self.tcp.lock() {
            Some(tcp) => {
                let addresses = networks::own_addresses(tcp.interfaces.as_deref());
                offer::encode(tcp.port, &addresses)
            }
            None => offer::encode(0, &[]),
        }
    }

    /// Returns those of a peer's addresses that this side may dial.
    pub(super) fn reachable(&self, offered: &[SocketAddr]) -> Vec<SocketAddr> {
        let tcp = self.tcp.lock();
        let has_network = |tcp: &Tcp| !tcp.is_simulated || wifi::socket_path().exists();
        if !tcp.as_ref().is_some_and(has_network) {
            return Vec::new();
        }
        let interfaces = tcp.as_ref().and_then(|tcp| tcp.interfaces.as_deref());
        networks::reachable(offered, interfaces)
    }

    /// Returns whether connections run through the simulated Wi-Fi.
    pub(super) fn is_simulated(&self) -> bool {
        self.tcp.lock().as_ref().is_some_and(|tcp| tcp.is_simulated)
    }

    /// Opens a connection for a link to the first of the addresses that answers.
    pub(super) async fn connect(
        &self,
        shared: &Shared,
        addresses: &[SocketAddr],
    ) -> Option<Connection> {
        let is_simulated = self.is_simulated();
        for address in addresses {
            let connected = tokio::select! {
                connected = connect::connect(shared, *address, is_simulated) => connected,
                () = shared.ended() => return None,
            };
            match connected {
                Ok(connection) => return Some(connection),
                Err(error) => {
                    tracing::debug!("any: no path to {} at {address}: {error}", shared.peer);
                }
            }
        }
        None
    }

    /// Accepts further paths on a TCP port, or on one that the system chooses. A simulated robot accepts them on the loopback
    /// interface.
    pub(crate) fn listen(
        self: &Arc<Self>,
        port: Option<u16>,
        interfaces: Option<Vec<String>>,
        is_simulated: bool,
    ) -> Result<(), AnyError> {
        let interfaces = match is_simulated {
            true => Some(vec!["lo".to_owned()]),
            false => interfaces,
        };
        let port = port.unwrap_or(0);
        let bound = {
            let _runtime = self.runtime.enter();
            bind(port, is_simulated)
        };
        let with_port = bound.and_then(|listener| {
            let port = listener.local_addr()?.port();
            Ok((listener, port))
        });
        let (listener, port) = with_port.map_err(|error| AnyError::Listen { port, error })?;
        let accepting = self.runtime.spawn(Arc::clone(self).accept(listener));
        let watching = self.runtime.spawn(Arc::clone(self).watch_networks());
        *self.tcp.lock() = Some(Tcp {
            port,
            interfaces,
            is_simulated,
            _accepting: AbortOnDropHandle::new(accepting),
            _watching: AbortOnDropHandle::new(watching),
        });
        Ok(())
    }

    /// Reports changes of this computer's networks to the links. Without the kernel's notifications, silence tells the same later.
    async fn watch_networks(self: Arc<Self>) {
        let watching = async {
            let events = NetworkEvents::open()?;
            loop {
                events.next().await?;
                let working = networks::working_addresses();
                for link in self.links() {
                    link.on_networks_changed(&working);
                }
            }
        };
        let failed: io::Result<Infallible> = watching.await;
        let Err(error) = failed;
        tracing::debug!("any: changes of the network are not reported: {error}");
    }

    async fn accept(self: Arc<Self>, listener: TcpListener) {
        let mut unproven: VecDeque<CancellationToken> = VecDeque::new();
        loop {
            let (stream, address) = match listener.accept().await {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!("any: cannot accept a connection: {error}");
                    tokio::time::sleep(RETRY.0).await;
                    continue;
                }
            };
            // A proof takes milliseconds, so unauthenticated peers that send nothing cannot keep a robot out: the oldest
            // connection gives way.
            unproven.retain(|one| !one.is_cancelled());
            if unproven.len() >= MAX_UNPROVEN {
                if let Some(oldest) = unproven.pop_front() {
                    oldest.cancel();
                }
            }
            let ended = CancellationToken::new();
            unproven.push_back(ended.clone());
            let hub = Arc::clone(&self);
            self.spawn(async move {
                let received = hub.on_connection(stream, address);
                let received = ended.run_until_cancelled(received).await;
                ended.cancel();
                match received {
                    Some(Ok(Some((shared, connection)))) => {
                        run::run_tcp(shared, connection, false).await;
                    }
                    Some(Ok(None)) => {}
                    Some(Err(error)) => {
                        tracing::debug!("any: closed a connection from {address}: {error}");
                    }
                    None => tracing::debug!(
                        "any: closed a connection from {address}, because there are newer ones"
                    ),
                }
            });
        }
    }

    /// Verifies an accepted connection. Returns it with its link if it is a further path.
    async fn on_connection(
        self: &Arc<Self>,
        stream: TcpStream,
        address: SocketAddr,
    ) -> Result<Option<(Arc<Shared>, Connection)>, MeetingError> {
        let (stream, magic) = connect::receive_magic(stream).await?;
        if magic == meeting::MAGIC {
            self.accept_meeting(stream, address).await?;
            return Ok(None);
        }
        let find = |tag: Tag| {
            let mut links = self.links().into_iter();
            links.find(|link| link.proof.as_ref().is_some_and(|proof| proof.tag == tag))
        };
        let (shared, connection) = connect::accept(stream, magic, find).await?;
        // Both have dialled at the same time, and the opener's connection takes precedence.
        let is_spare = shared.role == Role::Opener && !shared.needs_network();
        Ok((!is_spare).then_some((shared, connection)))
    }

    /// Returns whether this side accepts further paths.
    pub(crate) fn is_listening(&self) -> bool {
        self.tcp.lock().is_some()
    }

    /// Closes the TCP listener.
    pub(crate) fn stop_listening(&self) {
        *self.tcp.lock() = None;
    }
}

/// Opens a listener for IPv4 and IPv6 on all addresses, or on the loopback interface. A connection is used only after it has
/// proved its link.
fn bind(port: u16, is_local: bool) -> std::io::Result<TcpListener> {
    use socket2::{Domain, Socket, Type};
    let listen = |domain: Domain, address: SocketAddr| {
        let socket = Socket::new(domain, Type::STREAM, None)?;
        socket.set_reuse_address(true)?;
        socket.set_nonblocking(true)?;
        if domain == Domain::IPV6 {
            socket.set_only_v6(false)?;
        }
        socket.bind(&address.into())?;
        socket.listen(MAX_UNPROVEN as i32)?;
        TcpListener::from_std(socket.into())
    };
    let any_v6 = SocketAddr::from((std::net::Ipv6Addr::UNSPECIFIED, port));
    let any_v4 = SocketAddr::from((std::net::Ipv4Addr::UNSPECIFIED, port));
    if is_local {
        let local = SocketAddr::from((std::net::Ipv4Addr::LOCALHOST, port));
        return listen(Domain::IPV4, local);
    }
    // A kernel without IPv6 has only the second.
    listen(Domain::IPV6, any_v6).or_else(|_| listen(Domain::IPV4, any_v4))
}
