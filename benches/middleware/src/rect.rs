//! Implements [`Peer`] with RECT's library in its default configuration.
use std::sync::Arc;

use bytes::Bytes;
use rect::{Payload, Publisher, QueueOptions, Robot, Subscriber, WhenFull};

use super::{
    arrivals::ArrivalCounter,
    peer::{About, Meeting, Outcome, Peer},
};

const SERVER: &str = "server";

pub struct Rect {
    robot: Robot,
    echo: Publisher,
    flood: Publisher,
    echoes: Subscriber,
}

impl Peer for Rect {
    async fn serve(meeting: Meeting, arrivals: Arc<ArrivalCounter>) -> Outcome<()> {
        let options = rect::Options::new(SERVER)?;
        let at = format!("tcp/{}", meeting.address);
        let robot = match meeting.router {
            true => options.router(at).connect().await?,
            false => options.listen(at).connect().await?,
        };
        let answering = arrivals.clone();
        let _service = robot
            .serve("service", move |request| {
                let answer = answering.answer(request.payload.bytes.clone());
                async move { Ok::<_, String>(answer) }
            })
            .await?;
        // By default the oldest message is dropped, but in the flood each message counts.
        let each = QueueOptions {
            when_full: WhenFull::Block,
            ..QueueOptions::default()
        };
        let flood = robot
            .subscribe_with::<Payload>("client/flood", each)
            .await?;
        tokio::spawn(async move {
            while flood.next().await.is_some() {
                arrivals.on_message();
            }
        });
        let back = robot.publisher("back").await?;
        let echo = robot.subscribe::<Payload>("client/echo").await?;
        while let Some(message) = echo.next().await {
            back.publish(message.payload).await?;
        }
        Ok(())
    }

    async fn join(meeting: Meeting) -> Outcome<Self> {
        let options = rect::Options::new("client")?;
        let at = format!("tcp/{}", meeting.address);
        let robot = match meeting.router {
            true => options.router(at).connect().await?,
            false => options.endpoint(at).connect().await?,
        };
        let echoes = robot.subscribe("server/back").await?;
        Ok(Self {
            echo: robot.publisher("echo").await?,
            flood: robot.publisher("flood").await?,
            robot,
            echoes,
        })
    }

    async fn publish(&self, about: About, payload: Bytes) -> Outcome<()> {
        let publisher = match about {
            About::Echo => &self.echo,
            About::Flood => &self.flood,
        };
        Ok(publisher.publish(payload).await?)
    }

    async fn next_echo(&mut self) -> Outcome<Bytes> {
        let message = self.echoes.next().await.ok_or("the session ended")?;
        Ok(message.payload.bytes)
    }

    async fn request(&mut self, payload: Bytes) -> Outcome<Bytes> {
        let asked = self.robot.request::<Payload>(SERVER, "service", payload);
        Ok(asked.await?.payload.bytes)
    }
}
