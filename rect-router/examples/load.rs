//! Measures the throughput or the round-trip time between two clients of one router, for the benches.
//!
//! ```text
//! load throughput tcp/127.0.0.1:7447 8 2   # payload in bytes, duration in seconds
//! load ping       tcp/127.0.0.1:7447 8 2
//! ```
//! Both clients run in this process. The result is printed as one line of JSON.
use std::{
    error::Error,
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering::Relaxed},
        mpsc, Arc,
    },
    thread,
    time::{Duration, Instant},
};

use zenoh::{bytes::ZBytes, qos::CongestionControl, Config, Session, Wait};

type Outcome = Result<(), Box<dyn Error + Send + Sync>>;

const KEY: &str = "rect/bench/load";
const ANSWER: &str = "rect/bench/answer";
/// Time before the measurement in which routes are created and queues fill up.
const WARM_UP: Duration = Duration::from_millis(500);
/// Timeout for an answer.
const TIMEOUT: Duration = Duration::from_secs(10);

fn main() -> Outcome {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mode, router, bytes, seconds] = arguments.as_slice() else {
        return Err("usage: load throughput|ping ENDPOINT PAYLOAD_BYTES SECONDS".into());
    };
    let payload = ZBytes::from(vec![0_u8; bytes.parse()?]);
    let duration = Duration::from_secs_f64(seconds.parse()?);
    let (sender, receiver) = (client(router)?, client(router)?);
    match mode.as_str() {
        "throughput" => throughput(&sender, &receiver, payload, duration),
        "ping" => ping(&sender, &receiver, payload, duration),
        other => Err(format!("unknown mode {other}: give throughput or ping").into()),
    }
}

fn client(router: &str) -> zenoh::Result<Session> {
    let mut config = Config::default();
    config.insert_json5("mode", "\"client\"")?;
    config.insert_json5("connect/endpoints", &format!("[\"{router}\"]"))?;
    config.insert_json5("scouting/multicast/enabled", "false")?;
    zenoh::open(config).wait()
}

fn throughput(
    sender: &Session,
    receiver: &Session,
    payload: ZBytes,
    duration: Duration,
) -> Outcome {
    let received = Arc::new(AtomicU64::new(0));
    let counter = received.clone();
    let _subscriber = receiver
        .declare_subscriber(KEY)
        .callback(move |_| {
            counter.fetch_add(1, Relaxed);
        })
        .wait()?;
    let publisher = sender
        .declare_publisher(KEY)
        .congestion_control(CongestionControl::Block)
        .wait()?;
    let done = AtomicBool::new(false);
    let (count, took) = thread::scope(|scope| {
        let sending = scope.spawn(|| {
            while !done.load(Relaxed) {
                publisher.put(payload.clone()).wait()?;
            }
            zenoh::Result::Ok(())
        });
        thread::sleep(WARM_UP);
        let (before, start) = (received.load(Relaxed), Instant::now());
        thread::sleep(duration);
        let measured = (received.load(Relaxed) - before, start.elapsed());
        done.store(true, Relaxed);
        let sent = sending.join().map_err(|_| "the sending thread panicked")?;
        sent.map(|()| measured)
    })?;
    println!(
        "{{\"messages_per_s\":{:.0}}}",
        count as f64 / took.as_secs_f64()
    );
    Ok(())
}

fn ping(sender: &Session, receiver: &Session, payload: ZBytes, duration: Duration) -> Outcome {
    let back = receiver.declare_publisher(ANSWER).wait()?;
    let _echo = receiver
        .declare_subscriber(KEY)
        .callback(move |sample| {
            let _ = back.put(sample.payload().clone()).wait();
        })
        .wait()?;
    let (arrived, answers) = mpsc::channel();
    let _answer = sender
        .declare_subscriber(ANSWER)
        .callback(move |_| {
            let _ = arrived.send(());
        })
        .wait()?;
    let publisher = sender.declare_publisher(KEY).wait()?;
    // Repeat until the first answer, because subscriptions take a moment to reach the router.
    let start = Instant::now();
    while answers.recv_timeout(Duration::from_millis(100)).is_err() {
        if start.elapsed() > TIMEOUT {
            return Err("no answer through the router".into());
        }
        publisher.put(payload.clone()).wait()?;
    }
    let mut times_us = Vec::new();
    let start = Instant::now();
    while start.elapsed() < WARM_UP + duration {
        let sent = Instant::now();
        publisher.put(payload.clone()).wait()?;
        answers.recv_timeout(TIMEOUT)?;
        if start.elapsed() > WARM_UP {
            times_us.push(sent.elapsed().as_secs_f64() * 1e6);
        }
    }
    times_us.sort_by(f64::total_cmp);
    let at = |share: f64| times_us[((times_us.len() - 1) as f64 * share) as usize];
    println!("{{\"p50_us\":{:.1},\"p99_us\":{:.1}}}", at(0.5), at(0.99));
    Ok(())
}
