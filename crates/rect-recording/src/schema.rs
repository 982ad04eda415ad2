//! Defines the descriptions that a file has of messages.
use std::{borrow::Cow, collections::BTreeMap, sync::Arc};

/// A schema, as MCAP and viewers take it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Schema {
    /// Its name.
    pub name: String,
    /// MCAP's name of its form.
    pub encoding: Cow<'static, str>,
    /// Its definition.
    pub text: Vec<u8>,
}

/// The description of a channel that another program has recorded, beside its topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Foreign {
    /// MCAP's name of the encoding.
    pub message_encoding: String,
    /// The schema, if there is one.
    pub schema: Option<Arc<Schema>>,
    /// Further properties.
    pub metadata: BTreeMap<String, String>,
}
