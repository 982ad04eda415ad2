//! The lower storey: everything that decides, without I/O. What is here is the same in every language.
pub mod array;
pub mod attachment;
pub mod codec;
pub mod connection;
pub mod dictionary;
pub mod encoding;
pub mod gaps;
pub mod key;
pub mod message;
pub mod name;
pub mod payload;
pub mod picture;
pub mod queue;
pub mod request;
pub mod topic;
pub mod urgency;
pub mod wording;
