//! Implements [`Peer`] with plain zenoh: with RECT's keys, priority and congestion control, and nothing else of RECT.
use std::sync::Arc;

use bytes::Bytes;
use zenoh::{
    bytes::ZBytes,
    handlers::FifoChannelHandler,
    pubsub::{Publisher, Subscriber},
    qos::CongestionControl,
    sample::Sample,
    Config, Session,
};

use super::{
    arrivals::ArrivalCounter,
    peer::{About, Meeting, Outcome, Peer},
};

/// As many bytes as RECT attaches to a message that is not the first of its publisher.
const ATTACHMENT: [u8; 10] = [0; 10];
const ECHO: &str = "rect/client/echo";
const FLOOD: &str = "rect/client/flood";
const BACK: &str = "rect/server/back";
const SERVICE: &str = "rect/server/service";

/// A program that uses plain zenoh. `ATTACHES`: each published message has an attachment, as one of RECT has.
pub struct Zenoh<const ATTACHES: bool> {
    session: Session,
    echo: Publisher<'static>,
    flood: Publisher<'static>,
    echoes: Subscriber<FifoChannelHandler<Sample>>,
}

impl<const ATTACHES: bool> Peer for Zenoh<ATTACHES> {
    async fn serve(meeting: Meeting, arrivals: Arc<ArrivalCounter>) -> Outcome<()> {
        let session = session(meeting, "listen").await?;
        let back = publisher(&session, BACK).await?;
        let service = session.declare_queryable(SERVICE).complete(true).await?;
        let answering = arrivals.clone();
        tokio::spawn(async move {
            while let Ok(query) = service.recv_async().await {
                let asked = query.payload().map(bytes).unwrap_or_default();
                let answered = query.reply(SERVICE, answering.answer(asked)).await;
                if let Err(error) = answered {
                    eprintln!("cannot send a reply: {error}");
                }
            }
        });
        let flood = session.declare_subscriber(FLOOD).await?;
        tokio::spawn(async move {
            while flood.recv_async().await.is_ok() {
                arrivals.on_message();
            }
        });
        let echo = session.declare_subscriber(ECHO).await?;
        while let Ok(sample) = echo.recv_async().await {
            put::<ATTACHES>(&back, sample.payload().clone()).await?;
        }
        Ok(())
    }

    async fn join(meeting: Meeting) -> Outcome<Self> {
        let session = session(meeting, "connect").await?;
        Ok(Self {
            echo: publisher(&session, ECHO).await?,
            flood: publisher(&session, FLOOD).await?,
            echoes: session.declare_subscriber(BACK).await?,
            session,
        })
    }

    async fn publish(&self, about: About, payload: Bytes) -> Outcome<()> {
        let publisher = match about {
            About::Echo => &self.echo,
            About::Flood => &self.flood,
        };
        put::<ATTACHES>(publisher, payload).await
    }

    async fn next_echo(&mut self) -> Outcome<Bytes> {
        Ok(bytes(self.echoes.recv_async().await?.payload()))
    }

    async fn request(&mut self, payload: Bytes) -> Outcome<Bytes> {
        let replies = self.session.get(SERVICE).payload(payload).await?;
        match replies.recv_async().await?.into_result() {
            Ok(sample) => Ok(bytes(sample.payload())),
            Err(error) => Err(format!("{error:?}").into()),
        }
    }
}

async fn session(meeting: Meeting, end: &str) -> Outcome<Session> {
    let mut config = Config::default();
    let (mode, end) = match meeting.router {
        true => ("client", "connect"),
        false => ("peer", end),
    };
    let endpoints = format!("[\"tcp/{}\"]", meeting.address);
    config.insert_json5("mode", &format!("\"{mode}\""))?;
    // The programs must not find another path than the measured one.
    config.insert_json5("scouting/multicast/enabled", "false")?;
    config.insert_json5("scouting/gossip/enabled", "false")?;
    config.insert_json5("listen/endpoints", "[]")?;
    config.insert_json5(&format!("{end}/endpoints"), &endpoints)?;
    zenoh::open(config).await
}

async fn publisher(session: &Session, key: &'static str) -> Outcome<Publisher<'static>> {
    let publisher = session.declare_publisher(key);
    publisher.congestion_control(CongestionControl::Block).await
}

async fn put<const ATTACHES: bool>(
    publisher: &Publisher<'_>,
    payload: impl Into<ZBytes>,
) -> Outcome<()> {
    let put = publisher.put(payload);
    match ATTACHES {
        true => put.attachment(ATTACHMENT).await,
        false => put.await,
    }
}

fn bytes(payload: &ZBytes) -> Bytes {
    Bytes::copy_from_slice(&payload.to_bytes())
}
