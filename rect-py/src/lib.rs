//! The native half of the Python package `rect`: the Rust library's core, which does no I/O, as Python's classes.
//!
//! Nothing is decided here. Each class is a shell over a type of the core; the sessions around it are Python's, over
//! eclipse-zenoh (`python/rect/`).
mod attachment;
mod callback;
mod codec;
mod connection;
mod counters;
mod detached;
mod errors;
mod message;
mod picture;
mod place;
mod queue;
mod request;
mod router;
mod stream;
mod transfer;
mod urgency;
mod value;

use pyo3::prelude::*;

/// What the Python package `rect` takes from the Rust library.
#[pymodule]
mod _rect {
    #[pymodule_export]
    use crate::{
        attachment::{now_ms, read_attachment, write_attachment, write_attachment_now},
        callback::{Moment, OnMessage, OnRequest},
        codec::{unpack, Codec, Dictionary, Known},
        connection::{named_connection, Links, Presence},
        counters::Counting,
        detached::{forget_work, settle},
        errors::{forget, in_words},
        message::{Inbound, Said},
        picture::{array_encoding, picture, picture_encoding, read_array, read_picture, scaled},
        place::{
            check_encoding, check_name, check_topic, encoding_parts, is_packed, pattern,
            pattern_of, Place,
        },
        queue::{Ended, Queue},
        request::{error_encoding, error_from, read_asking, write_asking},
        router::{check_router, default_login_file, robot_of_router, Joining},
        stream::{Job, StreamReceiver, StreamSender},
        transfer::{transfer_ended, Inbox, Offered, Pull, Question, TransferSender},
        urgency::{goes_apart, qos, qos_of_frames},
        value::{read_value, write_value},
    };

    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        use rect::core::{
            login, named_connection, queue::DEFAULT_CAPACITY, request::DEFAULT_TIMEOUT_MS, router,
            transfer,
        };
        module.add("DEFAULT_CAPACITY", DEFAULT_CAPACITY)?;
        module.add("DEFAULT_TIMEOUT_MS", DEFAULT_TIMEOUT_MS)?;
        module.add("LOGIN_VARIABLE", login::FILE_VARIABLE)?;
        module.add("ROBOT_TIMEOUT_S", router::ROBOT_TIMEOUT.as_secs_f64())?;
        module.add("TRANSFER_INBOX", transfer::INBOX)?;
        module.add("CONFIG", named_connection::CONFIG)?;
        module.add("ADD", named_connection::ADD)?;
        module.add("REMOVE", named_connection::REMOVE)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
