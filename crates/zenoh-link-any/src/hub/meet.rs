//! Opens links on TCP, with peers whose address is known.
use std::{
    io,
    net::SocketAddr,
    sync::{
        atomic::{AtomicUsize, Ordering},
        Arc,
    },
};

use link_lanes::hello::{Hello, PathOf, Refusal, VERSION};
use zenoh_link_ble::{secret_file, Identity};
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait};

use super::{random_number, Hub};
use crate::{
    connect::{self, within},
    connection::Stream,
    error::AnyError,
    locator::ConnectLocator,
    meeting::{self, MeetingError},
    multipath::Options,
    proof::Role,
    run,
    shared::Shared,
};

/// The own address that a link reports which begins on TCP.
const SOURCE: &str = "tcp";
/// Number of addresses that are tried of a host with several.
const MAX_ADDRESSES: usize = 4;

impl Hub {
    /// Opens a link with the peer at an address, and adds a Bluetooth path to it as soon as there is one.
    pub(super) async fn meet(
        self: &Arc<Self>,
        locator: &ConnectLocator,
        address: &str,
    ) -> Result<LinkUnicast, AnyError> {
        let identity = self.ble.identity();
        let secret = match locator.ble.config().get("secret") {
            Some(file) => Some(secret_file::read(file.as_ref())?),
            None => identity.secret.clone(),
        };
        let secret = secret.ok_or_else(|| AnyError::NoSecret(address.to_owned()))?;
        let failed = |error: MeetingError| AnyError::Meeting {
            address: address.to_owned(),
            error,
        };
        let (at, mut stream) = self.dial(address).await.map_err(|e| failed(e.into()))?;
        let id = random_number();
        let new_link = PathOf {
            link: id,
            joins: false,
        };
        let own = hello(identity, new_link);
        let met = {
            let _meeting = Meeting::begin(&self.meetings);
            within(meeting::dial(&mut stream.halves, &secret, own)).await
        };
        let met = met.map_err(failed)?;
        let peer = name_of(&met.peer, at);
        if let Some(expected) = locator.peer.as_ref().filter(|name| **name != peer) {
            return Err(failed(MeetingError::OtherRobot {
                found: peer,
                expected: expected.clone(),
            }));
        }
        (self.met.lock()).insert(address.to_owned(), peer.clone());
        // The peer names the link that the two have, if there is one.
        let is_new = met.peer.path == Some(new_link);
        if !is_new || self.link_with(&peer).is_some() {
            return Err(AnyError::AlreadyLinked(peer));
        }
        let has_name = !met.peer.name.is_empty();
        let (node, is_compressed) = (met.peer.node, met.peer.accepts_compressed);
        let keys = Some(&met.exporter);
        let shared = self.add_link(id, peer, node, Role::Opener, keys, is_compressed);
        let proven = connect::prove(&shared, stream).await;
        let connection = proven.map_err(|error| failed(error.into()))?;
        let carrying = run::run_tcp(Arc::clone(&shared), connection, true);
        let link = self.start(&shared, SOURCE, Some(at), carrying)?;
        if has_name {
            let endpoint = locator.to(&shared.peer)?;
            self.spawn(Arc::clone(self).keep_bluetooth(shared, endpoint));
        }
        let link: Arc<dyn LinkUnicastTrait> = link;
        Ok(LinkUnicast::from(link))
    }

    /// Connects to the first of a host's addresses that answers.
    async fn dial(&self, address: &str) -> io::Result<(SocketAddr, Stream)> {
        let is_simulated = self.is_simulated();
        let mut failure = io::Error::other("the host has no address");
        let addresses = within(tokio::net::lookup_host(address)).await?;
        for at in addresses.take(MAX_ADDRESSES) {
            match connect::dial(at, is_simulated).await {
                Ok(stream) => return Ok((at, stream)),
                Err(error) => failure = error,
            }
        }
        Err(failure)
    }

    /// Accepts a link that a peer opens on a connection.
    pub(super) async fn accept_meeting(
        self: &Arc<Self>,
        mut stream: Stream,
        address: SocketAddr,
    ) -> Result<(), MeetingError> {
        let identity = self.ble.identity();
        let secret = identity.secret.clone();
        let decide = |peer: &Hello| self.decide(peer, address, identity);
        let met = meeting::accept(&mut stream.halves, secret.as_ref(), decide);
        let met = within(met).await?;
        if self
            .existing(&name_of(&met.peer, address), met.peer.node)
            .is_some()
        {
            // The peer knows now that the two are linked, and closes the connection.
            return Ok(());
        }
        let (peer, node) = (name_of(&met.peer, address), met.peer.node);
        let id = met.peer.path.map_or(0, |path| path.link);
        let (keys, is_compressed) = (Some(&met.exporter), met.peer.accepts_compressed);
        let shared = self.add_link(id, peer, node, Role::Acceptor, keys, is_compressed);
        let connection = connect::accept_as(&shared, stream).await?;
        // A peer that still has the earlier link closes the connection instead.
        self.replace_by(&shared);
        let carrying = run::run_tcp(Arc::clone(&shared), connection, true);
        match self.start(&shared, SOURCE, None, carrying) {
            Ok(link) => self.hand_over(link).await,
            Err(error) => tracing::warn!("any: {error}"),
        }
        Ok(())
    }

    /// Returns the answer to a peer that opens a link.
    fn decide(&self, peer: &Hello, address: SocketAddr, own: Identity) -> Result<Hello, Refusal> {
        let Some(PathOf { link, joins: false }) = peer.path else {
            return Err(Refusal::Malformed);
        };
        let name = name_of(peer, address);
        if let Some(existing) = self.existing(&name, peer.node) {
            return Ok(hello(
                own,
                PathOf {
                    link: existing.id,
                    joins: true,
                },
            ));
        }
        let is_of_another = |link: Arc<Shared>| link.node != peer.node && link.is_shared();
        if name == own.name || self.link_with(&name).is_some_and(is_of_another) {
            return Err(Refusal::NameTaken);
        }
        if self.is_full_for(&name) {
            return Err(Refusal::Full);
        }
        if self.meetings.load(Ordering::Relaxed) > 0 && own.node < peer.node {
            return Err(Refusal::Crossing);
        }
        Ok(hello(own, PathOf { link, joins: false }))
    }
}

/// A link that this side is opening on TCP, while it waits for the peer's answer.
struct Meeting<'a>(&'a AtomicUsize);

impl<'a> Meeting<'a> {
    fn begin(count: &'a AtomicUsize) -> Self {
        count.fetch_add(1, Ordering::Relaxed);
        Self(count)
    }
}

impl Drop for Meeting<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

fn hello(own: Identity, path: PathOf) -> Hello {
    Hello {
        version: VERSION,
        node: own.node,
        mtu: u16::try_from(Options::default().max_batch).unwrap_or(u16::MAX),
        window: u16::MAX,
        name: own.name,
        intervals: None,
        path: Some(path),
        accepts_compressed: true,
    }
}

/// Returns the name of a peer, or its address if it has none.
fn name_of(peer: &Hello, address: SocketAddr) -> String {
    match peer.name.as_str() {
        "" => address.to_string(),
        name => name.to_owned(),
    }
}
