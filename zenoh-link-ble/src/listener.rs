//! Listens on one adapter: advertises, accepts channels, performs handshakes and hands the links to Zenoh. Listens again
//! after the adapter was unavailable.
use std::{future::Future, sync::Arc, time::Duration};

use link_lanes::{
    hello::{HandshakeMessage, Hello, Refusal, VERSION},
    secret::Secret,
};
use parking_lot::Mutex;
use tokio::{task::JoinSet, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_ble_radio::{
    address::DeviceAddress, advertisement::Advertisement, interval_table::NewLink, AdapterState,
    AdvertisingGuard, Channel, ChannelListener, ChannelOptions, RadioError, Security,
};
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait};

use crate::{
    adapter::Adapter,
    connections::ConnectionGuard,
    error::{describe, BleError},
    handshake::{agreed_mtu, channel_options, own_window, FirstSdu, HandshakeChannel},
    link::{
        interval_units::{from_units, to_units},
        node::{set_if_changed, ListenerIdentity, Node},
        path::{AgreedPath, BlePath},
        table::Verdict,
        Framing, LinkBle, Opened,
    },
    locator::ListenLocator,
    name_conflict::{NameConflictCheck, NameSearch},
    pending_handshakes::{Admission, HandshakeId, PendingHandshakes, MAX_HANDSHAKES},
    secret_file,
};

/// How often the state of the adapter is checked in addition to the radio's notifications.
const STATE_POLL_INTERVAL: Duration = Duration::from_secs(2);

/// The resources of a listener on an adapter that is on: a channel listener and an advertisement.
pub(crate) struct BoundListener {
    epoch: u64,
    channels: Box<dyn ChannelListener>,
    _advertising: Box<dyn AdvertisingGuard>,
}

/// A listener on one adapter, with the handshakes that are in progress.
pub(crate) struct Listener {
    node: Arc<Node>,
    adapter: Arc<Adapter>,
    locator: ListenLocator,
    name: String,
    secret: Option<Secret>,
    options: ChannelOptions,
    handshakes: Mutex<PendingHandshakes>,
}

impl Listener {
    /// Begins to listen and to advertise, and searches for another robot with the same name; dialling waits for the result.
    /// Links are accepted once [`Listener::serve`] runs. If the adapter is unavailable and the locator has `wait=true`, there
    /// is no [`BoundListener`] yet.
    ///
    /// # Errors
    /// Fails if the secret cannot be read or the radio reports an error.
    pub(crate) async fn start(
        node: Arc<Node>,
        locator: ListenLocator,
    ) -> Result<(Arc<Self>, Option<(BoundListener, NameSearch)>), BleError> {
        let adapter = node.adapter(Some(&locator.adapter))?;
        let name = locator.name();
        let secret = locator
            .secret
            .as_deref()
            .map(secret_file::read)
            .transpose()?;
        let options = channel_options(locator.security, secret.as_ref())?;
        let listener = Arc::new(Self {
            node,
            adapter,
            locator,
            name,
            secret,
            options,
            handshakes: Mutex::default(),
        });
        let search = listener.name_conflict_check().search();
        let bound = match listener.bind().await {
            Ok(bound) => Some((bound, search)),
            Err(error) if listener.locator.wait && error.is_adapter_unavailable() => {
                tracing::warn!(
                    "ble: {} does not listen until {} is available: {}",
                    listener.name,
                    listener.locator.adapter,
                    describe(&error)
                );
                None
            }
            Err(error) => return Err(error.into()),
        };
        listener.node.on_listening(ListenerIdentity {
            adapter: listener.locator.adapter.clone(),
            name: listener.name.clone(),
            secret: listener.secret.clone(),
        });
        Ok((listener, bound))
    }

    /// Waits for the result of the search for another robot with the same name. Peers would dial either of the two, so the
    /// second robot to start reports the conflict. The listener serves meanwhile, so that peers can reconnect to a restarted
    /// robot without delay.
    ///
    /// # Errors
    /// Fails if another robot uses the name.
    pub(crate) async fn check_name(&self, search: NameSearch) -> Result<(), BleError> {
        match search.await {
            Ok(Ok(Some(other))) => Err(self.name_taken(other)),
            Ok(Ok(None)) => Ok(()),
            Err(_) => Err(BleError::ShuttingDown),
            // The listener continues. A robot must be reachable even if its adapter is busy when it starts.
            Ok(Err(error)) => {
                tracing::warn!(
                    "ble: cannot find out whether another robot uses the name {}: {}",
                    self.name,
                    describe(&error)
                );
                Ok(())
            }
        }
    }

    /// Logs an error if another robot with the same name is discovered after [`Listener::check_name`].
    pub(crate) async fn watch_name(&self) {
        self.until_on().await;
        if let Ok(Some(other)) = self.name_conflict_check().watch().await {
            tracing::error!("ble: {}", self.name_taken(other));
        }
    }

    fn name_conflict_check(&self) -> NameConflictCheck {
        NameConflictCheck {
            adapter: Arc::clone(&self.adapter),
            name: self.name.clone(),
            incarnation: self.node.incarnation(),
        }
    }

    fn name_taken(&self, other: DeviceAddress) -> BleError {
        BleError::NameTaken {
            name: self.name.clone(),
            other,
        }
    }

    /// Opens the channel listener and begins to advertise.
    async fn bind(&self) -> Result<BoundListener, RadioError> {
        let radio = &self.adapter.radio;
        let epoch = radio.epoch();
        let channels = radio.listen(self.locator.psm, self.options).await?;
        let fleet = self.locator.fleet.as_ref();
        let advertisement = Advertisement {
            psm: channels.psm(),
            plain: false,
            name_hash: Advertisement::hash_of_name(&self.name),
            fleet_hash: fleet.map_or(0, |fleet| Advertisement::hash_of_fleet(fleet)),
            incarnation: self.node.incarnation(),
        };
        let advertising = radio.advertise(&advertisement, &self.name).await?;
        tracing::info!(
            "ble: {} listens on {} (psm {})",
            self.name,
            self.locator.adapter,
            channels.psm()
        );
        Ok(BoundListener {
            epoch,
            channels,
            _advertising: advertising,
        })
    }

    /// Hands links to Zenoh until the future is dropped.
    pub(crate) async fn serve(self: Arc<Self>, mut bound: Option<BoundListener>) {
        let _listening = ListeningGuard(Arc::clone(&self));
        let mut handshakes = JoinSet::new();
        loop {
            let running = match bound.take() {
                Some(running) => running,
                None => self.rebind().await,
            };
            let reason = self.accept_while_on(&running, &mut handshakes).await;
            tracing::warn!(
                "ble: {} is unavailable: {reason}; listening again when it is available",
                self.locator.adapter
            );
        }
    }

    /// Accepts channels until the adapter is off or missing, and returns the reason.
    async fn accept_while_on(
        self: &Arc<Self>,
        bound: &BoundListener,
        handshakes: &mut JoinSet<()>,
    ) -> String {
        let radio = &self.adapter.radio;
        loop {
            tokio::select! {
                accepted = bound.channels.accept() => match accepted {
                    Ok(channel) => {
                        let connection = self.adapter.connections.use_one(channel.peer());
                        if let Some(permit) = HandshakePermit::acquire(self, channel.peer()) {
                            let listener = Arc::clone(self);
                            handshakes.spawn(async move {
                                listener.handle_channel(channel, connection, permit).await;
                            });
                        }
                    }
                    Err(error) => return error.to_string(),
                },
                Some(_) = handshakes.join_next() => {}
                () = wait_for_change(radio.as_ref()) => match radio.state().await {
                    AdapterState::On if radio.epoch() == bound.epoch => {}
                    AdapterState::On => return "it, or bluetoothd, was restarted".to_owned(),
                    AdapterState::Off => return "it is switched off".to_owned(),
                    AdapterState::Missing => return "it was removed".to_owned(),
                },
            }
        }
    }

    /// Waits until the adapter is on again and binds to it. Only the first error is logged.
    async fn rebind(&self) -> BoundListener {
        let mut has_warned = false;
        loop {
            self.until_on().await;
            match self.bind().await {
                Ok(bound) => return bound,
                Err(error) if !has_warned => {
                    has_warned = true;
                    tracing::warn!(
                        "ble: cannot listen on {} yet: {}",
                        self.locator.adapter,
                        describe(&error)
                    );
                }
                Err(_) => {}
            }
            wait_for_change(self.adapter.radio.as_ref()).await;
        }
    }

    /// Waits until the adapter is on.
    async fn until_on(&self) {
        while self.adapter.radio.state().await != AdapterState::On {
            wait_for_change(self.adapter.radio.as_ref()).await;
        }
    }

    /// Performs the handshake on a channel and hands the link to Zenoh. An error ends only this channel.
    async fn handle_channel(
        &self,
        channel: Arc<dyn Channel>,
        connection: ConnectionGuard,
        permit: HandshakePermit,
    ) {
        let peer = channel.peer();
        let handshake = self.node.begin_handshake(peer);
        let mut connection = Some(connection);
        let opened = self.open(channel, peer, permit, &mut connection).await;
        drop(handshake);
        // A peer whose handshake was evicted dials again, and may use the connection for that.
        if !matches!(opened, Ok(Outcome::Evicted)) {
            connection.iter_mut().for_each(ConnectionGuard::end_here);
        }
        drop(connection);
        if let Ok(Outcome::Linked(_)) = opened {
            self.node.on_accepted(peer);
        }
        match opened {
            Ok(Outcome::Linked(link)) if link.path().is_some() => match self.node.path_acceptor() {
                Some(acceptor) => acceptor.on_path(BlePath::new(link)),
                None => tracing::debug!("ble: dropped a path from {peer}: the router is stopping"),
            },
            Ok(Outcome::Linked(link)) => {
                let link: Arc<dyn LinkUnicastTrait> = link;
                if self
                    .node
                    .new_links
                    .send_async(LinkUnicast::from(link))
                    .await
                    .is_err()
                {
                    tracing::debug!("ble: dropped a link with {peer}: the router is stopping");
                }
            }
            Ok(Outcome::Refused | Outcome::Evicted) => {}
            Err(error) => {
                if let BleError::Misdirected { .. } = error {
                    self.node.link_table().on_misdirected(peer);
                }
                self.node.on_refused(peer, &describe(&error).to_string());
            }
        }
    }

    /// Performs the handshake. A link takes `connection`.
    async fn open(
        &self,
        channel: Arc<dyn Channel>,
        device: DeviceAddress,
        permit: HandshakePermit,
        connection: &mut Option<ConnectionGuard>,
    ) -> Result<Outcome, BleError> {
        let mut handshake = HandshakeChannel::new(&channel);
        let received = handshake.receive_hello(self.secret.as_ref());
        let Some(received) = permit.unless_evicted(received).await else {
            return Ok(Outcome::Evicted);
        };
        let (peer, first) = match received? {
            FirstSdu::Hello(hello) => (Some(hello), None),
            FirstSdu::Plain(batch) => (None, Some(batch)),
        };
        let mtu = agreed_mtu(
            &channel,
            self.locator.mtu,
            peer.as_ref(),
            handshake.overhead(),
        )?;
        let path = peer.as_ref().and_then(|peer| peer.path);
        let acceptor = self.node.path_acceptor();
        let path = path.filter(|_| acceptor.is_some());
        let max_links = self.locator.max_links;
        let node = peer.as_ref().map(|peer| peer.node);
        let free_places = (self.node.link_table()).free_places(node, device, max_links);
        if let (Some(peer), Some(acceptor)) = (&peer, &acceptor) {
            if let Some(refusal) = acceptor.refusal(&peer.name, peer.node, path, free_places) {
                permit.succeed();
                handshake.refuse(refusal).await?;
                return Ok(Outcome::Refused);
            }
        }
        let replaced = CancellationToken::new();
        let (verdict, number) = self.node.link_table().on_hello(
            &self.name,
            peer.as_ref(),
            device,
            max_links,
            Instant::now().into_std(),
            replaced.clone(),
        );
        let takes_place = matches!(verdict, Verdict::Accept | Verdict::Refuse(Refusal::Full));
        if let Some(acceptor) = acceptor.filter(|_| takes_place && free_places <= 1) {
            acceptor.make_room();
        }
        let number = match (verdict, number) {
            (Verdict::Accept, Some(number)) => number,
            (Verdict::Refuse(refusal), _) => {
                let reason = refusal.own_reason();
                tracing::info!("ble: refused a link with {device}: {reason}");
                if peer.is_some() {
                    if let Some(refused) = permit.unless_evicted(handshake.refuse(refusal)).await {
                        // The peer completed a correct handshake, although it was refused.
                        permit.succeed();
                        refused?;
                    }
                }
                return Ok(Outcome::Refused);
            }
            (Verdict::Accept, None) => return Ok(Outcome::Refused),
        };
        // From here on, max_links limits the number of links.
        permit.succeed();
        // Also for a plain peer, whose interval is most likely the default.
        let radio = &self.adapter.radio;
        let is_central = channel.is_central().unwrap_or(false);
        let own = match is_central {
            true => self.node.request_interval(radio.as_ref(), device).await,
            false => None,
        };
        let new_link = NewLink {
            device,
            default: radio.default_interval(),
            is_central,
            can_change: radio.changes_open_connections(),
        };
        let offered = peer
            .as_ref()
            .and_then(|peer| from_units(peer.intervals.as_ref()?));
        let intervals = (self.node.intervals()).on_dialled(number, new_link, own.clone(), offered);
        set_if_changed(radio.as_ref(), device, own, intervals.requested).await;
        if let Some(peer) = &peer {
            let own = Hello {
                version: VERSION.min(peer.version),
                node: self.node.id,
                mtu: self.locator.mtu,
                window: own_window(&channel),
                name: self.name.clone(),
                intervals: Some(to_units(&intervals)),
                path,
                accepts_compressed: true,
            };
            let accepted = handshake.answer(&HandshakeMessage::Accept(own)).await;
            if let Err(error) = accepted {
                self.node.on_link_closed(number);
                return Err(error);
            }
        }
        let (protection, exporter) = handshake.finish();
        let opened = Opened {
            path: peer.as_ref().and_then(|peer| {
                Some(AgreedPath {
                    of: path?,
                    node: peer.node,
                    accepts_compressed: peer.accepts_compressed,
                })
            }),
            exporter,
            channel: Arc::clone(&channel),
            adapter: Arc::clone(&self.adapter),
            connection: connection.take(),
            framing: Framing::with(&channel, peer.as_ref(), protection, first),
            mtu,
            queueing: self.locator.queueing,
            peer_name: peer.as_ref().map_or_else(String::new, |p| p.name.clone()),
            is_paired: self.locator.security != Security::Low,
            replaced,
        };
        let link = LinkBle::new(Arc::clone(&self.node), number, opened).map_err(|error| {
            self.node.on_link_closed(number);
            BleError::Protocol {
                peer: device,
                what: error.to_string(),
            }
        })?;
        self.node.perform_for_new_link();
        // A link that has ended meanwhile is not handed to Zenoh.
        link.check().map(|()| Outcome::Linked(link))
    }
}

/// The result of a handshake.
enum Outcome {
    Linked(Arc<LinkBle>),
    /// This side has refused the link.
    Refused,
    /// Another handshake took its place.
    Evicted,
}

/// The permission to perform a handshake. Dropping it ends the handshake.
struct HandshakePermit {
    listener: Arc<Listener>,
    id: HandshakeId,
    evicted: CancellationToken,
}

impl HandshakePermit {
    /// Requests a permit for a new channel, which may evict an older handshake. Returns `None` if others take precedence.
    fn acquire(listener: &Arc<Listener>, device: DeviceAddress) -> Option<Self> {
        let evicted = CancellationToken::new();
        let now = Instant::now().into_std();
        let admission = (listener.handshakes.lock()).on_channel(device, evicted.clone(), now);
        let id = match admission {
            Admission::Admitted(id) => id,
            Admission::AdmittedInsteadOf(id, replaced) => {
                tracing::debug!(
                    "ble: dropped an unfinished handshake with {replaced} in favour of {device}"
                );
                id
            }
            Admission::Rejected => {
                tracing::debug!(
                    "ble: closed a channel of {device}: {MAX_HANDSHAKES} handshakes are in progress"
                );
                return None;
            }
        };
        Some(Self {
            listener: Arc::clone(listener),
            id,
            evicted,
        })
    }

    /// Runs a step of the handshake. Returns `None` if the handshake is evicted meanwhile.
    async fn unless_evicted<T>(&self, step: impl Future<Output = T>) -> Option<T> {
        self.evicted.run_until_cancelled(step).await
    }

    /// Ends the handshake as a success.
    fn succeed(self) {
        self.listener.handshakes.lock().on_succeeded(self.id);
    }
}

impl Drop for HandshakePermit {
    fn drop(&mut self) {
        // This has no effect after a success.
        let now = Instant::now().into_std();
        self.listener.handshakes.lock().on_failed(self.id, now);
    }
}

/// Removes this listener from its node when its task ends.
struct ListeningGuard(Arc<Listener>);

impl Drop for ListeningGuard {
    fn drop(&mut self) {
        self.0.node.on_listening_ended(&self.0.locator.adapter);
    }
}

/// Waits until the radio reports a change, or for [`STATE_POLL_INTERVAL`], so that an event between two calls is not missed
/// forever.
async fn wait_for_change(radio: &dyn zenoh_link_ble_radio::Radio) {
    let _ = tokio::time::timeout(STATE_POLL_INTERVAL, radio.changed()).await;
}
