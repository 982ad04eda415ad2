//! Owns listening: on one adapter, take channels, hear hellos, hand links to Zenoh; come back when the adapter does.
use std::{future::Future, sync::Arc, time::Duration};

use parking_lot::Mutex;
use tokio::{task::JoinSet, time::Instant};
use tokio_util::sync::CancellationToken;
use zenoh_link_commons::{LinkUnicast, LinkUnicastTrait};

use crate::{
    adapter::Adapter,
    address::DeviceAddress,
    advertisement::Advertisement,
    error::{in_words, BleError},
    handshakes::{Admission, Handshakes, Place, PLACES},
    hello::{Hello, Opening, VERSION},
    link::{Framing, LinkBle, Opened},
    links::Verdict,
    locator::ListenLocator,
    namesake::{NameSearch, Namesake},
    node::{Listening, Node},
    opening::{agreed_mtu, answer, channel_options, hear_hello, own_window, refuse, FirstSdu},
    radio::{AdapterState, AdvertisingGuard, Channel, ChannelListener, ChannelOptions, RadioError},
    secret::Secret,
};

/// How often to look again at an adapter that is away, beside being told.
const LOOK_AGAIN: Duration = Duration::from_secs(2);

/// A listener that is up: a channel listener and an advertisement.
pub(crate) struct Up {
    epoch: u64,
    channels: Box<dyn ChannelListener>,
    _advertising: Box<dyn AdvertisingGuard>,
}

pub(crate) struct Listener {
    node: Arc<Node>,
    adapter: Arc<Adapter>,
    locator: ListenLocator,
    name: String,
    secret: Option<Secret>,
    options: ChannelOptions,
    handshakes: Mutex<Handshakes>,
}

impl Listener {
    /// Goes on the air; fails if it can't be done now, unless an adapter that is away is to be waited for: then there is no
    /// [`Up`] yet. Links come once [`Listener::serve`] runs. The search for another robot of the same name begins with it:
    /// dialling waits for its end.
    pub(crate) async fn start(
        node: Arc<Node>,
        locator: ListenLocator,
    ) -> Result<(Arc<Self>, Option<(Up, NameSearch)>), BleError> {
        let adapter = node.adapter(Some(&locator.adapter))?;
        let name = locator.name();
        let secret = locator.secret.as_deref().map(Secret::read).transpose()?;
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
        let search = listener.namesake().search();
        let up = match listener.bring_up().await {
            Ok(up) => Some((up, search)),
            Err(error) if listener.locator.wait && error.is_adapter_away() => {
                tracing::warn!(
                    "ble: {} does not listen until there is {}: {}",
                    listener.name,
                    listener.locator.adapter,
                    in_words(&error)
                );
                None
            }
            Err(error) => return Err(error.into()),
        };
        listener.node.on_listening(Listening {
            adapter: listener.locator.adapter.clone(),
            name: listener.name.clone(),
            secret: listener.secret.clone(),
        });
        Ok((listener, up))
    }

    /// Two robots of one name would be dialled by turns: the second one to come finds out. The listener serves
    /// meanwhile, so that a robot that was away is back without delay.
    pub(crate) async fn check_name(&self, search: NameSearch) -> Result<(), BleError> {
        match search.await {
            Ok(Ok(Some(other))) => Err(self.name_taken(other)),
            Ok(Ok(None)) => Ok(()),
            Err(_) => Err(BleError::ShuttingDown),
            // The listener is up all the same: a robot that starts while its adapter is busy must not stay away.
            Ok(Err(error)) => {
                tracing::warn!(
                    "ble: whether another robot is called {} is not known: {}",
                    self.name,
                    in_words(&error)
                );
                Ok(())
            }
        }
    }

    /// Tells of a robot of the same name that is heard too late to be an error.
    pub(crate) async fn watch_name(&self) {
        self.until_on().await;
        if let Ok(Some(other)) = self.namesake().watch().await {
            tracing::error!("ble: {}", self.name_taken(other));
        }
    }

    fn namesake(&self) -> Namesake {
        Namesake {
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

    async fn bring_up(&self) -> Result<Up, RadioError> {
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
        Ok(Up {
            epoch,
            channels,
            _advertising: advertising,
        })
    }

    /// Hands links to Zenoh until the future is dropped.
    pub(crate) async fn serve(self: Arc<Self>, mut up: Option<Up>) {
        let _listening = StopsListening(Arc::clone(&self));
        let mut greetings = JoinSet::new();
        loop {
            let running = match up.take() {
                Some(running) => running,
                None => self.come_back().await,
            };
            let reason = self.accept_while_on(&running, &mut greetings).await;
            tracing::warn!(
                "ble: {} is away: {reason}; listening again when it is back",
                self.locator.adapter
            );
        }
    }

    /// Takes channels until the adapter is off or gone; tells why.
    async fn accept_while_on(self: &Arc<Self>, up: &Up, greetings: &mut JoinSet<()>) -> String {
        let radio = &self.adapter.radio;
        loop {
            tokio::select! {
                accepted = up.channels.accept() => match accepted {
                    Ok(channel) => {
                        if let Some(held) = HeldPlace::of(self, channel.peer()) {
                            let listener = Arc::clone(self);
                            greetings.spawn(async move { listener.greet(channel, held).await });
                        }
                    }
                    Err(error) => return error.to_string(),
                },
                Some(_) = greetings.join_next() => {}
                () = wait_for_change(radio.as_ref()) => match radio.state().await {
                    AdapterState::On if radio.epoch() == up.epoch => {}
                    AdapterState::On => return "it, or bluetoothd, was restarted".to_owned(),
                    AdapterState::Off => return "it is switched off".to_owned(),
                    AdapterState::Missing => return "it is gone".to_owned(),
                },
            }
        }
    }

    async fn come_back(&self) -> Up {
        let mut complained = false;
        loop {
            self.until_on().await;
            match self.bring_up().await {
                Ok(up) => return up,
                Err(error) if !complained => {
                    complained = true;
                    tracing::warn!(
                        "ble: {} does not listen yet: {}",
                        self.locator.adapter,
                        in_words(&error)
                    );
                }
                Err(_) => {}
            }
            wait_for_change(self.adapter.radio.as_ref()).await;
        }
    }

    async fn until_on(&self) {
        while self.adapter.radio.state().await != AdapterState::On {
            wait_for_change(self.adapter.radio.as_ref()).await;
        }
    }

    /// Hears a peer's hello, answers it, and hands the link over. Whatever goes wrong ends this channel only.
    async fn greet(&self, channel: Arc<dyn Channel>, held: HeldPlace) {
        let peer = channel.peer();
        let greeting = self.node.on_greeting(peer);
        let opened = self.open(channel, peer, held).await;
        drop(greeting);
        match opened {
            Ok(Some(link)) => {
                let link: Arc<dyn LinkUnicastTrait> = link;
                if self
                    .node
                    .new_links
                    .send_async(LinkUnicast::from(link))
                    .await
                    .is_err()
                {
                    tracing::debug!("ble: {peer} came while this router stops");
                }
            }
            Ok(None) => {}
            Err(error) => {
                if let BleError::Astray { .. } = error {
                    self.node.links().on_astray(peer);
                }
                tracing::warn!("ble: no link with {peer}: {}", in_words(&error));
            }
        }
    }

    async fn open(
        &self,
        channel: Arc<dyn Channel>,
        device: DeviceAddress,
        held: HeldPlace,
    ) -> Result<Option<Arc<LinkBle>>, BleError> {
        let heard = hear_hello(&channel, self.node.id, self.secret.as_ref());
        let Some(heard) = held.unless_evicted(heard).await else {
            return Ok(None);
        };
        let (peer, first) = match heard? {
            FirstSdu::Hello(hello) => (Some(hello), None),
            FirstSdu::Plain(batch) => (None, Some(batch)),
        };
        let mtu = agreed_mtu(&channel, self.locator.mtu, peer.as_ref())?;
        let replaced = CancellationToken::new();
        let (verdict, number) = self.node.links().on_hello(
            &self.name,
            peer.as_ref(),
            device,
            self.locator.max_links,
            Instant::now().into_std(),
            replaced.clone(),
        );
        let number = match (verdict, number) {
            (Verdict::Accept, Some(number)) => number,
            (Verdict::Refuse(refusal), _) => {
                let reason = refusal.own_reason();
                tracing::info!("ble: refused a link with {device}: {reason}");
                if peer.is_some() {
                    if let Some(refused) = held.unless_evicted(refuse(&channel, refusal)).await {
                        // Its handshake was a right one all the same.
                        held.succeed();
                        refused?;
                    }
                }
                return Ok(None);
            }
            (Verdict::Accept, None) => return Ok(None),
        };
        // From here on max_links is the bound.
        held.succeed();
        let opened = Opened {
            channel: Arc::clone(&channel),
            framing: Framing::with(&channel, peer.as_ref(), first),
            mtu,
            queueing: self.locator.queueing,
            peer_name: peer.as_ref().map_or_else(String::new, |p| p.name.clone()),
            replaced,
        };
        let link = LinkBle::new(Arc::clone(&self.node), number, opened).map_err(|error| {
            self.node.on_link_closed(number);
            BleError::Protocol {
                peer: device,
                what: error.to_string(),
            }
        })?;
        if let Some(peer) = peer {
            let own = Hello {
                version: VERSION.min(peer.version),
                node: self.node.id,
                mtu: self.locator.mtu,
                window: own_window(&channel),
                name: self.name.clone(),
                nonce: None,
            };
            answer(&channel, Opening::Accept(own)).await?;
        }
        tokio::select! {
            () = self.node.pause(number) => {}
            () = link.ended() => {}
        }
        // Zenoh gets no link that ended meanwhile.
        link.check().map(|()| Some(link))
    }
}

/// The place of a handshake; dropping it frees the place.
struct HeldPlace {
    listener: Arc<Listener>,
    place: Place,
    evicted: CancellationToken,
}

impl HeldPlace {
    /// Takes a place for a new channel, which may end an older handshake; `None` if others come first.
    fn of(listener: &Arc<Listener>, device: DeviceAddress) -> Option<Self> {
        let evicted = CancellationToken::new();
        let now = Instant::now().into_std();
        let admission = (listener.handshakes.lock()).on_channel(device, evicted.clone(), now);
        let place = match admission {
            Admission::Admitted(place) => place,
            Admission::InsteadOf(place, loser) => {
                tracing::debug!("ble: dropped an unfinished handshake with {loser} for {device}");
                place
            }
            Admission::TurnedAway => {
                tracing::debug!("ble: turned away {device}: {PLACES} handshakes are under way");
                return None;
            }
        };
        Some(Self {
            listener: Arc::clone(listener),
            place,
            evicted,
        })
    }

    /// Runs a step of the handshake; `None` if a newer channel takes this one's place meanwhile.
    async fn unless_evicted<T>(&self, step: impl Future<Output = T>) -> Option<T> {
        self.evicted.run_until_cancelled(step).await
    }

    /// Frees the place after a handshake that succeeded.
    fn succeed(self) {
        self.listener.handshakes.lock().on_succeeded(self.place);
    }
}

impl Drop for HeldPlace {
    fn drop(&mut self) {
        // Does nothing after a success.
        let now = Instant::now().into_std();
        self.listener.handshakes.lock().on_failed(self.place, now);
    }
}

/// Takes this node's listener off the list when its task ends, however it ends.
struct StopsListening(Arc<Listener>);

impl Drop for StopsListening {
    fn drop(&mut self) {
        self.0.node.on_listening_ended(&self.0.locator.adapter);
    }
}

/// Told by the radio, or after a while: an event between two looks must not be missed for ever.
async fn wait_for_change(radio: &dyn crate::radio::Radio) {
    let _ = tokio::time::timeout(LOOK_AGAIN, radio.changed()).await;
}
