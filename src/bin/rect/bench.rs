//! Implements `rect bench`, which measures the connection to another robot that runs `rect bench --serve`.
use std::{
    process::ExitCode,
    sync::Arc,
    time::{Duration, Instant},
};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rect::{core::display::line, Json, Name, Robot, Urgency};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::{
    sync::{watch, Semaphore},
    time::{timeout, timeout_at},
};

use crate::{
    duration::DurationArgument,
    session::{name, JoinArguments},
    Done, Failure,
};

const ECHO: &str = "rect-bench/echo";
const COUNT: &str = "rect-bench/count";
const LOAD: &str = "rect-bench/load";
/// The topic on which the serving robot acknowledges messages of the load.
const ACKNOWLEDGEMENT: &str = "rect-bench/more";
/// Largest number of messages of the load in flight: 128 kB fill any link between robots, and are transmitted within 4 s
/// over the slowest one. Without a limit, the queues hold some 20 MB.
const WINDOW: usize = 32;
/// Number of messages that one acknowledgement covers.
const ACKNOWLEDGED: u64 = 4;
/// Size of a request, in bytes, similar to a command or a sensor value.
const PING_BYTES: usize = 16;
/// Size of a message of the load, in bytes.
const LOAD_BYTES: usize = 4096;
/// Time without an acknowledgement after which messages of the load count as lost.
const LOST_AFTER: Duration = Duration::from_secs(2);
/// Timeout of a request.
const TIMEOUT: Duration = Duration::from_secs(10);

/// Measure the round trip (idle and under load), goodput and loss to another robot that runs `rect bench --serve`
#[derive(Args)]
pub struct BenchArguments {
    /// The other robot
    #[arg(value_parser = name, required_unless_present = "serve")]
    robot: Option<Name>,
    /// Serve measurements of other robots, until Ctrl-C
    #[arg(long, conflicts_with = "robot")]
    serve: bool,
    /// The duration of each of the two measurements
    #[arg(long, default_value = "5s")]
    duration: DurationArgument,
    /// Print JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// The load that the other robot has received.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct ReceivedLoad {
    messages: u64,
    bytes: u64,
    /// Time since the last message arrived, in seconds.
    last_ago_s: f64,
}

/// The result of one measurement of the round trip.
#[derive(Clone, Copy, Debug, Serialize)]
struct RoundTrip {
    p50_ms: f64,
    p99_ms: f64,
    answers: usize,
    lost: usize,
}

/// Runs `rect bench`.
pub async fn run(arguments: BenchArguments) -> Done {
    let robot = arguments.join.join().await?;
    let Some(other) = arguments.robot else {
        return serve(&robot).await;
    };
    let duration = arguments.duration.0;
    // One duration for each of the two measurements.
    let bar = progress(duration * 2);
    let idle = round_trip(&robot, &other, duration, &bar).await?;
    let before = count(&robot, &other).await?;
    let loading = tokio::spawn(load(robot.clone(), other.clone(), duration));
    let began = Instant::now();
    let loaded = round_trip(&robot, &other, duration, &bar).await?;
    let sent = loading.await??;
    let after = settled(&robot, &other, &bar).await?;
    let took = began.elapsed().as_secs_f64() - after.last_ago_s;
    bar.finish_and_clear();
    let bytes = after.bytes.saturating_sub(before.bytes);
    let arrived = after.messages.saturating_sub(before.messages);
    let lost = sent.saturating_sub(arrived);
    let goodput_kb_s = bytes as f64 / 1000.0 / took.max(f64::EPSILON);
    let method = robot.connections_of(&other, "").await.ok();
    let me = robot.name().as_str();
    let method = method.and_then(|all| {
        let is_me = |peer: &rect::core::connection::PeerId| peer.robot.as_deref() == Some(me);
        let mut all = all.into_iter();
        all.find(|connection| connection.peer.as_ref().is_some_and(is_me))
            .map(|connection| connection.method)
    });
    if arguments.json {
        let all = json!({
            "robot": other, "method": method, "idle": idle, "under_load": loaded,
            "goodput_kb_s": goodput_kb_s, "load_messages": sent, "load_lost": lost,
        });
        rect::terminal::json(&all)?;
        return Ok(ExitCode::SUCCESS);
    }
    rect::outln!(
        "{other}, linked by {}",
        line(method.as_deref().unwrap_or("another robot"))
    );
    for (condition, round_trip) in [("idle", idle), ("under load", loaded)] {
        let RoundTrip {
            p50_ms,
            p99_ms,
            answers,
            lost,
        } = round_trip;
        rect::outln!("round trip, {condition}: p50 {p50_ms:.1} ms, p99 {p99_ms:.1} ms ({answers} replies, {lost} lost; urgent, {PING_BYTES} bytes)");
    }
    rect::outln!("goodput: {goodput_kb_s:.1} kB/s ({arrived} of {sent} messages of {LOAD_BYTES} bytes, {lost} lost)");
    Ok(ExitCode::SUCCESS)
}

async fn serve(robot: &Robot) -> Done {
    let (counts, received) = watch::channel((ReceivedLoad::default(), Instant::now()));
    let load = robot.subscribe(format!("*/{LOAD}").as_str()).await?;
    let acknowledging = robot.clone();
    let counting = async move {
        while let Some(message) = load.next().await {
            counts.send_modify(|(received, last)| {
                received.messages += 1;
                received.bytes += message.payload.bytes.len() as u64;
                *last = Instant::now();
            });
            let messages = counts.borrow().0.messages;
            if messages % ACKNOWLEDGED == 0 {
                acknowledging
                    .send(&message.sender, ACKNOWLEDGEMENT, "")
                    .await?;
            }
        }
        Ok::<_, rect::Error>(())
    };
    let _echo = robot
        .serve(ECHO, |request| async move {
            Ok::<_, String>(request.payload.clone())
        })
        .await?;
    let _count = robot
        .serve(COUNT, move |_| {
            let (received, last) = *received.borrow();
            let last_ago_s = last.elapsed().as_secs_f64();
            async move {
                Ok::<_, String>(Json(ReceivedLoad {
                    last_ago_s,
                    ..received
                }))
            }
        })
        .await?;
    rect::errln!(
        "rect: ready; start the measurement on the other robot with `rect bench {}`; press Ctrl-C to exit",
        robot.name()
    );
    counting.await?;
    Ok(ExitCode::SUCCESS)
}

/// Requests the count of the load that the other robot has received so far.
async fn count(robot: &Robot, other: &Name) -> Result<ReceivedLoad, Failure> {
    let reply = robot.request(other, COUNT, "", TIMEOUT).await;
    let reply = reply.map_err(|error| not_served(other, &error))?;
    Ok(reply.payload.value()?)
}

fn not_served(other: &Name, error: &rect::Error) -> Failure {
    format!("{error}. Is `rect bench --serve` running on {other}?").into()
}

/// Waits until the load has arrived, and returns the final count.
async fn settled(robot: &Robot, other: &Name, bar: &ProgressBar) -> Result<ReceivedLoad, Failure> {
    let mut before = count(robot, other).await?;
    loop {
        tokio::time::sleep(Duration::from_millis(250)).await;
        bar.tick();
        let now = count(robot, other).await?;
        if now.messages == before.messages {
            return Ok(now);
        }
        before = now;
    }
}

/// Sends the load for `duration`, and returns the number of sent messages.
async fn load(robot: Robot, other: Name, duration: Duration) -> Result<u64, rect::Error> {
    let bulk = robot.with_urgency(Urgency::Bulk);
    let window = Arc::new(Semaphore::new(WINDOW));
    let acknowledged = window.clone();
    let pattern = format!("{other}/{ACKNOWLEDGEMENT}");
    let _acknowledgements = robot
        .on_message(pattern.as_str(), move |_| {
            acknowledged.add_permits(ACKNOWLEDGED as usize);
        })
        .await?;
    let end = tokio::time::Instant::now() + duration;
    let mut sent = 0;
    // Messages that are lost over UDP are never acknowledged: without an acknowledgement for `LOST_AFTER`, half a
    // window counts as lost.
    while tokio::time::Instant::now() < end {
        let permit = timeout(LOST_AFTER, window.acquire());
        match timeout_at(end, permit).await {
            Ok(Ok(Ok(permit))) => permit.forget(),
            Ok(Ok(Err(_closed))) => break,
            Ok(Err(_)) => {
                window.add_permits(WINDOW / 2);
                continue;
            }
            Err(_elapsed) => break,
        }
        bulk.send(&other, LOAD, vec![0u8; LOAD_BYTES]).await?;
        sent += 1;
    }
    Ok(sent)
}

/// Measures the round trip of urgent requests for `duration`.
async fn round_trip(
    robot: &Robot,
    other: &Name,
    duration: Duration,
    bar: &ProgressBar,
) -> Result<RoundTrip, Failure> {
    let urgent = robot.urgent();
    let began = Instant::now();
    let (mut times, mut lost) = (Vec::new(), 0);
    while began.elapsed() < duration {
        let asked = Instant::now();
        match urgent
            .request(other, ECHO, [0u8; PING_BYTES], TIMEOUT)
            .await
        {
            Ok(_) => times.push(asked.elapsed()),
            Err(rect::Error::TimedOut { .. }) => lost += 1,
            Err(error) => return Err(not_served(other, &error)),
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
        bar.inc(asked.elapsed().as_millis() as u64);
    }
    times.sort();
    let at = |share: f64| {
        let last = times.len().checked_sub(1)?;
        times.get((last as f64 * share).round() as usize)
    };
    let ms = |time: Option<&Duration>| time.map_or(f64::NAN, |time| time.as_secs_f64() * 1000.0);
    Ok(RoundTrip {
        p50_ms: ms(at(0.5)),
        p99_ms: ms(at(0.99)),
        answers: times.len(),
        lost,
    })
}

fn progress(duration: Duration) -> ProgressBar {
    let bar = ProgressBar::new(duration.as_millis() as u64);
    let style = ProgressStyle::with_template("{bar:40} {percent}%");
    bar.with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
}
