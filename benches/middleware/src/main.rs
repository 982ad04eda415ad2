//! Runs one side of the bench `middleware`: two programs use one of the middlewares RECT, plain zenoh, gRPC and MQTT. One
//! program serves, the other measures; a third can be the MQTT broker. `benches/middleware.py` starts them.
//!
//! ```text
//! middleware serve rect 127.0.0.1:7000                    # or with --router: 127.0.0.1:7000 is a router
//! middleware measure rect publish 127.0.0.1:7000 --bytes 64 --seconds 1
//! ```
//! The figures are printed as one line of JSON.
mod arrivals;
mod broker;
mod counting;
mod grpc;
mod measure;
mod mqtt;
mod peer;
mod rect;
mod zenoh;

use std::{net::SocketAddr, time::Duration};

use clap::{Parser, ValueEnum};

use self::{
    arrivals::ArrivalCounter,
    measure::{Job, Load},
    peer::{Meeting, Outcome, Peer},
};

#[derive(Parser)]
#[command(about = "One side of the bench `middleware`")]
enum Role {
    /// Serves until the process is ended.
    Serve {
        middleware: Middleware,
        #[command(flatten)]
        place: Place,
    },
    /// Measures, and prints the figures as JSON.
    Measure {
        middleware: Middleware,
        job: Job,
        #[command(flatten)]
        place: Place,
        /// The size of a payload in bytes.
        #[arg(long, default_value_t = 64)]
        bytes: usize,
        /// The duration of the measurement in seconds.
        #[arg(long, default_value_t = 1.0)]
        seconds: f64,
    },
    /// Runs the MQTT broker until the process is ended.
    Broker { address: SocketAddr },
}

#[derive(clap::Args)]
struct Place {
    /// The address of the serving program, or of the router or broker.
    address: SocketAddr,
    /// The address is that of a router.
    #[arg(long)]
    router: bool,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Middleware {
    Rect,
    /// RECT, with one thread for Zenoh's work.
    RectOneThread,
    Zenoh,
    /// Plain zenoh, with an attachment to each message.
    ZenohAttached,
    Grpc,
    Mqtt,
}

fn main() -> Outcome<()> {
    let role = Role::parse();
    if let Role::Broker { address } = role {
        return broker::run(address);
    }
    if role.middleware() == Some(Middleware::RectOneThread) {
        ::rect::use_one_thread();
    }
    // All middlewares use the same runtime; zenoh has additional threads.
    let runtime = tokio::runtime::Runtime::new()?;
    runtime.block_on(async {
        match role {
            Role::Serve { middleware, place } => serve(middleware, place.into()).await,
            Role::Measure {
                middleware,
                job,
                place,
                bytes,
                seconds,
            } => {
                let span = Duration::from_secs_f64(seconds);
                measured(middleware, job, place.into(), Load { bytes, span }).await
            }
            Role::Broker { .. } => Ok(()),
        }
    })
}

impl Role {
    fn middleware(&self) -> Option<Middleware> {
        match self {
            Self::Serve { middleware, .. } | Self::Measure { middleware, .. } => Some(*middleware),
            Self::Broker { .. } => None,
        }
    }
}

impl From<Place> for Meeting {
    fn from(place: Place) -> Self {
        Self {
            address: place.address,
            router: place.router,
        }
    }
}

async fn serve(middleware: Middleware, meeting: Meeting) -> Outcome<()> {
    let arrivals = ArrivalCounter::shared();
    match middleware {
        Middleware::Rect | Middleware::RectOneThread => rect::Rect::serve(meeting, arrivals).await,
        Middleware::Zenoh => zenoh::Zenoh::<false>::serve(meeting, arrivals).await,
        Middleware::ZenohAttached => zenoh::Zenoh::<true>::serve(meeting, arrivals).await,
        Middleware::Grpc => grpc::Grpc::serve(meeting, arrivals).await,
        Middleware::Mqtt => mqtt::Mqtt::serve(meeting, arrivals).await,
    }
}

async fn measured(middleware: Middleware, job: Job, meeting: Meeting, load: Load) -> Outcome<()> {
    match middleware {
        Middleware::Rect | Middleware::RectOneThread => run::<rect::Rect>(job, meeting, load).await,
        Middleware::Zenoh => run::<zenoh::Zenoh<false>>(job, meeting, load).await,
        Middleware::ZenohAttached => run::<zenoh::Zenoh<true>>(job, meeting, load).await,
        Middleware::Grpc => run::<grpc::Grpc>(job, meeting, load).await,
        Middleware::Mqtt => run::<mqtt::Mqtt>(job, meeting, load).await,
    }
}

/// Runs a job in a task, as programs do, because the thread of `main` does not belong to the runtime.
async fn run<P: Peer>(job: Job, meeting: Meeting, load: Load) -> Outcome<()> {
    let figures = tokio::spawn(measure::run::<P>(job, meeting, load)).await??;
    println!("{figures}");
    Ok(())
}
