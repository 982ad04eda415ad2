//! Provides a peer that works directly on a channel and can violate the link protocol.
use std::{convert::Infallible, sync::Arc};

use link_lanes::{
    hello::{HandshakeMessage, Hello, NodeId, VERSION},
    lanes::{
        credits::{cost, Allowance},
        sdu::{Content, Protection},
        Lane,
    },
};
use zenoh_link_ble::locator::DEFAULT_MTU;
use zenoh_link_ble_radio::{Channel, ChannelOptions, Radio, RadioError};

use super::{
    listener::{psm_of, OPTIONS},
    peer::within,
};

/// Receive window of the raw peer, in bytes.
pub const WINDOW: u16 = 12_000;

/// Opens a channel to a listener, without a handshake.
pub async fn raw_channel(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>) -> Arc<dyn Channel> {
    raw_channel_with(from, to, OPTIONS).await
}

/// Opens a channel to a listener with the given options, without a handshake.
pub async fn raw_channel_with(
    from: &Arc<dyn Radio>,
    to: &Arc<dyn Radio>,
    options: ChannelOptions,
) -> Arc<dyn Channel> {
    let psm = psm_of(from, to).await;
    let to = to.address().await.expect("has an address");
    within("connecting", async {
        loop {
            match from.connect(to, psm, options).await {
                // The listener is closing the connection of an earlier channel.
                Err(RadioError::ChannelDown { .. }) => {}
                connected => return connected.expect("connects"),
            }
        }
    })
    .await
}

/// Returns a valid hello.
pub fn hello(node: u64, name: &str) -> Hello {
    Hello {
        version: VERSION,
        node: NodeId(node),
        mtu: DEFAULT_MTU,
        window: WINDOW,
        name: name.to_owned(),
        intervals: None,
        path: None,
        accepts_compressed: false,
    }
}

/// Sends the first SDU of a channel and returns the answer; `None` if the channel is closed without one.
pub async fn answer_to(channel: &Arc<dyn Channel>, first: &[u8]) -> Option<HandshakeMessage> {
    channel.send(first).await.expect("sends");
    let mut buffer = [0; 2000];
    let received = within("the answer", channel.recv(&mut buffer)).await;
    received
        .ok()
        .map(|size| HandshakeMessage::decode(&buffer[..size]).expect("a handshake message"))
}

/// Message that ends a flood.
#[derive(Debug, PartialEq, Eq)]
pub enum FloodEnd {
    /// The link stopped the lane.
    Stop,
    /// The link sent a goodbye with this code.
    Goodbye(u8),
}

/// One end of an open link, controlled by the test.
pub struct RawPeer {
    channel: Arc<dyn Channel>,
    /// Receive window of the link, in bytes.
    window: u16,
    /// Seals and opens the SDUs.
    pub protection: Protection,
    buffer: Vec<u8>,
}

impl RawPeer {
    /// Dials a listener and completes the handshake.
    pub async fn dial(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>, name: &str) -> Self {
        Self::dial_with(from, to, hello(5, name)).await
    }

    /// Dials a listener and completes the handshake with that hello.
    pub async fn dial_with(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>, own: Hello) -> Self {
        let channel = raw_channel(from, to).await;
        let hello = HandshakeMessage::Hello(own).encode();
        let answer = answer_to(&channel, &hello).await;
        let Some(HandshakeMessage::Accept(Hello { window, .. })) = answer else {
            panic!("{answer:?}");
        };
        Self::on(channel, window, Protection::checks())
    }

    /// Accepts a dial on a channel. Returns the dialler's hello, too.
    pub async fn accept(channel: Arc<dyn Channel>, own: Hello) -> (Self, Hello) {
        let mut buffer = [0; 200];
        let received = within("the hello", channel.recv(&mut buffer)).await;
        let message = HandshakeMessage::decode(&buffer[..received.expect("receives")]);
        let Ok(HandshakeMessage::Hello(peer)) = message else {
            panic!("{message:?}");
        };
        let accept = HandshakeMessage::Accept(own).encode();
        channel.send(&accept).await.expect("sends");
        (Self::on(channel, peer.window, Protection::checks()), peer)
    }

    /// Takes over a channel after the handshake, in which the listener announced `window`.
    pub fn on(channel: Arc<dyn Channel>, window: u16, protection: Protection) -> Self {
        Self {
            channel,
            window,
            protection,
            buffer: vec![0; 20_000],
        }
    }

    /// Seals any bytes as the next SDU, and does not send them.
    pub fn seal(&mut self, mut sdu: Vec<u8>) -> Vec<u8> {
        let Ok(_) = self
            .protection
            .out
            .seal(&mut sdu, |_| Ok::<_, Infallible>(true));
        sdu
    }

    /// Returns the credits for sending.
    pub fn credits(&self) -> Allowance {
        Allowance::new(self.window)
    }

    /// Sends the next SDU, correctly sealed.
    pub async fn send(&mut self, content: Content<'_>) {
        self.send_sdu(content.encode()).await;
    }

    /// Seals any bytes as the next SDU and sends them.
    pub async fn send_sdu(&mut self, sdu: Vec<u8>) {
        let sdu = self.seal(sdu);
        self.send_raw(&sdu).await;
    }

    /// Sends any bytes without a check. Ignores errors, because the channel may already be down.
    pub async fn send_raw(&self, sdu: &[u8]) {
        let _ = within("sending", self.channel.send(sdu)).await;
    }

    /// Receives the next message; `None` when the channel is down.
    pub async fn receive(&mut self) -> Option<Content<'_>> {
        let received = within("receiving", self.channel.recv(&mut self.buffer)).await;
        let size = received.ok()?;
        let content = self.protection.into.open(&mut self.buffer[..size]);
        Some(content.expect("follows the protocol"))
    }

    /// Returns the code of the goodbye, if one arrives before the channel is down.
    pub async fn receive_goodbye(&mut self) -> Option<u8> {
        loop {
            if let Content::Goodbye(code) = self.receive().await? {
                return Some(code);
            }
        }
    }

    /// Sends a batch on a lane as often as the credits allow, until the link stops the lane or ends.
    pub async fn flood(
        &mut self,
        credits: &mut Allowance,
        lane: Lane,
        batch: &[u8],
        obeys_stop: bool,
    ) -> FloodEnd {
        loop {
            while credits.can_spend(cost(batch.len()), 0) {
                self.send(Content::Batch(lane, batch)).await;
                credits.spend(cost(batch.len()));
            }
            match self
                .receive()
                .await
                .expect("a message before the channel closes")
            {
                Content::Ack(total) => {
                    let _ = credits.on_ack(total).expect("a valid acknowledgement");
                }
                Content::Stop(stopped) if obeys_stop => {
                    assert_eq!(stopped, lane);
                    return FloodEnd::Stop;
                }
                Content::Goodbye(code) => return FloodEnd::Goodbye(code),
                Content::Stop(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }
}
