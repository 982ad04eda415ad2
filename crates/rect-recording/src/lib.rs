//! Records messages in MCAP files, and reads them back.
//!
//! While a [`Recorder`] runs, a recording is a folder of short files ([`segments`]). Each one is complete, synced and renamed
//! before the next one begins, so that after a power cut only the last seconds are missing. When the recorder stops, they
//! become one file. [`Reader`] reads the folder as well as the file.
pub mod answer;
pub mod backlog;
pub mod channel;
mod chunk;
pub mod entry;
mod entry_pattern;
pub mod excerpt;
pub mod export;
pub mod file;
pub mod inferred;
pub mod key_frames;
pub mod log;
pub mod log_recorder;
pub mod merge;
pub mod pace;
pub mod parts;
pub mod picture;
pub mod pictures;
pub mod reader;
pub mod recorder;
mod recorder_error;
pub mod remap;
pub mod replay;
pub mod report;
pub mod retained;
pub mod schema;
pub mod segments;
pub mod summary;
mod time_range;
pub mod video_file;
pub mod view;

pub use entry::RetainedKind;
pub use entry::{address, Entry};
pub use entry_pattern::EntryPattern;
pub use parts::Split;
pub use reader::{Extras, Missing, ReadError, Reader};
pub use recorder::{Progress, Recorder, Settings};
pub use recorder_error::RecorderError;
pub use replay::{by_time, Replay, Selection};
pub use summary::Summary;
