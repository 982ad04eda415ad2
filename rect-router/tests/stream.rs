//! Streams over two routers and the simulated air: `cargo test -p rect-router --test stream`
//!
//! The air is as slow as a Pi 3B's radio, with link-layer packets of 27 bytes: 34 to 37 kB/s. The figures that are wanted
//! are measured by `benches/stream.py`; the bounds here leave room for a busy machine.

mod support;

use std::{
    sync::{Arc, Mutex},
    thread,
    time::{Duration, Instant},
};

use rect::{
    core::stream::ladder::{Coding, Level, PICTURES},
    Encoding, Frame, Options, Payload, Robot, Stream, StreamOptions, Watch,
};
use support::{joined, simulated, Air, Router, DEADLINE};
use zenoh_link::ble::radio::sim::{AirOptions, LlPayload};

const PIXELS: usize = 320 * 240;

/// Two robots' routers, and where their programs reach them.
struct Robots {
    _air: Air,
    _routers: [Router; 2],
    endpoints: [String; 2],
}

fn robots() -> Robots {
    let air = Air::with(AirOptions {
        pdu: LlPayload::Bytes27,
        ..AirOptions::default()
    });
    let (one, here) = simulated(&air, 1, &[]);
    let (two, there) = simulated(&air, 2, &["-e", "ble/wombat-1#adapter=sim-wombat-2"]);
    Robots {
        _air: air,
        _routers: [one, two],
        endpoints: [here, there],
    }
}

fn runtime() -> tokio::runtime::Runtime {
    tokio::runtime::Runtime::new().expect("a runtime")
}

async fn stream(sender: &Robot) -> Arc<Stream> {
    let stream = sender.stream("camera", StreamOptions::default()).await;
    Arc::new(stream.expect("a stream"))
}

/// A camera of 20 Hz, until the session ends, on a thread of its own: what photographs take, about.
fn camera(stream: Arc<Stream>) {
    thread::spawn(move || {
        let started = Instant::now();
        for n in 0.. {
            let due = started + n * Duration::from_millis(50);
            thread::sleep(due.saturating_duration_since(Instant::now()));
            let sent = stream.send_with(PIXELS, |level| Ok(picture(level.expect("adaptive"), n)));
            // The test is over.
            if sent.is_err() {
                return;
            }
        }
    });
}

fn picture(level: Level, n: u32) -> Payload {
    let (per_pixel, encoding) = match level.coding {
        Coding::Lossless => (1.5, Encoding::PNG),
        Coding::Lossy(quality) => (0.02 + f64::from(quality) / 400.0, Encoding::JPEG),
    };
    let area = (f64::from(level.quarters) / 4.0).powi(2);
    let sways = 0.9 + f64::from(n % 5) * 0.05;
    Payload::new(
        vec![7; (PIXELS as f64 * per_pixel * area * sways) as usize],
        encoding,
    )
}

/// What came within that time.
async fn frames(watch: &Watch, lasts: Duration) -> Vec<Frame> {
    let (started, mut frames) = (Instant::now(), Vec::new());
    while let Some(left) = lasts.checked_sub(started.elapsed()) {
        match tokio::time::timeout(left, watch.recv()).await {
            Ok(frame) => frames.push(frame.expect("the session lives")),
            Err(_) => break,
        }
    }
    frames
}

fn most_of(mut values: Vec<Duration>) -> Duration {
    values.sort();
    values[(values.len() * 99 / 100).min(values.len() - 1)]
}

async fn first(watch: &Watch) -> Frame {
    let frame = tokio::time::timeout(DEADLINE, watch.recv()).await;
    frame.expect("in time").expect("the session lives")
}

#[test]
fn over_a_slow_link_frames_are_fresh_and_urgent_messages_of_the_same_program_in_time() {
    let robots = robots();
    runtime().block_on(one_camera(&robots.endpoints));
}

async fn one_camera([here, there]: &[String; 2]) {
    let (sender, receiver) = (
        joined("wombat-1", here).await,
        joined("wombat-2", there).await,
    );
    let stream = stream(&sender).await;
    let watch = receiver.watch("wombat-1", "camera").await.expect("watched");
    let begun = Instant::now();
    let late: Arc<Mutex<Vec<Duration>>> = Arc::default();
    let heard = late.clone();
    let _urgent = receiver
        .on_message("wombat-1/stop", move |message| {
            let sent_us: u64 = message.payload.value().expect("a number");
            let age = begun.elapsed() - Duration::from_micros(sent_us);
            heard.lock().expect("whole").push(age);
        })
        .await
        .expect("subscribed");
    camera(stream.clone());
    first(&watch).await;
    frames(&watch, Duration::from_secs(6)).await;
    late.lock().expect("whole").clear();
    let urgent = tokio::spawn(async move {
        let sender = sender.urgent();
        let mut ticks = tokio::time::interval(Duration::from_millis(100));
        for _ in 0..100 {
            ticks.tick().await;
            let sent_us = u64::try_from(begun.elapsed().as_micros()).expect("short");
            sender
                .publish("stop", rect::Json(sent_us))
                .await
                .expect("sent");
        }
    });
    let seen = frames(&watch, Duration::from_secs(10)).await;
    urgent.await.expect("sent");
    tokio::time::sleep(Duration::from_millis(500)).await;

    let status = stream.status();
    let bytes: usize = seen.iter().map(|frame| frame.payload.bytes.len()).sum();
    let oldest = most_of(seen.iter().map(|frame| frame.age.expect("told")).collect());
    let late = late.lock().expect("whole").clone();
    println!(
        "{} frames, {} kB/s, age p99 {oldest:?}, urgent p99 {:?}",
        seen.len(),
        bytes / 10_000,
        most_of(late.clone())
    );
    assert!(
        seen.len() >= 50,
        "{} frames in 10 s: {status:?}",
        seen.len()
    );
    assert!(bytes >= 200_000, "{bytes} bytes in 10 s: {status:?}");
    assert!(oldest < Duration::from_secs(1), "{oldest:?}: {status:?}");
    assert_eq!(late.len(), 100, "urgent messages");
    assert!(
        most_of(late.clone()) < Duration::from_millis(250),
        "{late:?}"
    );
}

#[test]
fn a_laptop_at_the_senders_router_gets_it_lossless_while_a_robot_on_bluetooth_gets_what_fits() {
    let robots = robots();
    runtime().block_on(two_watchers(&robots.endpoints));
}

async fn two_watchers([here, there]: &[String; 2]) {
    let sender = joined("wombat-1", here).await;
    let robot = joined("wombat-2", there).await;
    // Another robot's router, on purpose.
    let laptop = Options::new("laptop").expect("a name").login_file("/none");
    let laptop = laptop.router(here).allow_name_mismatch().connect().await;
    let laptop = laptop.expect("joined");
    let stream = stream(&sender).await;
    let slow = robot.watch("wombat-1", "camera").await.expect("watched");
    let fast = laptop.watch("wombat-1", "camera").await.expect("watched");
    camera(stream.clone());
    let begun = Instant::now();
    while first(&fast).await.payload.encoding != Encoding::PNG {
        assert!(begun.elapsed() < DEADLINE, "{:?}", stream.status());
    }
    first(&slow).await;
    let (clear, fits) = tokio::join!(
        frames(&fast, Duration::from_secs(10)),
        frames(&slow, Duration::from_secs(10)),
    );
    let status = stream.status();
    assert_eq!(status.groups.len(), 2, "{status:?}");
    let lossless = clear
        .iter()
        .filter(|frame| frame.payload.encoding == Encoding::PNG)
        .count();
    assert!(lossless >= 80, "{lossless} of {}: {status:?}", clear.len());
    assert!(fits.len() >= 40, "{}: {status:?}", fits.len());
    assert!(
        fits.iter()
            .all(|frame| frame.payload.encoding == Encoding::JPEG),
        "{status:?}"
    );
    assert!(
        status.groups[1]
            .level
            .is_some_and(|level| level != PICTURES[0]),
        "{status:?}"
    );
}
