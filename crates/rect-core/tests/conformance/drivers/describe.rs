//! Describes steps, items and outputs of drivers as JSON, in the form in which Python gets them.
use std::{convert::Infallible, time::Instant};

use rect_core::{
    driver::{Action, Answer, Declaration, Reaction, Step, Target},
    message::{payload::Payload, retained, urgency::Qos, Message},
    name::Name,
    registry::{
        connection::{Connection, Event, Link},
        RegistryError,
    },
    session::{decoder::Fetched, peers::Waited},
    state::{
        keeper,
        retain::{Outcome, NO_KEEPER},
    },
    stream::frame::ReceivedFrame,
    transfer::{push::SendError, reception::Arrival, Fault, Progress},
};
use serde_json::{json, Value};

use super::content::{self, of_bytes};

/// A value that a driver delivers, or with which it finishes.
pub trait Describe {
    fn describe(self) -> Value;
}

pub fn reaction<I: Describe>(reaction: Reaction<I>) -> Value {
    let items: Vec<Value> = reaction.items.into_iter().map(I::describe).collect();
    json!([items, reaction.polls])
}

pub fn step<I: Describe, O: Describe>(step: Step<I, O>, now: Instant) -> Value {
    match step {
        Step::Act(action) => act(action),
        Step::Deliver(item) => json!(["deliver", item.describe()]),
        Step::Wait(until) => {
            let seconds = until.map(|until| until.saturating_duration_since(now).as_secs_f64());
            json!(["wait", seconds])
        }
        Step::Finished(output) => json!(["finished", output.describe()]),
    }
}

pub fn act(action: Action) -> Value {
    match action {
        Action::Declare { id, declaration } => declare(id.0, declaration),
        Action::Undeclare { id } => json!(["undeclare", id.0]),
        Action::Put {
            publisher,
            payload,
            attachment,
        } => {
            let attachment = attachment.map(|attachment| of_bytes(&attachment));
            json!([
                "put",
                publisher.0,
                content::of(&payload),
                encoding(&payload),
                attachment
            ])
        }
        Action::PutOnce { key, payload, qos } => {
            json!([
                "put_once",
                key,
                content::of(&payload),
                encoding(&payload),
                qos_fields(qos)
            ])
        }
        Action::PutRetained {
            key,
            payload,
            qos,
            attachment,
            ..
        } => json!([
            "put_retained",
            key,
            payload.as_ref().map(parts),
            qos_fields(qos),
            of_bytes(&attachment)
        ]),
        Action::AnswerRetained { query, replies } => {
            let replies: Vec<_> = replies
                .iter()
                .map(|reply| {
                    json!([
                        reply.key,
                        parts(&reply.payload),
                        of_bytes(&reply.attachment)
                    ])
                })
                .collect();
            json!(["answer_retained", query.0, replies])
        }
        Action::Get { id, get } if get.liveliness => {
            json!([
                "get_liveliness",
                id.0,
                get.selector,
                get.timeout.as_secs_f64()
            ])
        }
        Action::Get { id, get } => json!([
            "get",
            id.0,
            get.selector,
            get.payload.as_ref().map(parts),
            get.attachment.map(|attachment| of_bytes(&attachment)),
            qos_fields(get.qos),
            get.target == Target::All,
            get.timeout.as_secs_f64(),
        ]),
        Action::Answer { query, answer } => match answer {
            Answer::Reply { key, payload } => {
                json!([
                    "reply",
                    query.0,
                    key,
                    content::of(&payload),
                    encoding(&payload)
                ])
            }
            Answer::Error(payload) => {
                json!([
                    "reply_error",
                    query.0,
                    content::of(&payload),
                    encoding(&payload)
                ])
            }
            Answer::None => json!(["end_query", query.0]),
        },
    }
}

fn declare(id: u64, declaration: Declaration) -> Value {
    match declaration {
        Declaration::Publisher {
            key,
            qos,
            observes_matching,
        } => json!([
            "declare_publisher",
            id,
            key,
            qos_fields(qos),
            observes_matching
        ]),
        Declaration::Subscriber { key } => json!(["declare_subscriber", id, key]),
        Declaration::Queryable { key, complete } => json!(["declare_queryable", id, key, complete]),
        Declaration::LivelinessToken { key } => json!(["declare_token", id, key]),
        Declaration::LivelinessSubscriber { key } => {
            json!(["declare_liveliness_subscriber", id, key])
        }
        Declaration::LinkListener => json!(["declare_link_listener", id]),
    }
}

fn qos_fields(qos: Qos) -> Value {
    json!([qos.priority, qos.express, qos.droppable])
}

fn encoding(payload: &Payload) -> &str {
    payload.encoding.as_str()
}

fn parts(payload: &Payload) -> Value {
    json!([content::of(payload), encoding(payload)])
}

impl Describe for Infallible {
    fn describe(self) -> Value {
        match self {}
    }
}

impl Describe for () {
    fn describe(self) -> Value {
        Value::Null
    }
}

impl Describe for Vec<Name> {
    fn describe(self) -> Value {
        json!(self.iter().map(Name::as_str).collect::<Vec<_>>())
    }
}

impl Describe for Waited {
    fn describe(self) -> Value {
        json!(match self {
            Self::Ready => "ready",
            Self::TimedOut => "timed_out",
            Self::Closed => "closed",
        })
    }
}

impl Describe for Result<Payload, RegistryError> {
    fn describe(self) -> Value {
        match self {
            Ok(payload) => json!(["answer", parts(&payload)]),
            Err(RegistryError::Rejected(payload)) => json!(["rejected", parts(&payload)]),
            Err(RegistryError::TimedOut { expected }) => json!(["timed_out", expected]),
            Err(RegistryError::NoService { service, available }) => {
                json!(["no_service", [json!(service), available.describe()]])
            }
            Err(RegistryError::Closed) => json!(["closed", null]),
        }
    }
}

impl Describe for ReceivedFrame {
    fn describe(self) -> Value {
        let age = self.age.map(|age| age.as_secs_f64());
        let (payload, encoding) = (content::of(&self.payload), self.payload.encoding.as_str());
        json!([self.ordinal, self.lost, self.number, age, payload, encoding])
    }
}

impl Describe for Event {
    fn describe(self) -> Value {
        let link = |kind,
                    Link {
                        method,
                        address,
                        robot,
                    }: Link| {
            json!([kind, robot.map(|robot| robot.to_string()), method, address])
        };
        match self {
            Self::PeerUp { robot } => json!(["peer_up", robot.as_str()]),
            Self::PeerDown { robot } => json!(["peer_down", robot.as_str()]),
            Self::ProgramUp { robot, program } => {
                json!(["program_up", robot.as_str(), program.as_str()])
            }
            Self::ProgramDown { robot, program } => {
                json!(["program_down", robot.as_str(), program.as_str()])
            }
            Self::LinkUp(up) => link("link_up", up),
            Self::LinkDown(down) => link("link_down", down),
            Self::LinkSilent(silent) => link("link_silent", silent),
            Self::LinkResumed(resumed) => link("link_resumed", resumed),
            Self::PathSwitched { link, path, reason } => json!([
                "path_switched",
                link.robot.map(|robot| robot.to_string()),
                link.method,
                link.address,
                path,
                reason.as_str()
            ]),
            Self::RouterUp => json!(["router_up"]),
            Self::RouterDown => json!(["router_down"]),
        }
    }
}

impl Describe for Message {
    fn describe(self) -> Value {
        let retained = self.retained.map(|retained| {
            json!([
                retained.age.as_secs_f64(),
                retained.has_ended,
                retained.is_forgotten
            ])
        });
        let (sender, topic) = (self.sender.as_str(), self.topic.as_str());
        json!([sender, topic, parts(&self.payload), retained])
    }
}

impl Describe for Vec<Message> {
    fn describe(self) -> Value {
        self.into_iter().map(Describe::describe).collect()
    }
}

impl Describe for Option<retained::value::Value> {
    fn describe(self) -> Value {
        let value = self.and_then(|value| Some(value.message(value.robot.clone()?)));
        value.map_or(Value::Null, Describe::describe)
    }
}

impl Describe for Outcome {
    fn describe(self) -> Value {
        match self {
            Self::Kept(kept) => json!(["kept", kept.warning]),
            Self::Refused(reason) => json!(["refused", reason]),
            Self::NoKeeper => json!(["no_keeper", NO_KEEPER]),
            Self::Closed => json!(["closed", null]),
        }
    }
}

impl Describe for keeper::Item {
    fn describe(self) -> Value {
        match self {
            Self::Warning(text) => json!(text),
            Self::Save(_) => Value::Null,
        }
    }
}

impl Describe for Vec<Connection> {
    fn describe(self) -> Value {
        json!(format!("{} connections", self.len()))
    }
}

impl Describe for Progress {
    fn describe(self) -> Value {
        json!([self.received_bytes, self.size_bytes])
    }
}

impl Describe for Fetched {
    fn describe(self) -> Value {
        match &self.dictionary {
            Some(dictionary) => json!(format!("dictionary {}", dictionary.id())),
            None => json!(self.to_string()),
        }
    }
}

impl Describe for Result<(), SendError> {
    fn describe(self) -> Value {
        json!(match self {
            Ok(()) => "complete".to_owned(),
            Err(SendError::Refused(refusal)) => refusal.to_string(),
            Err(SendError::Failed(fault)) => fault.to_string(),
            Err(SendError::TimedOut { expected, timeout }) =>
                format!("no {expected} within {} s", timeout.as_secs()),
            Err(SendError::Closed) => "closed".to_owned(),
        })
    }
}

impl Describe for Result<(), Fault> {
    fn describe(self) -> Value {
        json!(match self {
            Ok(()) => "complete".to_owned(),
            Err(fault) => fault.to_string(),
        })
    }
}

impl Describe for Arrival {
    fn describe(self) -> Value {
        match self {
            Self::Begin(id, offer) => json!([
                "begin",
                format!(
                    "{id} {}/{} {:?}, {} bytes",
                    offer.sender,
                    offer.topic,
                    offer.name.as_str(),
                    offer.size_bytes
                )
            ]),
            Self::OfferedAgain(id) => json!(["offered_again", id.to_string()]),
        }
    }
}
