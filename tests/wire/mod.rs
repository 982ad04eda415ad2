//! Simulates a link between two programs: a TCP relay with a limited rate that can be cut and counts its bytes.
#![allow(dead_code)] // each test file uses a part of this module

use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        Arc, Mutex,
    },
    thread,
    time::{Duration, Instant},
};

/// A relay that forwards TCP connections to another address. Its threads end with the process.
pub struct Wire {
    /// The endpoint to dial.
    pub endpoint: String,
    shared: Arc<Shared>,
}

#[derive(Default)]
struct Shared {
    carried: AtomicU64,
    is_cut: AtomicBool,
    streams: Mutex<Vec<TcpStream>>,
    rate_bytes_per_s: f64,
}

impl Wire {
    /// Creates a wire to the listener at `target`, with the given rate in each direction.
    pub fn to(target: &str, rate_bytes_per_s: f64) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
        let endpoint = format!("tcp/{}", listener.local_addr().expect("bound"));
        let target = target.trim_start_matches("tcp/").to_owned();
        let shared = Arc::new(Shared {
            rate_bytes_per_s,
            ..Shared::default()
        });
        let this = shared.clone();
        thread::spawn(move || {
            for near in listener.incoming().map_while(Result::ok) {
                let far = TcpStream::connect(&target);
                if let (false, Ok(far)) = (this.is_cut.load(Ordering::SeqCst), far) {
                    this.carry(near, far);
                }
            }
        });
        Self { endpoint, shared }
    }

    /// Returns the number of bytes that were relayed so far, in both directions together.
    pub fn carried(&self) -> u64 {
        self.shared.carried.load(Ordering::SeqCst)
    }

    /// Closes all connections, and refuses new ones for `time`.
    pub async fn cut(&self, time: Duration) {
        self.shared.is_cut.store(true, Ordering::SeqCst);
        for stream in self.shared.streams.lock().expect("not poisoned").drain(..) {
            let _ = stream.shutdown(Shutdown::Both);
        }
        tokio::time::sleep(time).await;
        self.shared.is_cut.store(false, Ordering::SeqCst);
    }
}

impl Shared {
    fn carry(self: &Arc<Self>, near: TcpStream, far: TcpStream) {
        let clone = |stream: &TcpStream| stream.try_clone().expect("a stream");
        let mut streams = self.streams.lock().expect("not poisoned");
        streams.extend([clone(&near), clone(&far)]);
        for (from, to) in [(clone(&near), clone(&far)), (far, near)] {
            let this = self.clone();
            thread::spawn(move || this.pump(from, to));
        }
    }

    fn pump(&self, mut from: TcpStream, mut to: TcpStream) {
        // Small pieces keep the delay in this relay short. The buffers of the kernel increase it.
        let mut buffer = vec![0; ((self.rate_bytes_per_s / 200.0) as usize).clamp(128, 65536)];
        let mut free_at = Instant::now();
        while let Ok(read @ 1..) = from.read(&mut buffer) {
            let takes = Duration::from_secs_f64(read as f64 / self.rate_bytes_per_s);
            free_at = free_at.max(Instant::now()) + takes;
            thread::sleep(free_at.saturating_duration_since(Instant::now()));
            if to.write_all(&buffer[..read]).is_err() {
                break;
            }
            self.carried.fetch_add(read as u64, Ordering::SeqCst);
        }
        let _ = (from.shutdown(Shutdown::Both), to.shutdown(Shutdown::Both));
    }
}
