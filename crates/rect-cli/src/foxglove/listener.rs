//! Passes what viewers do on to the program.
use foxglove::{
    websocket::{ChannelView, Client, ClientChannel, ServerListener},
    ChannelId, SinkId,
};
use tokio::sync::mpsc::Sender;

use super::input::Input;

/// A change of what viewers show.
pub enum Event {
    /// A viewer shows a channel.
    Shown {
        /// The channel.
        channel: ChannelId,
        /// The viewer.
        viewer: SinkId,
    },
    /// A viewer has connected, has left or shows less.
    Changed,
}

/// The functions that the server calls.
pub struct Listener {
    events: Sender<Event>,
    /// Takes the messages of viewers; `None` if they may not publish.
    input: Option<Input>,
}

impl Listener {
    pub fn new(events: Sender<Event>, input: Option<Input>) -> Self {
        Self { events, input }
    }

    /// Reports an event. If too many wait, the next one has the same effect, except that a viewer lacks the last message.
    fn report(&self, event: Event) {
        if self.events.try_send(event).is_err() {
            tracing::debug!("foxglove: too many changes of viewers at once");
        }
    }
}

impl ServerListener for Listener {
    fn on_subscribe(&self, client: Client, channel: ChannelView) {
        if let Some(viewer) = client.sink_id() {
            let channel = channel.id();
            self.report(Event::Shown { channel, viewer });
        }
    }

    fn on_unsubscribe(&self, _client: Client, _channel: ChannelView) {
        self.report(Event::Changed);
    }

    fn on_client_connect(&self) {
        self.report(Event::Changed);
    }

    fn on_client_disconnect(&self) {
        self.report(Event::Changed);
    }

    fn on_message_data(&self, client: Client, channel: &ClientChannel, payload: &[u8]) {
        if let Some(input) = &self.input {
            input.on_message(client, channel, payload);
        }
    }
}
