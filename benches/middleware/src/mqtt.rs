//! Implements [`Peer`] with MQTT: rumqttc as a client of version 3.1.1, all messages at QoS 1, so that none is lost. MQTT
//! has no requests, so a request is a message and its answer, one at a time.
use std::{process, sync::Arc, time::Duration};

use bytes::Bytes;
use rumqttc::{AsyncClient, Event, EventLoop, MqttOptions, NetworkOptions, Packet, Publish, QoS};
use tokio::sync::mpsc;

use super::{
    arrivals::ArrivalCounter,
    peer::{About, Meeting, Outcome, Peer},
};

const ECHO: &str = "rect/client/echo";
const FLOOD: &str = "rect/client/flood";
const BACK: &str = "rect/server/back";
const SERVICE: &str = "rect/server/service";
const ANSWER: &str = "rect/client/answer";

/// The capacity of the queues, the same as that of a subscriber of RECT or Zenoh.
const WAITING: usize = 256;

pub struct Mqtt {
    client: AsyncClient,
    echoes: mpsc::UnboundedReceiver<Bytes>,
    answers: mpsc::UnboundedReceiver<Bytes>,
}

impl Peer for Mqtt {
    async fn serve(meeting: Meeting, arrivals: Arc<ArrivalCounter>) -> Outcome<()> {
        let (client, mut events) = client(meeting, "server");
        for topic in [ECHO, FLOOD, SERVICE] {
            client.subscribe(topic, QoS::AtLeastOnce).await?;
        }
        loop {
            let Publish { topic, payload, .. } = next(&mut events).await?;
            // `try_publish`, because this loop must not wait: only it empties the queue.
            match topic.as_str() {
                SERVICE => {
                    client.try_publish(ANSWER, QoS::AtLeastOnce, false, arrivals.answer(payload))?
                }
                FLOOD => arrivals.on_message(),
                _ => client.try_publish(BACK, QoS::AtLeastOnce, false, payload)?,
            }
        }
    }

    async fn join(meeting: Meeting) -> Outcome<Self> {
        let (client, mut events) = client(meeting, "client");
        for topic in [BACK, ANSWER] {
            client.subscribe(topic, QoS::AtLeastOnce).await?;
        }
        let (echo, echoes) = mpsc::unbounded_channel();
        let (answer, answers) = mpsc::unbounded_channel();
        tokio::spawn(async move {
            loop {
                match next(&mut events).await {
                    Ok(Publish { topic, payload, .. }) if topic == BACK => {
                        let _ = echo.send(payload);
                    }
                    Ok(Publish { payload, .. }) => {
                        let _ = answer.send(payload);
                    }
                    Err(error) => return eprintln!("lost the connection to the broker: {error}"),
                }
            }
        });
        Ok(Self {
            client,
            echoes,
            answers,
        })
    }

    async fn publish(&self, about: About, payload: Bytes) -> Outcome<()> {
        let topic = match about {
            About::Echo => ECHO,
            About::Flood => FLOOD,
        };
        let published = self
            .client
            .publish_bytes(topic, QoS::AtLeastOnce, false, payload);
        Ok(published.await?)
    }

    async fn next_echo(&mut self) -> Outcome<Bytes> {
        Ok(self.echoes.recv().await.ok_or("the connection ended")?)
    }

    async fn request(&mut self, payload: Bytes) -> Outcome<Bytes> {
        // Answers that arrived too late for their requests are discarded.
        while self.answers.try_recv().is_ok() {}
        let asked = self
            .client
            .publish_bytes(SERVICE, QoS::AtLeastOnce, false, payload);
        asked.await?;
        Ok(self.answers.recv().await.ok_or("the connection ended")?)
    }
}

fn client(meeting: Meeting, name: &str) -> (AsyncClient, EventLoop) {
    // The broker disconnects the older of two clients with the same name.
    let name = format!("{name}-{}", process::id());
    let host = meeting.address.ip().to_string();
    let mut options = MqttOptions::new(name, host, meeting.address.port());
    options.set_keep_alive(Duration::from_secs(60));
    let (client, mut events) = AsyncClient::new(options, WAITING);
    let mut network = NetworkOptions::new();
    network.set_tcp_nodelay(true);
    events.set_network_options(network);
    (client, events)
}

/// Returns the next message.
async fn next(events: &mut EventLoop) -> Outcome<Publish> {
    loop {
        if let Event::Incoming(Packet::Publish(publish)) = events.poll().await? {
            return Ok(publish);
        }
    }
}
