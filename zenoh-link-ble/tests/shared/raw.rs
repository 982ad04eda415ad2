//! A peer below the link, for tests: it keeps to the protocol only where it likes.
use std::sync::Arc;

use zenoh_link_ble::{
    hello::{Hello, NodeId, Opening},
    lanes::{
        credits::{cost, Allowance},
        sdu::{self, Content},
        Lane,
    },
    locator::DEFAULT_MTU,
    radio::{Channel, ChannelOptions, Radio},
};

use super::{
    listener::{psm_of, OPTIONS},
    peer::within,
};

/// What the raw peer takes unacknowledged, in bytes.
pub const WINDOW: u16 = 12_000;

/// Dials a listener by hand.
pub async fn raw_channel(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>) -> Arc<dyn Channel> {
    raw_channel_with(from, to, OPTIONS).await
}

/// Dials a listener by hand, with options.
pub async fn raw_channel_with(
    from: &Arc<dyn Radio>,
    to: &Arc<dyn Radio>,
    options: ChannelOptions,
) -> Arc<dyn Channel> {
    let psm = psm_of(from, to).await;
    let to = to.address().await.expect("has an address");
    within("connecting", from.connect(to, psm, options))
        .await
        .expect("connects")
}

/// What it says of itself.
pub fn hello(node: u64, name: &str) -> Hello {
    Hello {
        version: 1,
        node: NodeId(node),
        mtu: DEFAULT_MTU,
        window: WINDOW,
        name: name.to_owned(),
        nonce: None,
    }
}

/// Receives the answer to a first SDU; `None` if the channel is closed without one.
pub async fn answer_to(channel: &Arc<dyn Channel>, first: &[u8]) -> Option<Opening> {
    channel.send(first).await.expect("sends");
    let mut buffer = [0; 2000];
    let received = within("the answer", channel.recv(&mut buffer)).await;
    received
        .ok()
        .map(|size| Opening::decode(&buffer[..size]).expect("an opening message"))
}

/// What a peer that floods hears in the end.
#[derive(Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing more of that lane.
    Stop,
    /// The goodbye, with its code.
    Bye(u8),
}

/// One end of an open link, by hand.
pub struct RawPeer {
    channel: Arc<dyn Channel>,
    /// What the link takes unacknowledged, in bytes.
    window: u16,
    /// SDUs that it has sent, or should have.
    pub said: u32,
    heard: u32,
    buffer: Vec<u8>,
}

impl RawPeer {
    /// Dials a listener and is accepted.
    pub async fn dials(from: &Arc<dyn Radio>, to: &Arc<dyn Radio>, name: &str) -> Self {
        let channel = raw_channel(from, to).await;
        let hello = Opening::Hello(hello(5, name)).encode();
        let answer = answer_to(&channel, &hello).await;
        let Some(Opening::Accept(Hello { window, .. })) = answer else {
            panic!("{answer:?}");
        };
        Self {
            channel,
            window,
            said: 0,
            heard: 0,
            buffer: vec![0; 20_000],
        }
    }

    /// What it may send.
    pub fn credits(&self) -> Allowance {
        Allowance::new(self.window)
    }

    /// The next SDU as it should be.
    pub async fn says(&mut self, content: Content<'_>) {
        self.says_bytes(content.encode()).await;
    }

    /// An SDU with the check of the next one, whatever it says.
    pub async fn says_bytes(&mut self, mut sdu: Vec<u8>) {
        sdu::seal(self.said, &mut sdu);
        self.said += 1;
        self.sends(&sdu).await;
    }

    /// Any bytes. The channel may be down by then.
    pub async fn sends(&self, sdu: &[u8]) {
        let _ = within("sending", self.channel.send(sdu)).await;
    }

    /// What comes next; `None` when the channel is down.
    pub async fn hears(&mut self) -> Option<Content<'_>> {
        let received = within("hearing", self.channel.recv(&mut self.buffer)).await;
        let size = received.ok()?;
        let content = sdu::open(self.heard, &self.buffer[..size]).expect("follows the protocol");
        self.heard += 1;
        Some(content)
    }

    /// The code of the goodbye, if there is one before the channel is down.
    pub async fn hears_goodbye(&mut self) -> Option<u8> {
        loop {
            if let Content::Bye(code) = self.hears().await? {
                return Some(code);
            }
        }
    }

    /// Sends that batch on a lane as often as the credits allow, until it hears of it.
    pub async fn floods(
        &mut self,
        credits: &mut Allowance,
        lane: Lane,
        batch: &[u8],
        minds_stop: bool,
    ) -> Heard {
        loop {
            while credits.has(cost(batch.len()), 0) {
                self.says(Content::Batch(lane, batch)).await;
                credits.spend(cost(batch.len()));
            }
            match self.hears().await.expect("a goodbye before the end") {
                Content::Ack(total) => drop(credits.on_ack(total).expect("true")),
                Content::Stop(stopped) if minds_stop => {
                    assert_eq!(stopped, lane);
                    return Heard::Stop;
                }
                Content::Bye(code) => return Heard::Bye(code),
                Content::Stop(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }
}
