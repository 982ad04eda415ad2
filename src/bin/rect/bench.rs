//! Owns `rect bench`: how good the way to another robot is. The other side runs `rect bench --serve`.
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
    session::{name, JoinArguments},
    span::Span,
    Done, Failure,
};

const ECHO: &str = "rect-bench/echo";
const COUNT: &str = "rect-bench/count";
const LOAD: &str = "rect-bench/load";
/// By which the other side tells that more may come.
const MORE: &str = "rect-bench/more";
/// So many messages of the load may be on their way: 128 kB fill any link that a robot has, and drain within 4 s over the
/// slowest. Without a bound the queues on the way take some 20 MB.
const WINDOW: usize = 32;
/// So many that came are told of at once.
const TOLD: u64 = 4;
/// Small, as a command or a sensor's value.
const PING_BYTES: usize = 16;
/// A message of the load, in bytes.
const LOAD_BYTES: usize = 4096;
/// For how long nothing may be told of the load until it is taken for lost.
const LOST_AFTER: Duration = Duration::from_secs(2);
const PATIENCE: Duration = Duration::from_secs(10);

/// Measure the way to another robot: round trip idle and under load, goodput, loss. There: rect bench --serve
#[derive(Args)]
pub struct BenchArguments {
    /// The other robot
    #[arg(value_parser = name, required_unless_present = "serve")]
    robot: Option<Name>,
    /// Be the other side, until Ctrl-C
    #[arg(long, conflicts_with = "robot")]
    serve: bool,
    /// How long each of the three parts takes
    #[arg(long, default_value = "5s")]
    duration: Span,
    /// As JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    join: JoinArguments,
}

/// What the other side has heard of the load.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
struct Heard {
    messages: u64,
    bytes: u64,
    /// How long ago the last of it came.
    last_ago_s: f64,
}

#[derive(Clone, Copy, Debug, Serialize)]
struct RoundTrip {
    p50_ms: f64,
    p99_ms: f64,
    answers: usize,
    lost: usize,
}

/// `rect bench`.
pub async fn run(arguments: BenchArguments) -> Done {
    let robot = arguments.join.join().await?;
    let Some(other) = arguments.robot else {
        return serve(&robot).await;
    };
    let duration = arguments.duration.0;
    let bar = progress(duration * 3);
    let idle = round_trip(&robot, &other, duration, &bar).await?;
    let before: Heard = count(&robot, &other).await?;
    let loading = tokio::spawn(load(robot.clone(), other.clone(), duration));
    let began = Instant::now();
    let loaded = round_trip(&robot, &other, duration, &bar).await?;
    let said = loading.await??;
    let after = settled(&robot, &other, &bar).await?;
    let took = began.elapsed().as_secs_f64() - after.last_ago_s;
    bar.finish_and_clear();
    let bytes = after.bytes.saturating_sub(before.bytes);
    let arrived = after.messages.saturating_sub(before.messages);
    let lost = said.saturating_sub(arrived);
    let goodput_kb_s = bytes as f64 / 1000.0 / took.max(f64::EPSILON);
    let method = robot.connections_of(&other, "").await.ok();
    let me = robot.name().as_str();
    let by = method.and_then(|all| {
        let its = |peer: &rect::core::connection::PeerId| peer.robot.as_deref() == Some(me);
        let mut all = all.into_iter();
        all.find(|one| one.peer.as_ref().is_some_and(its))
            .map(|one| one.method)
    });
    if arguments.json {
        let all = json!({
            "robot": other, "method": by, "idle": idle, "under_load": loaded,
            "goodput_kb_s": goodput_kb_s, "load_messages": said, "load_lost": lost,
        });
        rect::terminal::json(&all)?;
        return Ok(ExitCode::SUCCESS);
    }
    rect::outln!(
        "{other}, linked by {}",
        line(by.as_deref().unwrap_or("another robot"))
    );
    for (what, one) in [("idle", idle), ("under load", loaded)] {
        let RoundTrip {
            p50_ms,
            p99_ms,
            answers,
            lost,
        } = one;
        rect::outln!("round trip, {what}: p50 {p50_ms:.1} ms, p99 {p99_ms:.1} ms ({answers} answers, {lost} lost; urgent, {PING_BYTES} bytes)");
    }
    rect::outln!("goodput: {goodput_kb_s:.1} kB/s ({arrived} of {said} messages of {LOAD_BYTES} bytes, {lost} lost)");
    Ok(ExitCode::SUCCESS)
}

async fn serve(robot: &Robot) -> Done {
    let (counts, came) = watch::channel((Heard::default(), Instant::now()));
    let heard = robot.subscribe(format!("*/{LOAD}").as_str()).await?;
    let telling = robot.clone();
    let counting = async move {
        while let Some(message) = heard.recv().await {
            counts.send_modify(|(heard, last)| {
                heard.messages += 1;
                heard.bytes += message.payload.bytes.len() as u64;
                *last = Instant::now();
            });
            let messages = counts.borrow().0.messages;
            if messages % TOLD == 0 {
                telling.send(&message.from, MORE, "").await?;
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
            let (heard, last) = *came.borrow();
            let last_ago_s = last.elapsed().as_secs_f64();
            async move {
                Ok::<_, String>(Json(Heard {
                    last_ago_s,
                    ..heard
                }))
            }
        })
        .await?;
    rect::errln!(
        "rect: `rect bench {}` at the other robot measures; Ctrl-C ends this",
        robot.name()
    );
    counting.await?;
    Ok(ExitCode::SUCCESS)
}

async fn count(robot: &Robot, other: &Name) -> Result<Heard, Failure> {
    let reply = robot
        .request(other, COUNT, "", PATIENCE)
        .await
        .map_err(|error| Failure::from(format!("{error}. Does `rect bench --serve` run there?")))?;
    Ok(reply.payload.value()?)
}

/// The count once it does not grow any more.
async fn settled(robot: &Robot, other: &Name, bar: &ProgressBar) -> Result<Heard, Failure> {
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

async fn load(robot: Robot, other: Name, duration: Duration) -> Result<u64, rect::Error> {
    let bulk = robot.with(Urgency::Bulk);
    let may = Arc::new(Semaphore::new(WINDOW));
    let more = may.clone();
    let pattern = format!("{other}/{MORE}");
    let _more = robot
        .on_message(pattern.as_str(), move |_| more.add_permits(TOLD as usize))
        .await?;
    let end = tokio::time::Instant::now() + duration;
    let mut said = 0;
    // What is lost (UDP) gives no room back: half a window is taken for lost then.
    while tokio::time::Instant::now() < end {
        let room = timeout(LOST_AFTER, may.acquire());
        match timeout_at(end, room).await {
            Ok(Ok(Ok(one))) => one.forget(),
            Ok(Ok(Err(_closed))) => break,
            Ok(Err(_)) => {
                may.add_permits(WINDOW / 2);
                continue;
            }
            Err(_over) => break,
        }
        bulk.send(&other, LOAD, vec![0u8; LOAD_BYTES]).await?;
        said += 1;
    }
    Ok(said)
}

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
            .request(other, ECHO, [0u8; PING_BYTES], PATIENCE)
            .await
        {
            Ok(_) => times.push(asked.elapsed()),
            Err(rect::Error::TimedOut { .. }) => lost += 1,
            Err(error) => {
                return Err(format!("{error}. Does `rect bench --serve` run there?").into());
            }
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
