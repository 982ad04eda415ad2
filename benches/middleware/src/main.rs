//! What the bench `middleware` runs: two programs that talk by one of four middlewares, RECT, plain zenoh, gRPC or MQTT.
//! One answers, the other measures; a third can be the MQTT broker. `benches/middleware.py` starts them.
//!
//! ```text
//! middleware serve rect 127.0.0.1:7000                    # or with --router: 127.0.0.1:7000 is a router
//! middleware measure rect publish 127.0.0.1:7000 --bytes 64 --seconds 1
//! ```
//! What was measured is printed as one line of JSON.
mod broker;
mod counting;
mod grpc;
mod measure;
mod mqtt;
mod peer;
mod rect;
mod tally;
mod zenoh;

use std::{net::SocketAddr, time::Duration};

use clap::{Parser, ValueEnum};

use self::{
    measure::{Job, Load},
    peer::{Meeting, Outcome, Peer},
    tally::Tally,
};

#[derive(Parser)]
#[command(about = "One side of the bench `middleware`")]
enum Role {
    /// Answers, until it is ended.
    Serve {
        middleware: Middleware,
        #[command(flatten)]
        place: Place,
    },
    /// Measures, and prints what as JSON.
    Measure {
        middleware: Middleware,
        job: Job,
        #[command(flatten)]
        place: Place,
        /// Of a message's payload.
        #[arg(long, default_value_t = 64)]
        bytes: usize,
        /// For how long.
        #[arg(long, default_value_t = 1.0)]
        seconds: f64,
    },
    /// Is the MQTT broker, until it is ended.
    Broker { address: SocketAddr },
}

#[derive(clap::Args)]
struct Place {
    /// Where the one who serves listens, or the router or broker.
    address: SocketAddr,
    /// It is a router, of RECT's or Zenoh's.
    #[arg(long)]
    router: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Middleware {
    Rect,
    Zenoh,
    Grpc,
    Mqtt,
}

fn main() -> Outcome<()> {
    let role = Role::parse();
    if let Role::Broker { address } = role {
        return broker::run(address);
    }
    // The same for all; zenoh has threads of its own beside it.
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

impl From<Place> for Meeting {
    fn from(place: Place) -> Self {
        Self {
            address: place.address,
            router: place.router,
        }
    }
}

async fn serve(middleware: Middleware, meeting: Meeting) -> Outcome<()> {
    let tally = Tally::shared();
    match middleware {
        Middleware::Rect => rect::Rect::serve(meeting, tally).await,
        Middleware::Zenoh => zenoh::Zenoh::serve(meeting, tally).await,
        Middleware::Grpc => grpc::Grpc::serve(meeting, tally).await,
        Middleware::Mqtt => mqtt::Mqtt::serve(meeting, tally).await,
    }
}

async fn measured(middleware: Middleware, job: Job, meeting: Meeting, load: Load) -> Outcome<()> {
    match middleware {
        Middleware::Rect => run::<rect::Rect>(job, meeting, load).await,
        Middleware::Zenoh => run::<zenoh::Zenoh>(job, meeting, load).await,
        Middleware::Grpc => run::<grpc::Grpc>(job, meeting, load).await,
        Middleware::Mqtt => run::<mqtt::Mqtt>(job, meeting, load).await,
    }
}

/// In a task, as programs do it: the thread that `main` runs on is none of the runtime's.
async fn run<P: Peer>(job: Job, meeting: Meeting, load: Load) -> Outcome<()> {
    let figures = tokio::spawn(measure::run::<P>(job, meeting, load)).await??;
    println!("{figures}");
    Ok(())
}
