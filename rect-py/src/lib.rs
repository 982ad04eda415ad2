//! Exposes the core of the Rust library to the Python package `rect`.
//!
//! Most classes wrap one type of the core, which makes all decisions and does no I/O. Only transfers and
//! recordings also use the library's files. The sessions are part of the Python code (`python/rect/`), which uses eclipse-zenoh.
mod action;
mod action_result;
mod attachment;
mod callback;
mod clock;
mod codec;
mod connection;
mod counters;
mod deadman;
mod decoder;
mod detached;
mod driver;
mod errors;
mod key_space;
mod log;
mod message;
mod parameters;
mod picture;
mod program;
mod publication;
mod queue;
mod recipients;
mod recording;
mod request;
mod requester;
mod retry;
mod router;
mod settings;
mod state;
mod stop;
mod stream;
mod transfer;
mod urgency;
mod used_names;
mod value;

use pyo3::prelude::*;

/// The native module of the Python package `rect`.
#[pymodule]
mod _rect {
    #[pymodule_export]
    use crate::{
        action::{
            goal_ended, goal_feedback_topic, goal_id, goal_to_start, goal_topic, goals_query,
            no_action, ActionOrder, ActionRun, ActionServer, GoalMessage,
        },
        action_result::{ResultPull, ResultToKeep, Results},
        attachment::{read_attachment, write_attachment},
        callback::{OnMessage, OnRequest},
        codec::{decode, Codec, Dictionary},
        connection::{named_connection, Links},
        counters::AtomicCounters,
        deadman::DeadmanSwitch,
        decoder::{Decoder, Fetched},
        detached::{forget_work, settle},
        driver::{
            direct_presence, established_wait, expected_connection, interrupted, no_service,
            not_reachable, observer, peer_wait, peers_query, reachable_robots, registry_change,
            registry_query, router_observer, throttle, ConnectionsReport, Driver, Report, Servers,
        },
        errors::{forget, on_one_line},
        key_space::{
            check_encoding, check_name, check_topic, encoding_kind, encoding_parts, pattern,
            InternalTopic, KeySpace,
        },
        log::{
            alert_topic, alerts_query, level_of_logging, log_keeper, log_reader, write_alert,
            LogOutbox,
        },
        message::{Inbound, MessageMetadata},
        parameters::{
            no_parameters, parameters_file, parameters_topic, ParameterDeclaration, ParameterGroup,
            ParameterOrder, ParameterProposal,
        },
        picture::{array_encoding, picture, picture_encoding, read_array, read_picture, scaled},
        program::{program_name, read_catalogue, Catalogues, OfferedService, ProgramPresence},
        publication::Numbering,
        queue::{Ended, Queue},
        recipients::Recipients,
        recording::{Recorder, RecordingReader},
        request::{
            busy_reply, end_of_replies, error_encoding, Inquiry, RequestIds, Sent, Served, Unsent,
        },
        requester::Requester,
        retry::{retried_request, Execution, Once},
        router::{check_router, default_login_file, robot_of_router, router_advice, JoinAttempts},
        settings::{default_router, session_settings},
        state::{
            latest, state_keeper, KeptValue, ProgramState, RetainedValue, StateArrival, StateOrder,
        },
        stop::FleetStop,
        stream::{FrameReader, Job, StreamPublish, StreamWatch},
        transfer::{OfferedTransfer, TransferPull, TransferPush, TransferReception},
        urgency::{choose_session, qos},
        used_names::UsedNames,
        value::{read_value, write_value},
    };

    use pyo3::{prelude::*, types::PyBytes};

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        use rect_core::{
            action, catalogue,
            message::{
                queue::DEFAULT_CAPACITY,
                request::{DEFAULT_TIMEOUT_MS, SHARED_REPLY},
            },
            registry::named_connection,
            session::{
                declarations, endpoint, inquiry, login, peers, publication, router, service,
                settings,
            },
            stop,
        };
        use rect_recording::{answer, recorder, report};
        module.add("ACTION_LOST_AFTER_S", action::LOST_AFTER.as_secs_f64())?;
        module.add("ADD", named_connection::ADD)?;
        module.add(
            "DECLARED_WITHIN_S",
            catalogue::DECLARED_WITHIN.as_secs_f64(),
        )?;
        module.add("DECLARED_PAUSE_S", catalogue::PAUSE.as_secs_f64())?;
        module.add("DEFAULT_CAPACITY", DEFAULT_CAPACITY)?;
        module.add("DEFAULT_TIMEOUT_S", f64::from(DEFAULT_TIMEOUT_MS) / 1000.0)?;
        module.add("DIAGNOSIS", settings::DIAGNOSIS.to_vec())?;
        module.add("LARGE_BYTES", publication::LARGE_BYTES)?;
        module.add("LINKS_EVERY_S", report::LINKS_EVERY.as_secs_f64())?;
        module.add("LOGIN_VARIABLE", login::FILE_VARIABLE)?;
        module.add("MAX_CONCURRENT", service::MAX_CONCURRENT)?;
        module.add("MAX_DECLARATIONS", declarations::MAX)?;
        module.add("MAX_REPLIES", inquiry::MAX_REPLIES)?;
        module.add("QUERY_TIMEOUT_S", peers::TIMEOUT.as_secs_f64())?;
        module.add("RECORDED_EVENTS", report::EVENTS)?;
        module.add("RECORDED_LINK", report::LINK)?;
        module.add("RECORDED_REQUESTS", report::REQUESTS)?;
        module.add("RECORDER_CAPACITY", recorder::CAPACITY)?;
        module.add("RECORDING_QUERIES", answer::WAITING)?;
        module.add("REMOVE", named_connection::REMOVE)?;
        module.add("ROBOT_TIMEOUT_S", router::ROBOT_TIMEOUT.as_secs_f64())?;
        module.add("ROUTER_VARIABLE", endpoint::ROUTER_VARIABLE)?;
        module.add("SERVICE_CAPACITY", service::CAPACITY)?;
        module.add("SHARED_REPLY", PyBytes::new(module.py(), &SHARED_REPLY))?;
        module.add("STOP_AGAIN_AFTER_S", stop::AGAIN_AFTER.as_secs_f64())?;
        module.add("STOP_MARKED_WITHIN_S", stop::MARKED_WITHIN.as_secs_f64())?;
        module.add("STOP_TOPIC", stop::TOPIC)?;
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
