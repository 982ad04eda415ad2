//! Runs the relay: one thread that polls the vhci devices, the connections to btvirt and the control socket.

use std::{
    collections::BTreeMap,
    fs::{File, OpenOptions},
    io::{self, BufRead, BufReader, ErrorKind, Read, Write},
    os::{
        fd::{AsFd, BorrowedFd},
        unix::net::{UnixListener, UnixStream},
    },
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use clap::Args;
use rustix::event::{poll, PollFd, PollFlags, Timespec};
use thiserror::Error;

use crate::{
    hci::{self, HciError},
    room::{Buffers, Id, Output, Room},
};

const VHCI: &str = "/dev/vhci";
/// Size of the read buffer: more than the largest packet that the kernel writes to vhci.
const READ_BYTES: usize = 4096;
/// Maximum number of packets that the kernel may send before it reports the index of a new device.
const EARLY_PACKETS: usize = 16;
/// Maximum time until a new emulated controller responds.
const WAKE_TIMEOUT: Duration = Duration::from_secs(30);
/// Maximum time for a client to send its request, and to read the reply.
const CONTROL_TIMEOUT: Duration = Duration::from_millis(500);
/// Maximum length of a request, in bytes.
const CONTROL_LINE_BYTES: u64 = 256;

#[derive(Args)]
pub struct Options {
    /// Path of btvirt's socket for LE controllers.
    #[arg(long, default_value = "/tmp/bt-server-le")]
    btvirt: PathBuf,
    /// Initial number of controllers.
    #[arg(long, default_value_t = 2)]
    controllers: u8,
    /// Rate limit of each controller, in ACL bytes per second; 0: no limit.
    #[arg(long, default_value_t = 0)]
    pace: u32,
    /// Number of ACL buffers that a controller reports to the kernel; 0: the value of btvirt.
    #[arg(long, default_value_t = 8)]
    buffers: u8,
    /// Size of an ACL buffer in bytes; 0: the value of btvirt.
    #[arg(long, default_value_t = 251)]
    acl_bytes: u16,
}

/// Errors that end the relay.
#[derive(Debug, Error)]
pub enum RelayError {
    #[error("cannot open {path}: {source}. Is the module hci_vhci loaded?")]
    Vhci {
        path: &'static str,
        source: io::Error,
    },
    #[error("btvirt does not respond at {path}: {source}. Was it started with -s?")]
    Btvirt { path: PathBuf, source: io::Error },
    #[error("cannot listen on {path}: {source}")]
    Control { path: PathBuf, source: io::Error },
    #[error("{name}: the kernel's side failed: {source}")]
    Host { name: String, source: io::Error },
    #[error("{name}: btvirt's side failed: {source}")]
    Controller { name: String, source: io::Error },
    #[error("{name}: btvirt sent something that is not HCI: {source}")]
    Hci { name: String, source: HciError },
    #[error("waiting for packets failed: {0}")]
    Poll(io::Error),
}

struct Device {
    name: String,
    vhci: File,
    btvirt: UnixStream,
    /// Received part of an incomplete packet of btvirt.
    pending: Vec<u8>,
}

struct Relay<'a> {
    options: &'a Options,
    room: Room,
    devices: BTreeMap<Id, Device>,
}

/// Runs the relay until it fails or is killed.
pub fn serve(options: &Options, control: &Path) -> Result<(), RelayError> {
    let room = Room::new(Buffers {
        count: options.buffers,
        acl_bytes: options.acl_bytes,
    });
    let mut relay = Relay {
        options,
        room,
        devices: BTreeMap::new(),
    };
    for _ in 0..options.controllers {
        relay.add()?;
    }
    let control_error = |source| RelayError::Control {
        path: control.to_owned(),
        source,
    };
    match std::fs::remove_file(control) {
        Err(e) if e.kind() != ErrorKind::NotFound => return Err(control_error(e)),
        _ => {}
    }
    let listener = UnixListener::bind(control).map_err(control_error)?;
    loop {
        relay.step(&listener)?;
    }
}

/// Waits until the emulated controller has responded once, before the kernel sends requests with a timeout of 2 s: a
/// busy machine may take longer than that to load btvirt's code and the ciphers it uses.
fn wake(btvirt: &UnixStream) -> io::Result<()> {
    btvirt.set_read_timeout(Some(WAKE_TIMEOUT))?;
    let mut socket = btvirt;
    socket.write_all(&hci::RESET)?;
    let mut answer = [0; hci::RESET_COMPLETE.len()];
    socket.read_exact(&mut answer)?;
    btvirt.set_read_timeout(None)?;
    if answer != hci::RESET_COMPLETE {
        return Err(io::Error::other(format!(
            "the response to HCI Reset is {answer:02x?}"
        )));
    }
    Ok(())
}

enum Ready {
    Control,
    Host(Id),
    Controller(Id),
}

impl Relay<'_> {
    /// Creates another controller and its kernel device. Returns its name.
    fn add(&mut self) -> Result<String, RelayError> {
        let connected = UnixStream::connect(&self.options.btvirt);
        self.plug(connected.map_err(|source| self.btvirt_error(source))?)
    }

    /// Replaces the kernel devices of two controllers in the opposite order. The controllers exchange their numbers if
    /// the kernel assigns the lowest free number. Returns the new names of `one` and `other`.
    fn swap(&mut self, one: Id, other: Id) -> Result<String, RelayError> {
        let mut unplug = |id| {
            self.room.remove(id);
            self.devices.remove(&id).map(|device| device.btvirt)
        };
        let (one, other) = (unplug(one), unplug(other));
        let mut names = Vec::new();
        for btvirt in [other, one].into_iter().flatten() {
            names.push(self.plug(btvirt)?);
        }
        names.reverse();
        Ok(names.join(" "))
    }

    fn btvirt_error(&self, source: io::Error) -> RelayError {
        RelayError::Btvirt {
            path: self.options.btvirt.clone(),
            source,
        }
    }

    /// Creates a kernel device for a controller. Returns its name.
    fn plug(&mut self, btvirt: UnixStream) -> Result<String, RelayError> {
        let vhci_error = |source| RelayError::Vhci { path: VHCI, source };
        wake(&btvirt).map_err(|source| self.btvirt_error(source))?;
        let vhci = OpenOptions::new()
            .read(true)
            .write(true)
            .open(VHCI)
            .map_err(vhci_error)?;
        (&vhci).write_all(&[hci::VENDOR, 0]).map_err(vhci_error)?;
        // The response contains the index of the device. The kernel's first commands may arrive before it.
        let mut early = Vec::new();
        let index = loop {
            let mut answer = vec![0; READ_BYTES];
            let n = (&vhci).read(&mut answer).map_err(vhci_error)?;
            answer.truncate(n);
            match *answer {
                [hci::VENDOR, _, low, high] => break u16::from_le_bytes([low, high]),
                _ if early.len() < EARLY_PACKETS => early.push(answer),
                _ => {
                    return Err(vhci_error(io::Error::other(
                        "the kernel did not report the index of the new device",
                    )))
                }
            }
        };
        let name = format!("hci{index}");
        println!("{name} was added");
        let id = self.room.add(self.options.pace);
        self.devices.insert(
            id,
            Device {
                name: name.clone(),
                vhci,
                btvirt,
                pending: Vec::new(),
            },
        );
        for packet in early {
            self.room.on_host_packet(id, packet, Instant::now());
        }
        self.flush()?;
        Ok(name)
    }

    fn step(&mut self, listener: &UnixListener) -> Result<(), RelayError> {
        for ready in self.wait(listener)? {
            match ready {
                Ready::Control => {
                    // A client that disconnects without a request, or before the reply, must not stop the relay.
                    if let Err(e) = self.answer(listener) {
                        eprintln!("request not answered: {e}");
                    }
                }
                Ready::Host(id) => self.read_host(id)?,
                Ready::Controller(id) => self.read_controller(id)?,
            }
            self.flush()?;
        }
        self.room.on_time(Instant::now());
        self.flush()
    }

    fn wait(&self, listener: &UnixListener) -> Result<Vec<Ready>, RelayError> {
        let mut sources: Vec<(Ready, BorrowedFd<'_>)> = vec![(Ready::Control, listener.as_fd())];
        for (id, device) in &self.devices {
            sources.push((Ready::Host(*id), device.vhci.as_fd()));
            sources.push((Ready::Controller(*id), device.btvirt.as_fd()));
        }
        let mut fds: Vec<PollFd<'_>> = sources
            .iter()
            .map(|(_, fd)| PollFd::from_borrowed_fd(*fd, PollFlags::IN))
            .collect();
        let timeout = self.room.deadline().map(|at| {
            let left = at.saturating_duration_since(Instant::now());
            Timespec {
                tv_sec: left.as_secs() as _,
                tv_nsec: left.subsec_nanos().into(),
            }
        });
        match poll(&mut fds, timeout.as_ref()) {
            Ok(_) => {}
            Err(rustix::io::Errno::INTR) => return Ok(Vec::new()),
            Err(e) => return Err(RelayError::Poll(e.into())),
        }
        let readable: Vec<bool> = fds.iter().map(|fd| !fd.revents().is_empty()).collect();
        Ok(sources
            .into_iter()
            .zip(readable)
            .filter_map(|((ready, _), is)| is.then_some(ready))
            .collect())
    }

    fn read_host(&mut self, id: Id) -> Result<(), RelayError> {
        let Some(device) = self.devices.get(&id) else {
            return Ok(());
        };
        let mut packet = vec![0; READ_BYTES];
        match (&device.vhci).read(&mut packet) {
            Ok(0) => {}
            Ok(n) => {
                packet.truncate(n);
                self.room.on_host_packet(id, packet, Instant::now());
            }
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(source) => {
                return Err(RelayError::Host {
                    name: device.name.clone(),
                    source,
                })
            }
        }
        Ok(())
    }

    fn read_controller(&mut self, id: Id) -> Result<(), RelayError> {
        let Some(device) = self.devices.get_mut(&id) else {
            return Ok(());
        };
        let failed = |name: &str, source| {
            Err(RelayError::Controller {
                name: name.to_owned(),
                source,
            })
        };
        let mut bytes = [0; READ_BYTES];
        match device.btvirt.read(&mut bytes) {
            Ok(0) => {
                return failed(
                    &device.name,
                    io::Error::new(ErrorKind::UnexpectedEof, "btvirt closed the connection"),
                )
            }
            Ok(n) => device.pending.extend_from_slice(&bytes[..n]),
            Err(e) if e.kind() == ErrorKind::Interrupted => return Ok(()),
            Err(e) => return failed(&device.name, e),
        }
        let not_hci = |name: &str, source| RelayError::Hci {
            name: name.to_owned(),
            source,
        };
        while let Some(n) =
            hci::packet_bytes(&device.pending).map_err(|e| not_hci(&device.name, e))?
        {
            if device.pending.len() < n {
                break;
            }
            let packet: Vec<u8> = device.pending.drain(..n).collect();
            self.room.on_controller_packet(id, packet, Instant::now());
        }
        Ok(())
    }

    fn flush(&mut self) -> Result<(), RelayError> {
        while let Some(output) = self.room.poll_output() {
            match output {
                Output::Host(id, packet) => {
                    let Some(device) = self.devices.get(&id) else {
                        continue;
                    };
                    // The kernel refuses packets while the device is down; they are lost, as on a real radio.
                    match (&device.vhci).write_all(&packet) {
                        Err(e)
                            if rustix::io::Errno::from_io_error(&e)
                                != Some(rustix::io::Errno::NXIO) =>
                        {
                            return Err(RelayError::Host {
                                name: device.name.clone(),
                                source: e,
                            });
                        }
                        _ => {}
                    }
                }
                Output::Controller(id, packet) => {
                    let Some(device) = self.devices.get_mut(&id) else {
                        continue;
                    };
                    let written = device.btvirt.write_all(&packet);
                    written.map_err(|source| RelayError::Controller {
                        name: device.name.clone(),
                        source,
                    })?;
                }
            }
        }
        Ok(())
    }

    fn answer(&mut self, listener: &UnixListener) -> io::Result<()> {
        let (socket, _) = listener.accept()?;
        socket.set_read_timeout(Some(CONTROL_TIMEOUT))?;
        socket.set_write_timeout(Some(CONTROL_TIMEOUT))?;
        let mut line = String::new();
        BufReader::new(&socket)
            .take(CONTROL_LINE_BYTES)
            .read_line(&mut line)?;
        match self.request(line.trim()) {
            Ok(text) => writeln!(&socket, "ok {text}"),
            Err(text) => writeln!(&socket, "error {text}"),
        }
    }

    fn request(&mut self, line: &str) -> Result<String, String> {
        println!("request: {line}");
        let words: Vec<&str> = line.split_whitespace().collect();
        let id_of = |name: &str| {
            let found = self.devices.iter().find(|(_, device)| device.name == name);
            found
                .map(|(id, _)| *id)
                .ok_or_else(|| format!("there is no controller {name}"))
        };
        match *words.as_slice() {
            ["add"] => return self.add().map_err(|e| e.to_string()),
            ["list"] => {
                let lines = self
                    .devices
                    .iter()
                    .map(|(id, d)| format!("{}: {}", d.name, self.room.describe(*id)));
                return Ok(lines.collect::<Vec<_>>().join("; "));
            }
            ["remove", name] => {
                let id = id_of(name)?;
                self.room.remove(id);
                self.devices.remove(&id);
            }
            ["swap", one, other] => {
                let (one, other) = (id_of(one)?, id_of(other)?);
                return self.swap(one, other).map_err(|e| e.to_string());
            }
            ["freeze", name] => self.room.freeze(id_of(name)?),
            ["thaw", name] => self.room.thaw(id_of(name)?, Instant::now()),
            ["drop", name] => {
                let id = id_of(name)?;
                return Ok(format!("{} links dropped", self.room.drop_links(id)));
            }
            ["pace", name, rate] => {
                let rate = rate
                    .parse()
                    .map_err(|_| format!("bytes per second is a whole number, not {rate}"))?;
                self.room.set_pace(id_of(name)?, rate, Instant::now());
            }
            _ => {
                return Err(format!(
                "unknown request \"{line}\"; known: add, remove, swap, list, freeze, thaw, drop, pace"
            ))
            }
        }
        Ok(String::new())
    }
}
