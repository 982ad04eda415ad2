//! Decides how received payloads are decoded: with which dictionaries, when a missing one is fetched from its sender, and
//! which dictionaries this program serves.
use std::{
    collections::{BTreeMap, HashMap},
    sync::Arc,
    time::{Duration, Instant},
};

use crate::{
    codec::{
        self,
        dictionary::{Dictionary, DictionaryError, RobotDictionaries},
        CodecError, Limits,
    },
    driver::{
        question::{Next, Question},
        Action, Driver, Event, Get, Id, Reaction, Step,
    },
    message::{payload::Payload, urgency::Qos},
    name::{key::KeySpace, Name},
};

/// The timeout for fetching a dictionary: 100 kB take 3 s at 34 kB/s, and the link carries other traffic, too.
const TIMEOUT: Duration = Duration::from_secs(5);
/// The shortest time between two attempts to fetch a dictionary, so that not every message of a series waits for one.
const RETRY_AFTER: Duration = Duration::from_secs(30);
/// The maximum number of dictionaries that are remembered as unavailable.
const MAX_MISSING: usize = 256;
/// Zenoh's `DataHigh`: messages wait for the dictionary.
const QOS: Qos = Qos {
    priority: 4,
    express: false,
    droppable: false,
};
const QUERY: Id = Id(0);

/// Decodes the payloads that one program receives.
#[derive(Debug)]
pub struct Decoder {
    place: KeySpace,
    limits: Limits,
    dictionaries: RobotDictionaries,
    missing: HashMap<(Name, u32), Instant>,
    served: BTreeMap<u32, Arc<Dictionary>>,
}

impl Decoder {
    /// Creates the decoder of a program of the robot of `place`.
    pub fn new(place: KeySpace) -> Self {
        Self {
            place,
            limits: Limits::default(),
            dictionaries: RobotDictionaries::default(),
            missing: HashMap::new(),
            served: BTreeMap::new(),
        }
    }

    /// Decodes a payload of the robot `sender`. Returns `None` if it is not encoded by a codec.
    ///
    /// # Errors
    /// Returns [`CodecError::Dictionary`] if a dictionary is missing (see [`fetch`](Self::fetch)), and the other errors
    /// of the codec.
    pub fn decode(&self, sender: &Name, payload: &Payload) -> Result<Option<Payload>, CodecError> {
        if !codec::is_encoded(&payload.encoding) {
            return Ok(None);
        }
        codec::decode(payload, &self.limits, self.dictionaries.of(sender)).map(Some)
    }

    /// Returns the driver that fetches the dictionary whose absence `error` reports. `None` if the error has another
    /// cause, or if the dictionary was not available a short time ago.
    pub fn fetch(
        &self,
        now: Instant,
        sender: &Name,
        error: &CodecError,
    ) -> Option<DictionaryFetch> {
        let CodecError::Dictionary { id } = *error else {
            return None;
        };
        let asked_at = self.missing.get(&(sender.clone(), id));
        let is_recent = asked_at.is_some_and(|at| now.saturating_duration_since(*at) < RETRY_AFTER);
        (!is_recent).then(|| DictionaryFetch::new(&self.place, sender.clone(), id))
    }

    /// Handles the outcome of a fetch. Returns whether the dictionary is available now.
    pub fn on_fetched(&mut self, now: Instant, fetched: Fetched) -> bool {
        let Fetched {
            sender,
            id,
            dictionary,
        } = fetched;
        match dictionary {
            Some(dictionary) => {
                self.dictionaries.add(&sender, Arc::new(dictionary));
                true
            }
            None => {
                if self.missing.len() >= MAX_MISSING {
                    self.missing.clear();
                }
                self.missing.insert((sender, id), now);
                false
            }
        }
    }

    /// Makes a dictionary available to receivers. Returns the key of the queryable to declare, or `None` if the
    /// dictionary is served already.
    ///
    /// # Errors
    /// Returns [`DictionaryError::IdTaken`] if this program serves another dictionary with the same id, which receivers
    /// could not tell apart.
    pub fn serve(
        &mut self,
        dictionary: &Arc<Dictionary>,
    ) -> Result<Option<String>, DictionaryError> {
        let id = dictionary.id();
        match self.served.get(&id) {
            Some(served) if served.as_bytes() == dictionary.as_bytes() => return Ok(None),
            Some(_) => return Err(DictionaryError::IdTaken(id)),
            None => {}
        }
        self.served.insert(id, dictionary.clone());
        // A program may receive its own messages.
        let me = self.place.robot.clone();
        self.dictionaries.add(&me, dictionary.clone());
        Ok(Some(key(&self.place, &me, id)))
    }

    /// Withdraws a dictionary whose queryable could not be declared.
    pub fn on_not_served(&mut self, id: u32) {
        self.served.remove(&id);
    }
}

/// Fetches a dictionary from the robot that uses it.
#[derive(Debug)]
pub struct DictionaryFetch {
    sender: Name,
    id: u32,
    get: Get,
    question: Question,
    is_answered: bool,
    dictionary: Option<Dictionary>,
}

/// The outcome of a fetch.
#[derive(Debug)]
pub struct Fetched {
    /// The robot that uses the dictionary.
    pub sender: Name,
    /// The id of the dictionary.
    pub id: u32,
    /// The dictionary. `None` if the robot does not serve it.
    pub dictionary: Option<Dictionary>,
}

impl DictionaryFetch {
    fn new(place: &KeySpace, sender: Name, id: u32) -> Self {
        let get = Get {
            qos: QOS,
            ..Get::new(key(place, &sender, id), TIMEOUT)
        };
        Self {
            sender,
            id,
            get,
            question: Question::new(1),
            is_answered: false,
            dictionary: None,
        }
    }
}

impl Driver for DictionaryFetch {
    type Item = std::convert::Infallible;
    type Output = Fetched;

    fn on_event(&mut self, now: Instant, event: Event) -> Reaction<Self::Item> {
        match event {
            Event::Reply { reply, .. } if self.dictionary.is_none() => {
                self.is_answered = true;
                let bytes = reply.ok().map(|reply| reply.payload.bytes.to_vec());
                let dictionary = bytes.and_then(|bytes| Dictionary::new(bytes).ok());
                self.dictionary = dictionary.filter(|dictionary| dictionary.id() == self.id);
                if self.dictionary.is_some() {
                    self.question.finish();
                }
            }
            Event::Ended { .. } => self.question.on_ended(now, self.is_answered),
            Event::Closed => self.question.finish(),
            _ => return Reaction::NONE,
        }
        Reaction::POLL
    }

    fn poll(&mut self, now: Instant) -> Step<Self::Item, Self::Output> {
        match self.question.next(now) {
            Next::Ask => Step::Act(Action::Get {
                id: QUERY,
                get: self.get.clone(),
            }),
            Next::At(at) => Step::Wait(Some(at)),
            Next::Wait => Step::Wait(None),
            Next::Finish => Step::Finished(Fetched {
                sender: self.sender.clone(),
                id: self.id,
                dictionary: self.dictionary.take(),
            }),
        }
    }
}

/// Explains in a log that a dictionary is not available.
impl std::fmt::Display for Fetched {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { sender, id, .. } = self;
        write!(
            f,
            "{sender} does not provide the dictionary {id}: messages that were compressed with it cannot be decoded"
        )
    }
}

/// Returns the key at which `robot` serves one of its dictionaries.
fn key(place: &KeySpace, robot: &Name, id: u32) -> String {
    place.own(Some(robot), &format!("dictionary/{id}"))
}
