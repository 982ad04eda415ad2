//! Opens a link on a TCP connection, with a peer whose address is known. For the rules see section 6 of `PROTOCOL.md`.
//!
//! The messages are those of a Bluetooth channel's handshake. After them the connection proves that it belongs to the link, as
//! any further connection does.
use std::io;

use link_lanes::{
    first_message::{decide, decide_sealed, FirstMessage, Rejection},
    hello::{HandshakeMessage, Hello, Key, Refusal, MAX_SIZE, VERSION},
    key_agreement::{respond, Exporter, Initiator},
    seal::LinkKeys,
    sealed_message,
    secret::Secret,
};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt};

/// The first bytes of a connection that opens a link, with the version.
pub(crate) const MAGIC: [u8; 6] = *b"RECTM\x01";
/// Number of bytes by which a sealed message is longer, at most.
const SEAL_BYTES: usize = 16;

/// Two nodes have agreed on a link.
pub struct Met {
    /// The peer's properties.
    pub peer: Hello,
    /// Derives the keys of the link.
    pub exporter: Exporter,
}

/// Why the two do not open a link.
#[derive(Debug, thiserror::Error)]
pub enum MeetingError {
    /// The connection failed, with the system's error.
    #[error("{0}; is that its port=, and does it listen with any/ and secret=?")]
    Io(#[from] io::Error),
    /// The two have different secrets, or the peer has none.
    #[error("the two do not have the same secret: give both sides a secret= file with the same first line")]
    NoSharedSecret,
    /// The peer refuses the link.
    #[error("it refuses: {0}")]
    Refused(Refusal),
    /// This side refuses the link.
    #[error("{}", .0.own_reason())]
    Refuses(Refusal),
    /// Another robot answers.
    #[error("{found} answers there, and not {expected}")]
    OtherRobot {
        /// The robot that answers.
        found: String,
        /// The robot that was dialled.
        expected: String,
    },
    /// The peer violates the protocol.
    #[error("it does not follow the protocol: {0}")]
    Protocol(String),
}

/// Opens a link as the dialler of the connection.
///
/// # Errors
/// Fails if the connection ends, or if the peer refuses, violates the protocol or has another secret.
pub async fn dial(
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
    secret: &Secret,
    own: Hello,
) -> Result<Met, MeetingError> {
    let (initiator, message) = Initiator::start(secret, &header(VERSION)).map_err(protocol)?;
    let version = VERSION;
    let key = HandshakeMessage::Key(Key { version, message });
    stream.write_all(&MAGIC).await?;
    send(stream, &key.encode()).await?;
    let answer = match receive(stream).await.and_then(|bytes| decode(&bytes))? {
        HandshakeMessage::KeyAnswer(answer) if answer.version == VERSION => answer,
        other => return Err(unexpected(other)),
    };
    let agreed = initiator.finish(&answer.message);
    let agreed = agreed.map_err(|_| MeetingError::NoSharedSecret)?;
    let mut keys = agreed.keys;
    let hello = HandshakeMessage::Hello(own);
    send(stream, &sealed_message::seal(&mut keys, &hello)).await?;
    let mut sealed = receive(stream).await?;
    match sealed_message::open(&mut keys, &mut sealed).map_err(protocol)? {
        HandshakeMessage::Accept(peer) if peer.version == VERSION && peer.path.is_some() => {
            Ok(Met {
                peer,
                exporter: agreed.exporter,
            })
        }
        other => Err(unexpected(other)),
    }
}

/// Opens a link as the listener of the connection, which has begun with [`MAGIC`]. `accepts` returns this side's answer. A
/// listener without a secret refuses.
///
/// # Errors
/// Fails as [`dial`] does, or if this side refuses.
pub async fn accept(
    stream: &mut (impl AsyncRead + AsyncWrite + Unpin),
    secret: Option<&Secret>,
    accepts: impl FnOnce(&Hello) -> Result<Hello, Refusal>,
) -> Result<Met, MeetingError> {
    let bytes = receive(stream).await?;
    let (key, secret) = match decide(&bytes, secret) {
        Ok(FirstMessage::Key(key, secret)) => (key, secret),
        // A link without a secret begins only on Bluetooth.
        Ok(_) => return reject(stream, None, Rejection::NoSharedSecret).await,
        Err(rejection) => return reject(stream, None, rejection).await,
    };
    let (message, agreed) = match respond(secret, &header(key.version), &key.message) {
        Ok(answered) => answered,
        Err(error) => return reject(stream, None, error.into()).await,
    };
    let version = VERSION;
    let answer = HandshakeMessage::KeyAnswer(Key { version, message });
    send(stream, &answer.encode()).await?;
    let mut keys = agreed.keys;
    let mut sealed = receive(stream).await.map_err(|error| match error {
        // A dialler with another secret closes the connection.
        MeetingError::Io(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
            MeetingError::NoSharedSecret
        }
        other => other,
    })?;
    let peer = match decide_sealed(&mut keys, &mut sealed) {
        Ok(hello) => hello,
        Err(rejection) => {
            let keys = rejection.is_sealed().then_some(&mut keys);
            return reject(stream, keys, rejection).await;
        }
    };
    let decided = accepts(&peer);
    let answer = match &decided {
        Ok(own) => HandshakeMessage::Accept(own.clone()),
        Err(refusal) => HandshakeMessage::Refuse(*refusal),
    };
    send(stream, &sealed_message::seal(&mut keys, &answer)).await?;
    decided.map_err(MeetingError::Refuses)?;
    Ok(Met {
        peer,
        exporter: agreed.exporter,
    })
}

/// Refuses the dialler, unless its message is not answered, and returns the reason as an error.
async fn reject<T>(
    stream: &mut (impl AsyncWrite + Unpin),
    keys: Option<&mut LinkKeys>,
    rejection: Rejection,
) -> Result<T, MeetingError> {
    if let Some(refusal) = rejection.refusal() {
        let refuse = HandshakeMessage::Refuse(refusal);
        let message = match keys {
            Some(keys) => sealed_message::seal(keys, &refuse),
            None => refuse.encode(),
        };
        send(stream, &message).await?;
    }
    Err(match rejection {
        Rejection::NoSharedSecret | Rejection::RefusedByDialler => MeetingError::NoSharedSecret,
        other => protocol(other),
    })
}

/// Returns what the key agreement authenticates in addition to its messages, so that they fit only such a connection.
fn header(version: u8) -> Vec<u8> {
    [&MAGIC[..], &Key::header(version)].concat()
}

async fn send(stream: &mut (impl AsyncWrite + Unpin), message: &[u8]) -> Result<(), MeetingError> {
    let length = u16::try_from(message.len()).map_err(protocol)?;
    let with_length = [&length.to_le_bytes()[..], message].concat();
    Ok(stream.write_all(&with_length).await?)
}

async fn receive(stream: &mut (impl AsyncRead + Unpin)) -> Result<Vec<u8>, MeetingError> {
    let length = usize::from(stream.read_u16_le().await?);
    if length > MAX_SIZE + SEAL_BYTES {
        return Err(protocol(format!("a message of {length} bytes")));
    }
    let mut message = vec![0; length];
    stream.read_exact(&mut message).await?;
    Ok(message)
}

fn decode(bytes: &[u8]) -> Result<HandshakeMessage, MeetingError> {
    HandshakeMessage::decode(bytes).map_err(protocol)
}

fn unexpected(message: HandshakeMessage) -> MeetingError {
    match message {
        HandshakeMessage::Refuse(refusal) => MeetingError::Refused(refusal),
        _ => protocol("a message that was not expected"),
    }
}

fn protocol(what: impl ToString) -> MeetingError {
    MeetingError::Protocol(what.to_string())
}

#[cfg(test)]
mod tests {
    use link_lanes::hello::{NodeId, PathOf};
    use tokio::io::{duplex, DuplexStream};

    use super::*;

    fn hello(name: &str) -> Hello {
        Hello {
            version: VERSION,
            node: NodeId(1),
            mtu: 8192,
            window: u16::MAX,
            name: name.to_owned(),
            intervals: None,
            path: Some(PathOf {
                link: 7,
                joins: false,
            }),
            accepts_compressed: false,
        }
    }

    fn secret(word: &str) -> Secret {
        let text = format!("fleet:{word}, which is long enough");
        Secret::new(text.as_bytes()).expect("long enough")
    }

    /// The listener's side, with what a dialler has to do before.
    async fn accept_after_magic(
        mut stream: DuplexStream,
        word: &str,
        decision: Result<Hello, Refusal>,
    ) -> Result<Met, MeetingError> {
        let mut magic = [0; MAGIC.len()];
        stream.read_exact(&mut magic).await?;
        assert_eq!(magic, MAGIC);
        accept(&mut stream, Some(&secret(word)), |_| decision).await
    }

    async fn meeting(
        words: [&str; 2],
        decision: Result<Hello, Refusal>,
    ) -> [Result<Met, MeetingError>; 2] {
        let (mut near, far) = duplex(1000);
        let dialler = async move {
            let own = secret(words[0]);
            dial(&mut near, &own, hello("wombat-1")).await
        };
        let (one, two) = tokio::join!(dialler, accept_after_magic(far, words[1], decision));
        [one, two]
    }

    #[tokio::test]
    async fn both_sides_learn_the_peer_and_the_same_keys() {
        let [one, two] = meeting(["one", "one"], Ok(hello("wombat-2"))).await;
        let (one, two) = (one.expect("meets"), two.expect("meets"));
        assert_eq!(
            [one.peer.name.as_str(), two.peer.name.as_str()],
            ["wombat-2", "wombat-1"]
        );
        assert_eq!(one.exporter.key("any key"), two.exporter.key("any key"));
    }

    #[tokio::test]
    async fn rejected_peers_and_refusals_are_named_on_both_sides() {
        for met in meeting(["one", "two"], Ok(hello("wombat-2"))).await {
            assert!(matches!(met, Err(MeetingError::NoSharedSecret)));
        }
        let [one, two] = meeting(["one", "one"], Err(Refusal::NameTaken)).await;
        assert!(matches!(
            one,
            Err(MeetingError::Refused(Refusal::NameTaken))
        ));
        assert!(matches!(
            two,
            Err(MeetingError::Refuses(Refusal::NameTaken))
        ));
        let other_link = Hello {
            path: None,
            ..hello("wombat-2")
        };
        let [one, _] = meeting(["one", "one"], Ok(other_link)).await;
        assert!(matches!(one, Err(MeetingError::Protocol(_))));
    }

    #[tokio::test]
    async fn dialler_without_a_valid_key_is_refused_with_the_reason() {
        let own = secret("one");
        let (_, mut message) = Initiator::start(&own, &header(VERSION)).expect("starts");
        message[47] ^= 1;
        let key = |version| HandshakeMessage::Key(Key { version, message }).encode();
        let hello_without_key = HandshakeMessage::Hello(hello("wombat-1")).encode();
        for (secret, first, refusal) in [
            (Some(&own), key(VERSION), Refusal::Malformed),
            (Some(&own), key(VERSION - 1), Refusal::Version),
            (Some(&own), hello_without_key, Refusal::Secret),
            (None, key(VERSION), Refusal::Secret),
        ] {
            let (mut near, mut far) = duplex(1000);
            send(&mut near, &first).await.expect("sends");
            let met = accept(&mut far, secret, |_| Ok(hello("wombat-2"))).await;
            assert!(met.is_err(), "{refusal:?}");
            let answer = receive(&mut near).await.expect("an answer");
            let answer = decode(&answer).expect("a message of the handshake");
            assert_eq!(answer, HandshakeMessage::Refuse(refusal));
        }
    }

    #[tokio::test]
    async fn dialler_accepts_no_other_version_than_it_has_offered() {
        let own = &secret("one");
        let (mut near, mut far) = duplex(1000);
        let listening = async move {
            far.read_exact(&mut [0; MAGIC.len()]).await.expect("reads");
            let key = receive(&mut far).await.and_then(|bytes| decode(&bytes));
            let Ok(HandshakeMessage::Key(key)) = key else {
                panic!("{key:?}");
            };
            let answered = respond(own, &header(VERSION), &key.message);
            let (message, _) = answered.expect("answers");
            let version = VERSION + 1;
            let answer = HandshakeMessage::KeyAnswer(Key { version, message });
            send(&mut far, &answer.encode()).await.expect("sends");
        };
        let dialling = dial(&mut near, own, hello("wombat-1"));
        let (met, ()) = tokio::join!(dialling, listening);
        assert!(matches!(met, Err(MeetingError::Protocol(_))));
    }

    #[tokio::test]
    async fn other_bytes_end_the_connection() {
        for bytes in [
            &[0xff, 0xff][..],
            &[3, 0, 1, 2, 3],
            &[7, 0, b'R', b'E', b'C', b'T', 3, 2, 1],
            &[0, 0],
        ] {
            let (mut near, mut far) = duplex(1000);
            near.write_all(bytes).await.expect("writes");
            drop(near);
            let met = accept(&mut far, Some(&secret("one")), |_| Ok(hello("wombat-2"))).await;
            assert!(met.is_err(), "{bytes:?}");
        }
    }
}
