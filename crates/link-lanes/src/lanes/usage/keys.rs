//! Keeps the Zenoh keys that the two sides of a link have declared, by their numbers, so that the key of a message that
//! contains only a number is known. A key beyond the limits is not kept; its messages count as others.
use std::collections::HashMap;

use zenoh_protocol::{
    core::{ExprId, WireExpr},
    network::Mapping,
};

use super::batch::{Batch, Part};

/// The largest number of keys that are kept of each side.
const MAX_KEYS: usize = 4096;
/// The largest total of their lengths, in bytes.
const MAX_BYTES: usize = 262_144;

/// The side of a link that has sent a declaration or a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// This side.
    Own,
    /// The peer.
    Peer,
}

/// Returns whether a batch may contain a declaration: it is more than the keep-alive that most batches of Zenoh's own messages are.
pub fn may_declare(batch: &[u8]) -> bool {
    batch.len() > 2
}

/// The declared keys of both sides of a link.
#[derive(Clone, Debug, Default)]
pub struct KeyTable {
    own: Declared,
    peer: Declared,
}

impl KeyTable {
    /// Handles a batch of Zenoh's own messages from one side.
    pub fn on_batch(&mut self, from: Side, batch: &[u8]) {
        for part in Batch::new(batch) {
            let Part::Declared(number, expr, _) = part else {
                continue;
            };
            let mut key = String::new();
            let is_known = expr.is_some_and(|expr| self.append(from, &expr, &mut key));
            let keys = self.of(from);
            keys.remove(number);
            if is_known {
                keys.insert(number, key);
            }
        }
    }

    /// Appends the key of a message from one side to `key`. Returns `false` if it is not known.
    pub fn append(&self, from: Side, expr: &WireExpr<'_>, key: &mut String) -> bool {
        if expr.scope != 0 {
            let keys = match (from, expr.mapping) {
                (Side::Own, Mapping::Sender) | (Side::Peer, Mapping::Receiver) => &self.own,
                (Side::Peer, Mapping::Sender) | (Side::Own, Mapping::Receiver) => &self.peer,
            };
            let Some(declared) = keys.by_number.get(&expr.scope) else {
                return false;
            };
            key.push_str(declared);
        }
        key.push_str(&expr.suffix);
        !key.is_empty()
    }

    fn of(&mut self, side: Side) -> &mut Declared {
        match side {
            Side::Own => &mut self.own,
            Side::Peer => &mut self.peer,
        }
    }
}

/// The declared keys of one side.
#[derive(Clone, Debug, Default)]
struct Declared {
    by_number: HashMap<ExprId, Box<str>>,
    bytes: usize,
}

impl Declared {
    fn insert(&mut self, number: ExprId, key: String) {
        let bytes = self.bytes + key.len();
        if self.by_number.len() < MAX_KEYS && bytes <= MAX_BYTES {
            self.bytes = bytes;
            self.by_number.insert(number, key.into());
        }
    }

    fn remove(&mut self, number: ExprId) {
        if let Some(key) = self.by_number.remove(&number) {
            self.bytes -= key.len();
        }
    }
}
