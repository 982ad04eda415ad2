//! Owns dialling: find the peer, connect, say hello, under one limit; nothing stays behind when it is given up.
use std::{sync::Arc, time::Duration};

use tokio::time::Instant;
use tokio_util::sync::CancellationToken;

use crate::{
    adapter::Adapter,
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    error::BleError,
    hello::{Hello, NodeId, Refusal, VERSION},
    link::{Framing, LinkBle, Opened},
    links::LinkNumber,
    locator::{ConnectLocator, Target},
    node::Node,
    opening::{agreed_mtu, channel_options, own_window, say_hello},
    radio::{Channel, ChannelOptions, RadioError, Security, Sighting},
    secret::Secret,
};

/// How long one LE connect may take, at least and at most: it is tried only with a peer just heard, and while it is
/// pending the Pi's Wi-Fi suffers (raspberrypi/linux#1444). It is drawn anew each time: the kernel does not advertise
/// while it connects, so two robots that dial each other in step would wait for each other for ever. Never less than
/// BlueZ's own advertising interval of 1.28 s, as the peer takes the connect only when it advertises next.
const CONNECT_TIMEOUT_MS: (u64, u64) = (1500, 4000);
/// How long to give way to the dial of a peer that may have just heard this node, too. Two dials at once cost seconds: radios
/// and kernels mix them up ([`BleError::Astray`]), and both have to be given up.
const GIVE_WAY: Duration = Duration::from_millis(400);
/// How much longer where the two may have to be paired first: a passkey of 20 bits takes 40 messages each way (Core
/// Specification, Vol 3, Part H, 2.3.5.6.3), each a connection interval of some 50 ms.
const PAIRING: Duration = Duration::from_secs(4);

/// Dials once. Waits for the peer to appear, at most `locator.timeout` altogether.
pub(crate) async fn dial(
    node: &Arc<Node>,
    locator: &ConnectLocator,
) -> Result<Arc<LinkBle>, BleError> {
    let adapter = node.adapter(locator.adapter.as_deref())?;
    let start = Instant::now();
    match tokio::time::timeout(locator.timeout, dial_when_free(node, &adapter, locator)).await {
        Ok(linked) => linked,
        Err(_) if node.links().is_linked(&locator.target) => Err(already_linked(locator)),
        Err(_) => Err(BleError::NotFound {
            target: locator.target.to_string(),
            adapter: adapter.radio.name().to_owned(),
            waited: start.elapsed(),
        }),
    }
}

async fn dial_when_free(
    node: &Arc<Node>,
    adapter: &Adapter,
    locator: &ConnectLocator,
) -> Result<Arc<LinkBle>, BleError> {
    let cancel = CancellationToken::new();
    let mut dialling = loop {
        let unlinked = node.unlinked.notified();
        if let Some(dialling) = Dialling::begin(node, &locator.target, &cancel) {
            break dialling;
        }
        // There is a link already (the peer dialled, or an earlier one lives): be ready for the moment it ends.
        unlinked.await;
    };
    tokio::select! {
        linked = dial_once(node, adapter, locator, &mut dialling) => linked,
        () = cancel.cancelled() => Err(already_linked(locator)),
    }
}

async fn dial_once(
    node: &Arc<Node>,
    adapter: &Adapter,
    locator: &ConnectLocator,
    dialling: &mut Dialling,
) -> Result<Arc<LinkBle>, BleError> {
    let seen = adapter
        .scanner
        .find(|sighting| Seen::of(sighting, locator).filter(|seen| is_wanted(node, locator, seen)))
        .await?;
    node.links().on_seen(dialling.number, seen.device);
    if gives_way(node, &seen) {
        tokio::time::sleep(GIVE_WAY).await;
    }
    let opened = open(node, dialling.number, adapter, locator, &seen).await;
    // The connection may carry the peer's own link by now.
    let is_of_use = matches!(
        opened,
        Ok(_) | Err(BleError::Refused { .. } | BleError::AlreadyLinked { .. })
    );
    if !is_of_use {
        adapter.radio.disconnect(seen.device).await;
    }
    let is_stranger = match &opened {
        Err(BleError::NoSharedSecret { .. }) => true,
        Err(BleError::Refused { refusal, .. }) => *refusal == Refusal::Secret,
        _ => false,
    };
    if is_stranger {
        node.on_no_proof(seen.device);
    }
    let (channel, peer) = opened?;
    let mtu = agreed_mtu(&channel, locator.mtu, peer.as_ref())?;
    let replaced = CancellationToken::new();
    let device = channel.peer();
    dialling
        .succeed(peer.as_ref(), device, replaced.clone())
        // It is this side that wants no second link.
        .map_err(|_| already_linked(locator))?;
    let opened = Opened {
        framing: Framing::with(&channel, peer.as_ref(), None),
        channel,
        mtu,
        queueing: locator.queueing,
        peer_name: peer.map_or_else(|| locator.target.to_string(), |p| p.name),
        replaced,
    };
    let link = LinkBle::new(Arc::clone(node), dialling.number, opened).map_err(|error| {
        BleError::Protocol {
            peer: device,
            what: error.to_string(),
        }
    })?;
    tokio::select! {
        () = node.pause(dialling.number) => {}
        () = link.ended() => {}
    }
    // Zenoh gets no link that ended meanwhile.
    link.check().map(|()| link)
}

/// Connects and says hello, if the peer is one for hellos.
async fn open(
    node: &Arc<Node>,
    dial: LinkNumber,
    adapter: &Adapter,
    locator: &ConnectLocator,
    seen: &Seen,
) -> Result<(Arc<dyn Channel>, Option<Hello>), BleError> {
    let mut limit = connect_timeout(node.id, dial);
    if locator.security != Security::Low {
        limit += PAIRING;
    }
    let secret = match &locator.secret {
        Some(file) => Some(Secret::read(file)?),
        None => node.secret(),
    };
    let options = channel_options(locator.security, secret.as_ref())?;
    // Whoever can't prove anything is dialled only if the locator says so itself.
    let is_plain = locator.plain.unwrap_or(seen.plain);
    if is_plain && locator.plain.is_none() && secret.is_some() {
        return Err(BleError::NoSharedSecret { peer: seen.device });
    }
    node.greetings_with(seen.device).await;
    let channel = connect(adapter, options, seen, limit).await?;
    if is_plain {
        return Ok((channel, None));
    }
    let own = Hello {
        version: VERSION,
        node: node.id,
        mtu: locator.mtu,
        window: own_window(&channel),
        name: node.name(),
        nonce: None,
    };
    if !node.links().on_hello_said(dial) {
        return Err(already_linked(locator));
    }
    let peer = say_hello(&channel, own, secret.as_ref()).await?;
    Ok((channel, Some(peer)))
}

async fn connect(
    adapter: &Adapter,
    options: ChannelOptions,
    seen: &Seen,
    limit: Duration,
) -> Result<Arc<dyn Channel>, BleError> {
    let _one_at_a_time = adapter
        .connecting
        .acquire()
        .await
        .map_err(|_| BleError::ShuttingDown)?;
    let connected = adapter.radio.connect(seen.device, seen.psm, options);
    match tokio::time::timeout(limit, connected).await {
        Ok(channel) => Ok(channel?),
        Err(_) => Err(BleError::Radio(RadioError::TimedOut {
            action: "connecting to a peer that was just heard",
            limit,
        })),
    }
}

/// Chance by arithmetic, so that the same node does the same again in a test.
fn connect_timeout(node: NodeId, dial: LinkNumber) -> Duration {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&node.0.to_le_bytes());
    hasher.update(&dial.0.to_le_bytes());
    let (least, most) = CONNECT_TIMEOUT_MS;
    Duration::from_millis(least + u64::from(hasher.finalize()) % (most - least))
}

fn already_linked(locator: &ConnectLocator) -> BleError {
    BleError::AlreadyLinked {
        target: locator.target.to_string(),
    }
}

/// Whether the peer goes first, should it dial this node, too: of two that listen, the one with the lower hash of its name.
fn gives_way(node: &Node, seen: &Seen) -> bool {
    let name = node.name();
    let own = Advertisement::hash_of_name(&name);
    !name.is_empty() && seen.name_hash.is_some_and(|peer| peer < own)
}

/// Anyone of a fleet is somebody else, without a link yet, and no known stranger.
fn is_wanted(node: &Node, locator: &ConnectLocator, seen: &Seen) -> bool {
    let own = Advertisement::hash_of_name(&node.name());
    match locator.target {
        Target::Fleet(_) => {
            let is_linked = node.links().knows(seen.device);
            seen.name_hash != Some(own) && !is_linked && !node.is_stranger(seen.device)
        }
        Target::Address(_) | Target::Name(_) => true,
    }
}

/// What a sighting tells of the peer looked for.
struct Seen {
    device: DeviceAddress,
    psm: Psm,
    plain: bool,
    name_hash: Option<u32>,
}

impl Seen {
    fn of(sighting: &Sighting, locator: &ConnectLocator) -> Option<Self> {
        let advertised = sighting.advertisement.as_ref();
        let wanted = match &locator.target {
            Target::Address(address) => *address == sighting.device.address,
            Target::Name(name) => advertised.is_some_and(|a| a.is_of(name)),
            Target::Fleet(fleet) => {
                let hash = Advertisement::hash_of_fleet(fleet);
                advertised.is_some_and(|a| a.fleet_hash == hash)
            }
        };
        let psm = locator.psm.or(advertised.map(|a| a.psm));
        let device = DeviceAddress {
            kind: locator.address_kind.unwrap_or(sighting.device.kind),
            ..sighting.device
        };
        psm.filter(|_| wanted).map(|psm| Self {
            device,
            psm,
            plain: advertised.is_some_and(|a| a.plain),
            name_hash: advertised.map(|a| a.name_hash),
        })
    }
}

/// A dial in the table of links; taken out again when it is dropped without success.
struct Dialling {
    node: Arc<Node>,
    number: LinkNumber,
    succeeded: bool,
}

impl Dialling {
    fn begin(node: &Arc<Node>, target: &Target, cancel: &CancellationToken) -> Option<Self> {
        let number = node.links().on_dial(target, cancel.clone())?;
        Some(Self {
            node: Arc::clone(node),
            number,
            succeeded: false,
        })
    }

    fn succeed(
        &mut self,
        peer: Option<&Hello>,
        device: DeviceAddress,
        end: CancellationToken,
    ) -> Result<(), Refusal> {
        self.succeeded = true;
        let now = Instant::now().into_std();
        let accepted = (self.node.links()).on_accepted(self.number, peer, device, now, end);
        // Another dial to anyone of the fleet may begin.
        self.node.unlinked.notify_waiters();
        accepted
    }
}

impl Drop for Dialling {
    fn drop(&mut self) {
        if !self.succeeded {
            self.node.links().on_dial_ended(self.number);
            self.node.unlinked.notify_waiters();
        }
    }
}
