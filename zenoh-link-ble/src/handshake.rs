//! Performs the handshake on a new channel, for the dialler and the listener. Each step has a timeout.
//!
//! The messages are defined in [`hello`](link_lanes::hello), and the agreement on keys in
//! [`key_agreement`](link_lanes::key_agreement).
use link_lanes::{
    first_message::{decide, decide_sealed, FirstMessage, Rejection},
    hello::{HandshakeMessage, Hello, Key, Refusal, MIN_MTU, VERSION},
    key_agreement::{respond, Exporter, Initiator},
    lanes::{
        credits,
        sdu::{self, Protection},
    },
    seal::LinkKeys,
    sealed_message,
    secret::Secret,
};
use std::{sync::Arc, time::Duration};
use zenoh_link_ble_radio::{Channel, ChannelOptions, RadioError, Security};

use crate::error::BleError;

/// How long the peer may take for each message: 60 of the longest connection intervals (50 ms) that Linux requests by
/// default.
pub(crate) const MESSAGE_TIMEOUT: Duration = Duration::from_secs(3);

/// How long a refused peer may take to close the channel.
const REFUSAL_TIMEOUT: Duration = Duration::from_secs(1);

/// The largest accepted SDU, in bytes. Kernels before 6.10 grant the peer enough L2CAP credits for one SDU of this
/// size, so it is larger than any batch.
const RECV_MTU: u16 = 16_384;

/// Returns the options with which either side opens a channel.
///
/// # Errors
/// Fails if `security` is high and there is no secret.
pub(crate) fn channel_options(
    security: Security,
    secret: Option<&Secret>,
) -> Result<ChannelOptions, BleError> {
    if security == Security::High && secret.is_none() {
        return Err(BleError::HighWithoutSecret);
    }
    Ok(ChannelOptions {
        recv_mtu: RECV_MTU,
        security,
        passkey: secret.map(Secret::passkey),
    })
}

/// A channel during the handshake. After the two sides have agreed on keys, its messages are sealed.
pub(crate) struct HandshakeChannel {
    channel: Arc<dyn Channel>,
    keys: Option<LinkKeys>,
    exporter: Option<Exporter>,
}

/// The first SDU of a peer that dialled this node.
pub(crate) enum FirstSdu {
    Hello(Hello),
    /// A bare Zenoh batch.
    Plain(Vec<u8>),
}

impl HandshakeChannel {
    pub(crate) fn new(channel: &Arc<dyn Channel>) -> Self {
        Self {
            channel: Arc::clone(channel),
            keys: None,
            exporter: None,
        }
    }

    /// Returns the protection of the SDUs that follow the handshake, and what derives keys for other uses.
    pub(crate) fn finish(self) -> (Protection, Option<Exporter>) {
        let protection = self.keys.map_or_else(Protection::checks, Protection::keys);
        (protection, self.exporter)
    }

    /// Returns the number of bytes that an SDU of the open link has in addition to its batch.
    pub(crate) fn overhead(&self) -> usize {
        sdu::overhead(self.keys.is_some())
    }

    /// Agrees on keys if there is a secret, sends a hello, waits for the peer's acceptance and returns it.
    ///
    /// # Errors
    /// Fails if the peer refuses, does not have the secret, violates the protocol or does not answer in time.
    pub(crate) async fn dial(
        &mut self,
        own: Hello,
        secret: Option<&Secret>,
    ) -> Result<Hello, BleError> {
        if let Some(secret) = secret {
            self.agree_as_dialler(secret).await?;
        }
        self.send(&HandshakeMessage::Hello(own)).await?;
        match self.receive_message().await? {
            HandshakeMessage::Accept(hello) if hello.version == VERSION => Ok(hello),
            HandshakeMessage::Accept(hello) => Err(self.other_version(hello.version)),
            other => Err(self.unexpected(&other)),
        }
    }

    /// Sends the first message of the key agreement and handles the answer.
    async fn agree_as_dialler(&mut self, secret: &Secret) -> Result<(), BleError> {
        let header = Key::header(VERSION);
        let started = Initiator::start(secret, &header);
        let (initiator, message) = started.map_err(|error| self.protocol(&error.to_string()))?;
        let version = VERSION;
        self.send(&HandshakeMessage::Key(Key { version, message }))
            .await?;
        let answer = match self.receive_message().await? {
            HandshakeMessage::KeyAnswer(answer) if answer.version == VERSION => answer,
            HandshakeMessage::KeyAnswer(answer) => return Err(self.other_version(answer.version)),
            // The peer accepts every dialler, and therefore has no secret.
            HandshakeMessage::Accept(_) => return Err(self.no_shared_secret()),
            other => return Err(self.unexpected(&other)),
        };
        match initiator.finish(&answer.message) {
            Ok(agreed) => {
                self.keys = Some(agreed.keys);
                self.exporter = Some(agreed.exporter);
                Ok(())
            }
            Err(_) => {
                // The refusal lets the peer log the reason as well.
                self.refuse(Refusal::Secret).await?;
                Err(self.no_shared_secret())
            }
        }
    }

    /// Waits for the hello of a peer that has dialled this node, and agrees on keys first if there is a secret. The hello is
    /// then returned only if it was sealed with these keys.
    ///
    /// # Errors
    /// Fails if the peer does not have the secret, violates the protocol or sends nothing in time.
    pub(crate) async fn receive_hello(
        &mut self,
        secret: Option<&Secret>,
    ) -> Result<FirstSdu, BleError> {
        let sdu = self.receive().await?;
        match decide(&sdu, secret) {
            Ok(FirstMessage::Hello(hello)) => Ok(FirstSdu::Hello(hello)),
            Ok(FirstMessage::Key(key, secret)) => {
                let hello = self.agree_as_listener(&key, secret).await?;
                Ok(FirstSdu::Hello(hello))
            }
            Ok(FirstMessage::Plain) => Ok(FirstSdu::Plain(sdu)),
            Err(rejection) => self.reject(rejection).await,
        }
    }

    /// Answers the dialler's message of the key agreement, and receives its sealed hello.
    async fn agree_as_listener(&mut self, key: &Key, secret: &Secret) -> Result<Hello, BleError> {
        let answered = respond(secret, &Key::header(key.version), &key.message);
        let (message, agreed) = match answered {
            Ok(answered) => answered,
            Err(error) => return self.reject(error.into()).await,
        };
        let answer = Key {
            version: VERSION,
            message,
        };
        self.answer(&HandshakeMessage::KeyAnswer(answer)).await?;
        let (mut sdu, mut keys) = (self.receive().await?, agreed.keys);
        let decided = decide_sealed(&mut keys, &mut sdu);
        if decided.as_ref().err().is_none_or(Rejection::is_sealed) {
            self.keys = Some(keys);
            self.exporter = Some(agreed.exporter);
        }
        match decided {
            Ok(hello) => Ok(hello),
            Err(rejection) => self.reject(rejection).await,
        }
    }

    /// Refuses the dialler, unless its message is not answered, and returns the reason as an error.
    async fn reject<T>(&mut self, rejection: Rejection) -> Result<T, BleError> {
        if let Some(refusal) = rejection.refusal() {
            self.refuse(refusal).await?;
        }
        Err(match rejection {
            Rejection::NoSharedSecret
            | Rejection::RefusedByDialler
            | Rejection::PlainWithSecret => self.no_shared_secret(),
            Rejection::Misdirected => BleError::Misdirected {
                peer: self.channel.peer(),
            },
            other => self.protocol(&other.to_string()),
        })
    }

    /// Sends a refusal and waits until the peer closes the channel, which it does when it has read the refusal.
    pub(crate) async fn refuse(&mut self, refusal: Refusal) -> Result<(), BleError> {
        self.answer(&HandshakeMessage::Refuse(refusal)).await?;
        let _ = tokio::time::timeout(REFUSAL_TIMEOUT, drain_until_closed(&self.channel)).await;
        Ok(())
    }

    /// Sends a message of the handshake in answer to the peer.
    pub(crate) async fn answer(&mut self, message: &HandshakeMessage) -> Result<(), BleError> {
        tokio::time::timeout(MESSAGE_TIMEOUT, self.send(message))
            .await
            .map_err(|_| timed_out())?
    }

    /// Sends a message, sealed if there are keys.
    async fn send(&mut self, message: &HandshakeMessage) -> Result<(), BleError> {
        let sdu = match &mut self.keys {
            Some(keys) => sealed_message::seal(keys, message),
            None => message.encode(),
        };
        Ok(self.channel.send(&sdu).await?)
    }

    /// Receives the next message of the handshake, sealed if there are keys.
    async fn receive_message(&mut self) -> Result<HandshakeMessage, BleError> {
        let mut sdu = self.receive().await?;
        let message = match &mut self.keys {
            Some(keys) => sealed_message::open(keys, &mut sdu).map_err(|error| error.to_string()),
            None => HandshakeMessage::decode(&sdu).map_err(|error| error.to_string()),
        };
        message.map_err(|error| self.protocol(&error))
    }

    async fn receive(&self) -> Result<Vec<u8>, BleError> {
        // The first batch of a plain peer may be longer than any hello, and the kernel truncates an SDU to the buffer.
        let mut sdu = vec![0; usize::from(RECV_MTU)];
        let size = tokio::time::timeout(MESSAGE_TIMEOUT, self.channel.recv(&mut sdu))
            .await
            .map_err(|_| timed_out())??;
        sdu.truncate(size);
        Ok(sdu)
    }

    /// Returns the error for a message that is not the expected answer.
    fn unexpected(&self, message: &HandshakeMessage) -> BleError {
        let what = match message {
            HandshakeMessage::Refuse(refusal) => {
                return BleError::Refused {
                    peer: self.channel.peer(),
                    refusal: *refusal,
                }
            }
            HandshakeMessage::Hello(_) | HandshakeMessage::Key(_) => {
                "it answered a hello with a hello"
            }
            HandshakeMessage::Accept(_) => "it accepted a link that was not requested yet",
            HandshakeMessage::KeyAnswer(_) => "it sent a key that was not requested",
        };
        self.protocol(what)
    }

    fn other_version(&self, version: u8) -> BleError {
        self.protocol(&format!(
            "it chose version {version}, and this side offered version {VERSION}"
        ))
    }

    fn no_shared_secret(&self) -> BleError {
        BleError::NoSharedSecret {
            peer: self.channel.peer(),
        }
    }

    fn protocol(&self, what: &str) -> BleError {
        protocol(&self.channel, what)
    }
}

/// Discards received SDUs of any size until the peer has closed the channel. If this side closed first, the end of the
/// channel could overtake its last message.
pub(crate) async fn drain_until_closed(channel: &Arc<dyn Channel>) {
    let mut sdu = vec![0; usize::from(RECV_MTU)];
    while channel.recv(&mut sdu).await.is_ok() {}
}

/// Returns the number of bytes that this side accepts unacknowledged: what its socket holds without a reader.
pub(crate) fn own_window(channel: &Arc<dyn Channel>) -> u16 {
    credits::window_of(channel.receive_capacity_bytes())
}

/// Returns the MTU of the link: the smallest of what both sides accept, what the channel carries, and what both windows
/// allow. `peer` is `None` for a plain peer; for others, `overhead` is what an SDU has in addition to its batch.
///
/// # Errors
/// Fails if the MTU would be under [`MIN_MTU`].
pub(crate) fn agreed_mtu(
    channel: &Arc<dyn Channel>,
    own: u16,
    peer: Option<&Hello>,
    overhead: usize,
) -> Result<u16, BleError> {
    let overhead = peer.map_or(0, |_| overhead);
    let carried = channel.send_mtu().saturating_sub(overhead);
    let carried = u16::try_from(carried).unwrap_or(u16::MAX);
    let accepted = peer.map_or(own, |peer| {
        let window = peer.window.min(own_window(channel));
        own.min(peer.mtu).min(credits::largest_batch(window))
    });
    let mtu = accepted.min(carried);
    if mtu < MIN_MTU {
        return Err(protocol(
            channel,
            &format!("its channel carries {carried} bytes, and Zenoh's handshake needs {MIN_MTU}"),
        ));
    }
    Ok(mtu)
}

fn timed_out() -> BleError {
    BleError::Radio(RadioError::TimedOut {
        action: "waiting for the peer in the handshake",
        limit: MESSAGE_TIMEOUT,
    })
}

fn protocol(channel: &Arc<dyn Channel>, what: &str) -> BleError {
    BleError::Protocol {
        peer: channel.peer(),
        what: what.to_owned(),
    }
}
