//! Simulates a link between two programs: a TCP relay with a limited rate that can be cut and counts its bytes.
#![allow(dead_code)] // each test file uses a part of this module

use std::{
    io::{Read, Write},
    net::{Shutdown, TcpListener, TcpStream},
    sync::{
        atomic::{AtomicBool, AtomicU64, Ordering},
        Arc, Mutex, MutexGuard, Weak,
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
    connections: Mutex<Vec<Weak<Connection>>>,
    rate_bytes_per_s: f64,
}

/// A relayed connection. It is closed when both of its threads have ended, so that no program waits until what it has sent is
/// read.
struct Connection {
    near: TcpStream,
    far: TcpStream,
}

impl Connection {
    fn shut_down(&self) {
        let _ = self.near.shutdown(Shutdown::Both);
        let _ = self.far.shutdown(Shutdown::Both);
    }
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
                    this.carry(Connection { near, far });
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
        let connections = std::mem::take(&mut *self.shared.connections());
        for connection in connections.iter().filter_map(Weak::upgrade) {
            connection.shut_down();
        }
        tokio::time::sleep(time).await;
        self.shared.is_cut.store(false, Ordering::SeqCst);
    }
}

impl Shared {
    fn connections(&self) -> MutexGuard<'_, Vec<Weak<Connection>>> {
        self.connections.lock().expect("not poisoned")
    }

    fn carry(self: &Arc<Self>, connection: Connection) {
        let connection = Arc::new(connection);
        self.connections().push(Arc::downgrade(&connection));
        for is_forward in [true, false] {
            let (this, connection) = (self.clone(), connection.clone());
            thread::spawn(move || {
                let Connection { near, far } = &*connection;
                match is_forward {
                    true => this.pump(near, far),
                    false => this.pump(far, near),
                }
                connection.shut_down();
            });
        }
    }

    fn pump(&self, mut from: &TcpStream, mut to: &TcpStream) {
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
    }
}
