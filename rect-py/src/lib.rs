//! Exposes the core of the Rust library to the Python package `rect`.
//!
//! Most classes wrap one type of the core, which makes all decisions and does no I/O. Only transfers also use the
//! library's storage. The sessions are part of the Python code (`python/rect/`), which uses eclipse-zenoh.
mod attachment;
mod callback;
mod codec;
mod connection;
mod counters;
mod detached;
mod errors;
mod key_space;
mod message;
mod picture;
mod queue;
mod request;
mod router;
mod stream;
mod transfer;
mod urgency;
mod value;

use pyo3::prelude::*;

/// The native module of the Python package `rect`.
#[pymodule]
mod _rect {
    #[pymodule_export]
    use crate::{
        attachment::{now_ms, read_attachment, write_attachment, write_attachment_now},
        callback::{OnMessage, OnRequest, Timestamp},
        codec::{decode, Codec, Dictionary, DictionaryStore},
        connection::{named_connection, Links, Presence},
        counters::AtomicCounters,
        detached::{forget_work, settle},
        errors::{forget, on_one_line},
        key_space::{
            check_encoding, check_name, check_topic, encoding_parts, is_encoded, pattern,
            pattern_of, KeySpace,
        },
        message::{Inbound, MessageMetadata},
        picture::{array_encoding, picture, picture_encoding, read_array, read_picture, scaled},
        queue::{Ended, Queue},
        request::{error_encoding, error_from, read_request_header, write_request_header},
        router::{check_router, default_login_file, robot_of_router, JoinAttempts},
        stream::{Job, StreamReceiver, StreamSender},
        transfer::{transfer_ended, Admission, Offered, Pull, Question, TransferSender},
        urgency::{qos, stream_qos, uses_separate_session},
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
        module.add("TRANSFER_OFFERS", transfer::OFFERS)?;
        module.add("CONFIG", named_connection::CONFIG)?;
        module.add("ADD", named_connection::ADD)?;
        module.add("REMOVE", named_connection::REMOVE)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
