//! The program of one robot, which performs the calls of a scenario.
use std::{
    collections::HashMap,
    future::{Future, IntoFuture},
    sync::Arc,
    time::Duration,
};

use rect::{
    Connection, Error, Json, Payload, Publisher, ReceiveOptions, Request, Robot, Service,
    StreamOptions, Subscriber, ToPayload, Transfers,
};
use rect_core::{codec::dictionary::Dictionary, storage::Content};
use serde_json::{json, Value};

use super::outcome::value;
use crate::support::DEADLINE;

/// The reply of a service, or the error with which it refuses the request.
type Answer = Result<Payload, Payload>;

/// The program of one robot. It keeps the objects that calls create, under their topics, patterns or names.
pub struct Program {
    robot: Robot,
    dictionaries: HashMap<String, Vec<u8>>,
    with_dictionary: HashMap<String, Robot>,
    subscribers: HashMap<String, Subscriber>,
    publishers: HashMap<String, Publisher>,
    services: Vec<Service>,
    transfers: HashMap<String, Transfers>,
}

impl Program {
    /// Creates the program of `robot`; `dictionaries` are those of the scenarios, in hexadecimal digits.
    pub fn new(robot: Robot, dictionaries: &Value) -> Self {
        let all = dictionaries.as_object().expect("dictionaries").iter();
        let dictionaries = all.map(|(name, hex)| (name.clone(), bytes(text(hex))));
        Self {
            robot,
            dictionaries: dictionaries.collect(),
            with_dictionary: HashMap::new(),
            subscribers: HashMap::new(),
            publishers: HashMap::new(),
            services: Vec::new(),
            transfers: HashMap::new(),
        }
    }

    /// Closes the robot.
    pub async fn close(&self) {
        self.robot.close().await.expect("closed");
    }

    /// Performs a call, and returns its result as the scenarios describe it.
    pub async fn call(&mut self, name: &str, arguments: &[Value]) -> Result<Value, Error> {
        let robot = &self.robot;
        match (name, arguments) {
            ("wait_for_peer", [peer, timeout @ ..]) => {
                let waited = robot.wait_for_peer(text(peer), duration(timeout));
                waited.await.map(|()| Value::Null)
            }
            ("wait_until_established", []) => {
                let waited = robot.wait_until_established(DEADLINE).await;
                waited.map(|()| Value::Null)
            }
            ("peers", []) => {
                let peers = robot.peers().await?;
                Ok(peers.iter().map(|peer| peer.as_str()).collect())
            }
            ("publish", [topic, value]) => {
                let published = robot.publish(text(topic), payload(value)).await;
                published.map(|()| Value::Null)
            }
            ("publish", [topic, value, dictionary]) => {
                let robot = &self.with_dictionary[text(dictionary)];
                let published = robot.publish(text(topic), payload(value)).await;
                published.map(|()| Value::Null)
            }
            ("send", [peer, topic, value]) => {
                let sent = robot.send(text(peer), text(topic), payload(value)).await;
                sent.map(|()| Value::Null)
            }
            ("subscribe", [pattern]) => {
                let subscriber = robot.subscribe(text(pattern)).await?;
                self.subscribers
                    .insert(text(pattern).to_owned(), subscriber);
                Ok(Value::Null)
            }
            ("next", [pattern, timeout @ ..]) => {
                let next = self.subscribers[text(pattern)].next();
                let message = within(duration(timeout), next)
                    .await?
                    .ok_or(Error::Closed)?;
                Ok(json!([
                    message.sender.as_str(),
                    message.topic.as_str(),
                    value(&message.payload)?
                ]))
            }
            ("publisher", [topic]) => {
                let publisher = robot.publisher(text(topic)).await?;
                self.publishers.insert(text(topic).to_owned(), publisher);
                Ok(Value::Null)
            }
            ("wait_for_subscriber", [topic, timeout @ ..]) => {
                let publisher = &self.publishers[text(topic)];
                let waited = publisher.wait_for_subscriber(duration(timeout)).await;
                waited.map(|()| Value::Null)
            }
            ("serve", [topic, kind]) => {
                let answer = answer_of(text(kind));
                let answer = move |request: Arc<Request>| async move { answer(&request.payload) };
                let service = robot.serve(text(topic), answer).await?;
                self.services.push(service);
                Ok(Value::Null)
            }
            ("request", [peer, topic, asked]) => {
                let reply = robot
                    .request::<Payload>(text(peer), text(topic), payload(asked))
                    .await?;
                Ok(json!([reply.sender.as_str(), value(&reply.payload)?]))
            }
            ("query_registry", [question, filter]) => {
                let me = robot.name().clone();
                robot.query_registry(me, text(question), text(filter)).await
            }
            ("connections", [filter]) => {
                let me = robot.name().clone();
                let connections = robot.connections_of(me, text(filter)).await?;
                let methods = |connection: Connection| Value::from(connection.method);
                Ok(connections.into_iter().map(methods).collect())
            }
            ("share_dictionary", [name]) => {
                let bytes = self.dictionaries[text(name)].clone();
                let robot = robot.with_dictionary(Dictionary::new(bytes)?.into())?;
                self.with_dictionary.insert(text(name).to_owned(), robot);
                Ok(Value::Null)
            }
            ("stream", [topic, options]) => {
                let stream = robot.stream(text(topic), stream_options(options)).await;
                stream.map(|_| Value::Null)
            }
            ("receive_transfers", [pattern, max_bytes]) => {
                let options = ReceiveOptions::in_memory(max_bytes.as_u64().expect("bytes"));
                let transfers = robot.receive_transfers(text(pattern), options).await?;
                self.transfers.insert(text(pattern).to_owned(), transfers);
                Ok(Value::Null)
            }
            ("next_transfer", [pattern]) => {
                let next = self.transfers[text(pattern)].next();
                let received = within(DEADLINE, next).await?.ok_or(Error::Closed)??;
                let Content::Bytes(bytes) = &received.content else {
                    panic!("{received:?} is not in memory");
                };
                let content = Payload::new(bytes.clone(), received.encoding.clone());
                Ok(json!([
                    received.sender.as_str(),
                    received.topic.as_str(),
                    value(&content)?
                ]))
            }
            ("transfer", [peer, topic, content]) => {
                let transfer = robot.transfer(text(peer), text(topic), payload(content))?;
                let sent = transfer.timeout(DEADLINE).into_future().await;
                sent.map(|()| Value::Null)
            }
            ("close", []) => robot.close().await.map(|()| Value::Null),
            _ => panic!("there is no call {name} with the arguments {arguments:?}"),
        }
    }
}

async fn within<T>(timeout: Duration, value: impl Future<Output = T>) -> Result<T, Error> {
    let expected = "item".to_owned();
    let timed_out = |_| Error::TimedOut { expected, timeout };
    tokio::time::timeout(timeout, value)
        .await
        .map_err(timed_out)
}

/// Returns what a service of this kind does.
fn answer_of(kind: &str) -> fn(&Payload) -> Answer {
    match kind {
        "echo" => |asked| Ok(asked.clone()),
        "double" => |asked| {
            let number: i64 = asked.value().expect("a number");
            Ok(payload(&(2 * number).into()))
        },
        "refuse" => |_| Err(payload(&"there are the cells 1 and 2".into())),
        _ => panic!("there is no kind of service {kind}"),
    }
}

fn stream_options(options: &Value) -> StreamOptions {
    let mut all = StreamOptions::default();
    for (name, value) in options.as_object().expect("options") {
        let value = value.as_f64().expect("a number");
        match name.as_str() {
            "max_frames_per_s" => all.max_frames_per_s = value,
            "min_frames_per_s" => all.min_frames_per_s = value,
            "max_bytes_per_s" => all.rates.max_bytes_per_s = value,
            "feedback_interval" => all.feedback_interval = Duration::from_secs_f64(value),
            _ => panic!("there is no option {name}"),
        }
    }
    all
}

/// Returns the payload of a value of a scenario: text, or JSON.
fn payload(value: &Value) -> Payload {
    let payload = match value.as_str() {
        Some(text) => text.to_payload(),
        None => Json(value).to_payload(),
    };
    payload.expect("a payload")
}

/// Returns the timeout of a call that may have one as its last argument, in milliseconds.
fn duration(timeout: &[Value]) -> Duration {
    let ms = timeout.first().map(|ms| ms.as_u64().expect("milliseconds"));
    ms.map_or(DEADLINE, Duration::from_millis)
}

fn text(value: &Value) -> &str {
    value.as_str().expect("text")
}

fn bytes(hex: &str) -> Vec<u8> {
    let byte = |n| u8::from_str_radix(&hex[n..n + 2], 16).expect("hexadecimal digits");
    (0..hex.len()).step_by(2).map(byte).collect()
}
