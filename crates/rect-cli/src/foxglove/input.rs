//! Publishes what viewers send.

use foxglove::websocket::{Client, ClientChannel, Status};
use rect::{Name, Payload, Robot, Topic};
use rect_core::text::display::line;
use rect_recording::view;
use tokio::sync::mpsc::{self, Receiver, Sender};

/// Number of messages of viewers that wait at most.
const WAITING: usize = 64;
/// The largest message of a viewer, in bytes.
const MAX_BYTES: usize = 65_536;
/// The first part of the topics on which viewers send messages to one robot.
const TO: &str = "to/";

/// The messages of viewers, on the way to the network.
pub struct Input {
    queue: Sender<InputMessage>,
}

struct InputMessage {
    client: Client,
    topic: String,
    payload: Payload,
}

impl Input {
    /// Starts to publish as a robot, until the returned value is dropped.
    pub fn start(robot: &Robot) -> Self {
        let (queue, waiting) = mpsc::channel(WAITING);
        tokio::spawn(publish(robot.clone(), waiting));
        Self { queue }
    }

    /// Takes a message of a viewer, and tells the viewer if that is not possible.
    pub fn on_message(&self, client: Client, channel: &ClientChannel, payload: &[u8]) {
        if let Err(problem) = self.take(&client, &channel.topic, payload) {
            warn(&client, &channel.topic, &problem);
        }
    }

    fn take(&self, client: &Client, topic: &str, payload: &[u8]) -> Result<(), String> {
        let size = payload.len();
        if size > MAX_BYTES {
            return Err(format!(
                "{size} bytes are too many; at most {MAX_BYTES} are published"
            ));
        }
        let payload =
            view::payload(payload).map_err(|error| format!("the message is not JSON: {error}"))?;
        let message = InputMessage {
            client: client.clone(),
            topic: topic.to_owned(),
            payload,
        };
        (self.queue.try_send(message))
            .map_err(|_| "too many messages at once: this one is dropped".to_owned())
    }
}

async fn publish(robot: Robot, mut waiting: Receiver<InputMessage>) {
    while let Some(incoming) = waiting.recv().await {
        let InputMessage {
            client,
            topic,
            payload,
        } = incoming;
        if let Err(error) = send(&robot, &topic, payload).await {
            warn(&client, &topic, &error.to_string());
        }
    }
}

fn warn(client: &Client, topic: &str, problem: &str) {
    let text = format!("{}: {problem}", line(topic));
    client.send_status(Status::warning(text));
}

/// Publishes a message as the robot, or sends it to the one robot that the topic names.
async fn send(robot: &Robot, topic: &str, payload: Payload) -> Result<(), rect::Error> {
    let topic = topic.trim_start_matches('/');
    if let Some((recipient, topic)) = topic.strip_prefix(TO).and_then(|to| to.split_once('/')) {
        return robot
            .send(Name::new(recipient)?, Topic::new(topic)?, payload)
            .await;
    }
    // The viewer shows this robot's topics with its name.
    let own = topic.strip_prefix(robot.name().as_str());
    let topic = own.and_then(|rest| rest.strip_prefix('/')).unwrap_or(topic);
    robot.publish(Topic::new(topic)?, payload).await
}
