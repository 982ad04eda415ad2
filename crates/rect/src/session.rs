//! Implements sessions on Zenoh: robots, subscribers, services, streams and transfers. The protocol's decisions are made in
//! the [core](rect_core); this module connects them to Zenoh and to the program.
mod action;
mod alert;
mod connect;
mod convert;
mod deadman;
mod declared;
mod decoder;
mod events;
mod executor;
mod gathered;
mod log;
mod name_check;
mod next_item;
mod options;
mod parameters;
mod program_log;
mod publication;
mod publisher;
mod querier;
mod queries;
mod receive_queue;
mod recipients;
#[cfg(feature = "recording")]
mod recorded;
#[cfg(feature = "recording")]
mod recording;
mod registry;
mod request;
mod requester;
mod results;
mod retained;
mod retry;
mod robot;
mod router_links;
mod service;
mod shared;
mod signal;
mod state;
mod stop;
mod stream;
mod subscriber;
mod threads;
mod throttle;
mod transfer;
mod urgency_sessions;
mod waiting;
mod warnings;

pub use action::{Action, ActionChanges, ActionOptions, ActionRun, Cancelled, Goal, StartOptions};
pub use deadman::Deadman;
#[doc(hidden)]
pub use deadman::{DeadmanCall, DeadmanCalls, Losses};
pub use events::Events;
pub use gathered::{Gathered, Outcome};
pub use log::{LogLayer, LogOptions, Logs};
pub use options::{connect, Options};
pub use parameters::{GroupOptions, ParameterField, ParameterGroup, ParameterOrder, Parameters};
#[doc(hidden)]
pub use program_log::KeptLog;
pub use program_log::ProgramLog;
pub use publisher::Publisher;
#[cfg(feature = "recording")]
pub use recorded::Recorded;
#[cfg(feature = "recording")]
pub use recording::{RecordOptions, RobotRecorder};
pub use request::{Replies, Reply};
pub use robot::Robot;
pub use service::{Request, Requests, Service, ServiceOptions};
#[doc(hidden)]
pub use state::{KeptState, Save};
pub use stop::{FleetStop, StopChanges};
pub use stream::{Frame, StreamSender, Watcher};
pub(crate) use subscriber::call;
pub use subscriber::{QueueOptions, SubscribeOptions, Subscriber, Subscription};
pub use threads::use_one_thread;
pub use throttle::RunningThrottle;
pub use transfer::{
    Destination, IncomingTransfer, ReceiveOptions, Received, Transfer, TransferSource, Transfers,
};
