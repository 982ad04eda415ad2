//! Measures the processor time that a program spends on each message: with RECT's library, or with plain Zenoh.
//!
//!     message_cost rect|zenoh receive|publish tcp/<router> <messages>
//!
//! Start the receiver first. The publisher sends a message of 64 bytes every 5 ms, so that each travels alone. Both print one
//! line of JSON. `packaging/footprint/run` runs it on an emulated Raspberry Pi 3B, where processor time counts instructions.
mod processor_time;

use std::{
    error::Error,
    process::ExitCode,
    time::{Duration, Instant},
};

use processor_time::processor_time;
use rect::{Payload, QueueOptions, WhenFull};
use zenoh::qos::CongestionControl;

type Outcome<T> = Result<T, Box<dyn Error + Send + Sync>>;

const PAYLOAD: [u8; 64] = [7; 64];
const PERIOD: Duration = Duration::from_millis(5);
/// Number of messages before those that are measured.
const WARM_UP: u32 = 100;
const TIMEOUT: Duration = Duration::from_secs(30);
const KEY: &str = "cost/message";

#[tokio::main(worker_threads = 1)]
async fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let arguments: Vec<_> = arguments.iter().map(String::as_str).collect();
    let [library, role, router, messages] = arguments[..] else {
        eprintln!("usage: message_cost rect|zenoh receive|publish tcp/<router> <messages>");
        return ExitCode::from(2);
    };
    let outcome = async {
        let messages = messages.parse()?;
        match (library, role) {
            ("rect", "publish") => rect_publish(router, messages).await,
            ("rect", "receive") => rect_receive(router, messages).await,
            ("zenoh", "publish") => zenoh_publish(router, messages).await,
            ("zenoh", "receive") => zenoh_receive(router, messages).await,
            _ => Err(format!("no library or role: {library} {role}").into()),
        }
    };
    match outcome.await {
        Ok(us) => {
            println!("{{\"library\": \"{library}\", \"role\": \"{role}\", \"us\": {us:.1}}}");
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("message_cost: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Publishes at a steady rate with `publish`. Returns the processor time of a message, in microseconds.
async fn paced(messages: u32, mut publish: impl AsyncFnMut() -> Outcome<()>) -> Outcome<f64> {
    let mut ticks = tokio::time::interval(PERIOD);
    let mut before = Duration::ZERO;
    for n in 0..WARM_UP + messages {
        if n == WARM_UP {
            before = processor_time()?;
        }
        ticks.tick().await;
        publish().await?;
    }
    ticks.tick().await;
    Ok(us_each(processor_time()? - before, messages))
}

/// Receives with `next` what [`paced`] publishes. Returns the processor time of a message, in microseconds.
async fn counted(messages: u32, mut next: impl AsyncFnMut() -> Outcome<()>) -> Outcome<f64> {
    let mut before = Duration::ZERO;
    for n in 0..WARM_UP + messages {
        if n == WARM_UP {
            before = processor_time()?;
        }
        next().await?;
    }
    Ok(us_each(processor_time()? - before, messages))
}

async fn rect_publish(router: &str, messages: u32) -> Outcome<f64> {
    let robot = rect::Options::new("wombat-1")?.router(router);
    let robot = robot.connect().await?;
    let publisher = robot.publisher::<Payload>(KEY).await?;
    publisher.wait_for_subscriber(TIMEOUT).await?;
    paced(messages, async || {
        Ok(publisher.publish(PAYLOAD.as_slice()).await?)
    })
    .await
}

async fn rect_receive(router: &str, messages: u32) -> Outcome<f64> {
    let robot = rect::Options::new("wombat-1")?.router(router);
    let robot = robot.connect().await?;
    let each = QueueOptions {
        when_full: WhenFull::Block,
        ..QueueOptions::default()
    };
    let subscriber = robot
        .subscribe_with::<Payload>(format!("*/{KEY}").as_str(), each)
        .await?;
    counted(messages, async || {
        let message = subscriber.next().await;
        message.map(drop).ok_or_else(|| "the session ended".into())
    })
    .await
}

async fn zenoh_publish(router: &str, messages: u32) -> Outcome<f64> {
    let session = zenoh_session(router).await?;
    let publisher = session.declare_publisher(KEY);
    let publisher = publisher.congestion_control(CongestionControl::Block);
    let publisher = publisher.await?;
    let deadline = Instant::now() + TIMEOUT;
    while !publisher.matching_status().await?.matching() {
        if Instant::now() > deadline {
            return Err("nobody subscribes".into());
        }
        tokio::time::sleep(PERIOD).await;
    }
    paced(messages, async || publisher.put(PAYLOAD).await).await
}

async fn zenoh_receive(router: &str, messages: u32) -> Outcome<f64> {
    let session = zenoh_session(router).await?;
    let subscriber = session.declare_subscriber("*/message").await?;
    counted(messages, async || subscriber.recv_async().await.map(drop)).await
}

async fn zenoh_session(router: &str) -> Outcome<zenoh::Session> {
    let mut config = zenoh::Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("connect/endpoints", &format!("[{router:?}]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    zenoh::open(config).await
}

fn us_each(time: Duration, messages: u32) -> f64 {
    time.as_secs_f64() * 1e6 / f64::from(messages)
}
