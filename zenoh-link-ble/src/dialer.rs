//! Dials a peer: discovers it, connects a channel and performs the handshake, within one timeout. A dial that is cancelled
//! leaves nothing behind.
use std::{sync::Arc, time::Duration};

use link_lanes::{
    hello::{Hello, NodeId, PathOf, Refusal, VERSION},
    key_agreement::Exporter,
    lanes::sdu::Protection,
};
use tokio::time::Instant;
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::{
    address::{DeviceAddress, Psm},
    advertisement::Advertisement,
    interval_table::{Intervals, NewLink},
    AdvertisingReport, Channel, ChannelOptions, RadioError, Security,
};

use crate::{
    adapter::Adapter,
    error::{BleError, DialStep},
    handshake::{agreed_mtu, channel_options, own_window, HandshakeChannel},
    link::{
        interval_units::{from_units, to_units},
        node::{set_if_changed, Node},
        path::AgreedPath,
        table::LinkNumber,
        Framing, LinkBle, Opened,
    },
    locator::{ConnectLocator, Target},
    secret_file,
};

/// The shortest and the longest timeout of one LE connect, in milliseconds.
///
/// It is short because the peer was just discovered, and because a pending connect disturbs the Pi's Wi-Fi
/// (raspberrypi/linux#1444). It varies because the kernel does not advertise while it connects: two robots that dial each
/// other at the same pace would wait for each other forever. It is longer than BlueZ's default advertising interval of
/// 1.28 s, because the peer accepts the connect only when it advertises next.
const CONNECT_TIMEOUT_MS: (u64, u64) = (1500, 4000);
/// Number of attempts of one LE connect if the connection is not established. In a hall with 45 robots, one connect request
/// in five collides with an advertisement.
const CONNECT_ATTEMPTS: u32 = 3;
/// How long to yield to the dial of a peer that may have discovered this node at the same time. Two simultaneous dials cost
/// seconds: radios and kernels confuse them ([`BleError::Misdirected`]), and both have to be abandoned.
const YIELD_TIME: Duration = Duration::from_millis(400);
/// How much longer a connect may take if the two may have to be paired first. A passkey of 20 bits takes 40 messages in each
/// direction (Core Specification, Vol 3, Part H, 2.3.5.6.3), each of which takes a connection interval of about 50 ms.
const PAIRING: Duration = Duration::from_secs(4);

/// Dials a peer once. Waits until the peer is discovered and has no link, for at most `locator.timeout` in total.
///
/// # Errors
/// Fails if there is no link within the timeout, if the peer is linked already or refuses, or if the radio or the
/// handshake fails.
pub(crate) async fn dial(
    node: &Arc<Node>,
    locator: &ConnectLocator,
    path: Option<PathOf>,
) -> Result<Arc<LinkBle>, BleError> {
    let adapter = node.adapter(locator.adapter.as_deref())?;
    let start = Instant::now();
    let mut step = DialStep::OtherDial;
    let dialling = dial_when_free(node, &adapter, locator, path, &mut step);
    if let Ok(dialled) = tokio::time::timeout(locator.timeout, dialling).await {
        return dialled;
    }
    if node.link_table().is_linked(&locator.target) {
        return Err(already_linked(locator));
    }
    let target = locator.target.to_string();
    Err(match step {
        DialStep::Discovery => BleError::NotFound {
            target,
            adapter: adapter.radio.name().to_owned(),
            waited: start.elapsed(),
        },
        step => BleError::DialTimedOut {
            target,
            step,
            limit: locator.timeout,
        },
    })
}

/// Dials the peer once there is no link with it and no other dial to it. Sets `step` to the current step.
async fn dial_when_free(
    node: &Arc<Node>,
    adapter: &Arc<Adapter>,
    locator: &ConnectLocator,
    path: Option<PathOf>,
    step: &mut DialStep,
) -> Result<Arc<LinkBle>, BleError> {
    let cancel = CancellationToken::new();
    let mut dialling = loop {
        let link_ended = node.link_ended.notified();
        if let Some(dialling) = DialEntry::begin(node, &locator.target, &cancel) {
            break dialling;
        }
        // There is a link or a dial already. Wait until it ends.
        link_ended.await;
    };
    tokio::select! {
        linked = dial_once(node, adapter, locator, path, &mut dialling, step) => linked,
        () = cancel.cancelled() => Err(already_linked(locator)),
    }
}

/// Discovers the peer and opens a link.
async fn dial_once(
    node: &Arc<Node>,
    adapter: &Arc<Adapter>,
    locator: &ConnectLocator,
    path: Option<PathOf>,
    dialling: &mut DialEntry,
    step: &mut DialStep,
) -> Result<Arc<LinkBle>, BleError> {
    *step = DialStep::Discovery;
    let candidate = adapter
        .scanner
        .find(|report| Candidate::of(report, locator).filter(|c| may_be_dialled(node, locator, c)))
        .await?;
    *step = DialStep::Connect;
    node.link_table()
        .on_discovered(dialling.number, candidate.device);
    if yields_to(node, &candidate) {
        tokio::time::sleep(YIELD_TIME).await;
    }
    let dial = DialOf {
        number: dialling.number,
        path,
    };
    let mut connection = adapter.connections.use_one(candidate.device);
    let opened = open(node, dial, adapter, locator, &candidate, step).await;
    let gives_way = matches!(
        opened,
        Err(BleError::AlreadyLinked { .. }
            | BleError::Refused {
                refusal: Refusal::AlreadyLinked | Refusal::Crossing,
                ..
            })
    );
    // The channel that the peer has dialled may need the connection.
    if opened.is_err() && !gives_way {
        connection.end_here();
    }
    let is_rejected = match &opened {
        Err(BleError::NoSharedSecret { .. }) => true,
        Err(BleError::Refused { refusal, .. }) => *refusal == Refusal::Secret,
        _ => false,
    };
    if is_rejected {
        node.on_rejected(candidate.device);
    }
    let Dialled {
        channel,
        peer,
        protection,
        exporter,
        offered,
    } = opened?;
    let mtu = agreed_mtu(&channel, locator.mtu, peer.as_ref(), protection.overhead())?;
    let replaced = CancellationToken::new();
    let device = channel.peer();
    dialling
        .succeed(peer.as_ref(), device, replaced.clone())
        // The second link is refused by this side, and not by the peer.
        .map_err(|_| already_linked(locator))?;
    let new_link = NewLink {
        device,
        default: adapter.radio.default_interval(),
        is_central: channel.is_central().unwrap_or(true),
        can_change: adapter.radio.changes_open_connections(),
    };
    let answered = peer
        .as_ref()
        .and_then(|peer| from_units(peer.intervals.as_ref()?));
    let own = offered.clone();
    let interval = (node.intervals()).on_accepted(dialling.number, new_link, offered, answered);
    let agreed = |peer: &Hello| {
        Some(AgreedPath {
            of: peer.path.filter(|_| path.is_some())?,
            node: peer.node,
            accepts_compressed: peer.accepts_compressed,
        })
    };
    let opened = Opened {
        path: peer.as_ref().and_then(agreed),
        exporter,
        framing: Framing::with(&channel, peer.as_ref(), protection, None),
        channel,
        adapter: Arc::clone(adapter),
        connection: Some(connection),
        mtu,
        queueing: locator.queueing,
        peer_name: peer.map_or_else(|| locator.target.to_string(), |p| p.name),
        is_paired: locator.security != Security::Low,
        replaced,
    };
    let link = LinkBle::new(Arc::clone(node), dialling.number, opened).map_err(|error| {
        BleError::Protocol {
            peer: device,
            what: error.to_string(),
        }
    })?;
    set_if_changed(adapter.radio.as_ref(), device, own, Some(interval)).await;
    node.perform_for_new_link();
    // A link that has ended meanwhile is not handed to Zenoh.
    link.check().map(|()| link)
}

/// A channel to a peer after the handshake.
struct Dialled {
    channel: Arc<dyn Channel>,
    /// The hello of the peer, or `None` for a plain peer.
    peer: Option<Hello>,
    protection: Protection,
    exporter: Option<Exporter>,
    /// The connection intervals that this side has offered.
    offered: Option<Intervals>,
}

/// The number of a dial, and the link of which its channel becomes a path.
#[derive(Clone, Copy)]
struct DialOf {
    number: LinkNumber,
    path: Option<PathOf>,
}

/// Connects a channel and performs the handshake, unless the peer is a plain peer.
async fn open(
    node: &Arc<Node>,
    dial: DialOf,
    adapter: &Adapter,
    locator: &ConnectLocator,
    candidate: &Candidate,
    step: &mut DialStep,
) -> Result<Dialled, BleError> {
    let mut limit = connect_timeout(node.id, dial.number);
    if locator.security != Security::Low {
        limit += PAIRING;
    }
    let secret = match &locator.secret {
        Some(file) => Some(secret_file::read(file)?),
        None => node.secret(),
    };
    let options = channel_options(locator.security, secret.as_ref())?;
    // A plain peer cannot prove a secret. If there is one, the peer is dialled only if the locator has `plain=true`.
    let is_plain = locator.plain.unwrap_or(candidate.plain);
    if is_plain && locator.plain.is_none() && secret.is_some() {
        return Err(BleError::NoSharedSecret {
            peer: candidate.device,
        });
    }
    node.wait_for_handshakes_with(candidate.device).await;
    adapter
        .connections
        .wait_until_closed(candidate.device)
        .await;
    let mut offered = node
        .request_interval(adapter.radio.as_ref(), candidate.device)
        .await;
    if offered.is_some() && !adapter.radio.changes_open_connections() {
        // The connection of an ended link would keep its interval.
        adapter.connections.close_remaining(candidate.device).await;
    }
    let channel = connect(adapter, options, candidate, limit).await?;
    if channel.is_central() == Some(false) {
        offered = Some(node.intervals().for_peripheral());
    }
    if is_plain {
        return Ok(Dialled {
            channel,
            peer: None,
            protection: Protection::checks(),
            exporter: None,
            offered,
        });
    }
    *step = DialStep::Handshake;
    let own = Hello {
        version: VERSION,
        node: node.id,
        mtu: locator.mtu,
        window: own_window(&channel),
        name: node.name(),
        intervals: offered.as_ref().map(to_units),
        path: dial.path,
        accepts_compressed: true,
    };
    if !node.link_table().on_sending_hello(dial.number) {
        return Err(already_linked(locator));
    }
    let mut handshake = HandshakeChannel::new(&channel);
    let peer = handshake.dial(own, secret.as_ref()).await?;
    let (protection, exporter) = handshake.finish();
    Ok(Dialled {
        channel,
        peer: Some(peer),
        protection,
        exporter,
        offered,
    })
}

/// Connects a channel within `limit`. An adapter has one pending connect at a time.
async fn connect(
    adapter: &Adapter,
    options: ChannelOptions,
    candidate: &Candidate,
    limit: Duration,
) -> Result<Arc<dyn Channel>, BleError> {
    let _one_at_a_time = adapter
        .connecting
        .acquire()
        .await
        .map_err(|_| BleError::ShuttingDown)?;
    let connected = async {
        let mut attempts = CONNECT_ATTEMPTS;
        loop {
            attempts -= 1;
            match (adapter.radio)
                .connect(candidate.device, candidate.psm, options)
                .await
            {
                // The advertiser has not received the connect request, which collided with another packet.
                Err(RadioError::ChannelDown { .. }) if attempts > 0 => {}
                connected => return connected,
            }
        }
    };
    match tokio::time::timeout(limit, connected).await {
        Ok(channel) => Ok(channel?),
        Err(_) => Err(BleError::Radio(RadioError::TimedOut {
            action: "connecting to a peer that was just discovered",
            limit,
        })),
    }
}

/// Returns the timeout of a connect. It is pseudorandom but depends only on the node and the dial, so that tests are
/// reproducible.
fn connect_timeout(node: NodeId, dial: LinkNumber) -> Duration {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&node.0.to_le_bytes());
    hasher.update(&dial.0.to_le_bytes());
    let (min, max) = CONNECT_TIMEOUT_MS;
    Duration::from_millis(min + u64::from(hasher.finalize()) % (max - min))
}

fn already_linked(locator: &ConnectLocator) -> BleError {
    BleError::AlreadyLinked {
        target: locator.target.to_string(),
    }
}

/// Returns whether this node waits for a moment in case the peer dials it, too. Of two nodes that listen, the one with the
/// lower hash of its name takes precedence.
fn yields_to(node: &Node, candidate: &Candidate) -> bool {
    let name = node.name();
    let own = Advertisement::hash_of_name(&name);
    !name.is_empty() && candidate.name_hash.is_some_and(|peer| peer < own)
}

/// Returns whether a candidate may be dialled. If the target is a fleet, the candidate must be another node, must have
/// no link or dial yet, and must not be a rejected peer.
fn may_be_dialled(node: &Node, locator: &ConnectLocator, candidate: &Candidate) -> bool {
    let own = Advertisement::hash_of_name(&node.name());
    match locator.target {
        Target::Fleet(_) => {
            let is_linked = node.link_table().is_linked_or_dialled(candidate.device);
            candidate.name_hash != Some(own) && !is_linked && !node.is_rejected(candidate.device)
        }
        Target::Address(_) | Target::Name(_) => true,
    }
}

/// A discovered peer that matches the target of a dial.
struct Candidate {
    device: DeviceAddress,
    psm: Psm,
    plain: bool,
    name_hash: Option<u32>,
}

impl Candidate {
    fn of(report: &AdvertisingReport, locator: &ConnectLocator) -> Option<Self> {
        let advertised = report.advertisement.as_ref();
        let is_target = match &locator.target {
            Target::Address(address) => *address == report.device.address,
            Target::Name(name) => advertised.is_some_and(|a| a.matches_name(name)),
            Target::Fleet(fleet) => {
                let hash = Advertisement::hash_of_fleet(fleet);
                advertised.is_some_and(|a| a.fleet_hash == hash)
            }
        };
        let psm = locator.psm.or(advertised.map(|a| a.psm));
        let device = DeviceAddress {
            kind: locator.address_kind.unwrap_or(report.device.kind),
            ..report.device
        };
        psm.filter(|_| is_target).map(|psm| Self {
            device,
            psm,
            plain: advertised.is_some_and(|a| a.plain),
            name_hash: advertised.map(|a| a.name_hash),
        })
    }
}

/// A dial in the table of links. It is removed from the table if it is dropped without success.
struct DialEntry {
    node: Arc<Node>,
    number: LinkNumber,
    succeeded: bool,
}

impl DialEntry {
    fn begin(node: &Arc<Node>, target: &Target, cancel: &CancellationToken) -> Option<Self> {
        let number = node.link_table().on_dial(target, cancel.clone())?;
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
        let accepted = (self.node.link_table()).on_accepted(self.number, peer, device, now, end);
        // Another dial to the same fleet may begin now.
        self.node.link_ended.notify_waiters();
        accepted
    }
}

impl Drop for DialEntry {
    fn drop(&mut self) {
        if !self.succeeded {
            self.node.link_table().on_dial_ended(self.number);
            self.node.link_ended.notify_waiters();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenoh_link_ble_air::{AirOptions, SimAir, SimRadio};
    use zenoh_link_ble_radio::Radio;

    const LISTENER: ChannelOptions = ChannelOptions {
        recv_mtu: 1024,
        security: Security::Low,
        passkey: None,
    };

    /// Returns a node with the radio `sim-a`, and the radio of its peer.
    async fn node_and_peer() -> (Arc<Node>, Arc<SimRadio>) {
        let air = SimAir::new(AirOptions::default());
        let radio: Arc<dyn Radio> = air.radio("sim-a").await.expect("attaches");
        let peer = air.radio("sim-b").await.expect("attaches");
        let open_radio = Box::new(move |_: Option<&str>| Ok(Arc::clone(&radio)));
        (Node::new(NodeId(1), flume::unbounded().0, open_radio), peer)
    }

    /// Returns the error of a dial to the peer `raw`.
    async fn failed_dial(node: &Arc<Node>) -> BleError {
        let endpoint = "ble/raw#timeout=2500".parse().expect("an endpoint");
        let locator = ConnectLocator::parse(&endpoint).expect("a locator");
        match dial(node, &locator, None).await {
            Ok(_) => panic!("dialled"),
            Err(error) => error,
        }
    }

    fn assert_timed_out(error: &BleError, expected: DialStep) {
        match error {
            BleError::DialTimedOut { target, step, .. } => {
                assert_eq!((target.as_str(), *step), ("raw", expected));
            }
            other => panic!("{other}"),
        }
        let text = error.to_string();
        assert!(
            text.starts_with("cannot connect to raw within 2.5s: "),
            "{text}"
        );
    }

    #[tokio::test(start_paused = true)]
    async fn timeout_names_the_incomplete_step() {
        let (node, peer) = node_and_peer().await;
        assert!(matches!(
            failed_dial(&node).await,
            BleError::NotFound { .. }
        ));

        let target = Target::Name("raw".to_owned());
        let other_dial = DialEntry::begin(&node, &target, &CancellationToken::new());
        assert_timed_out(&failed_dial(&node).await, DialStep::OtherDial);
        drop(other_dial);

        // A listener that accepts channels and never answers.
        let listener = peer.listen(None, LISTENER).await.expect("listens");
        let advertisement = Advertisement {
            psm: listener.psm(),
            plain: false,
            name_hash: Advertisement::hash_of_name("raw"),
            fleet_hash: 0,
            incarnation: 1,
        };
        let _advertising = peer.advertise(&advertisement, "raw").await;
        let adapter = node.adapter(None).expect("the radio");
        let connecting = adapter.connecting.acquire().await.expect("open");
        assert_timed_out(&failed_dial(&node).await, DialStep::Connect);
        drop(connecting);

        let accepting = async { listener.accept().await.expect("accepts") };
        let (error, _channel) = tokio::join!(failed_dial(&node), accepting);
        assert_timed_out(&error, DialStep::Handshake);
    }
}
