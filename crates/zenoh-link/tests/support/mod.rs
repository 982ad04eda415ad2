//! Provides the resources of the protocol tests: certificates, a serial cable, free ports.

use std::{
    fs::{self, File},
    io::{Read, Write},
    net::{TcpListener, UdpSocket},
    path::{Path, PathBuf},
    thread,
};

use nix::{
    pty::{openpty, OpenptyResult},
    sys::{
        socket::{bind, listen, socket, AddressFamily, Backlog, SockFlag, SockType, VsockAddr},
        termios::{cfmakeraw, tcgetattr, tcsetattr, SetArg},
    },
    unistd::ttyname,
};
use rcgen::{BasicConstraints, CertificateParams, IsCa, Issuer, KeyPair};

/// Files of a certificate authority and of a server `localhost` with a certificate of it.
pub struct Certificates {
    dir: tempfile::TempDir,
}

impl Certificates {
    pub fn new() -> Self {
        let dir = tempfile::tempdir().expect("a directory");
        let mut authority = CertificateParams::new(vec![]).expect("parameters");
        authority.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let authority_key = KeyPair::generate().expect("a key");
        let authority_certificate = authority
            .self_signed(&authority_key)
            .expect("a certificate");
        let issuer = Issuer::from_params(&authority, &authority_key);

        let server_key = KeyPair::generate().expect("a key");
        let server = CertificateParams::new(vec!["localhost".to_owned()])
            .expect("parameters")
            .signed_by(&server_key, &issuer)
            .expect("a certificate");

        let write =
            |name: &str, text: String| fs::write(dir.path().join(name), text).expect("written");
        write("authority.pem", authority_certificate.pem());
        write("server.pem", server.pem());
        write("server.key", server_key.serialize_pem());
        Self { dir }
    }

    /// Returns the section `transport/link/tls` of a config that listens or connects with these certificates.
    pub fn settings(&self) -> String {
        let path = |name: &str| self.dir.path().join(name).display().to_string();
        format!(
            "{{ root_ca_certificate: '{}', listen_certificate: '{}', listen_private_key: '{}' }}",
            path("authority.pem"),
            path("server.pem"),
            path("server.key")
        )
    }
}

/// Two serial ports with a cable between them.
pub struct SerialCable {
    pub ends: [PathBuf; 2],
    // Kept open: a port disappears when it is closed.
    _ports: [std::os::fd::OwnedFd; 2],
}

impl SerialCable {
    pub fn new() -> Self {
        let (one, two) = (raw_pty(), raw_pty());
        let name = |pty: &OpenptyResult| ttyname(&pty.slave).expect("a terminal has a name");
        let ends = [name(&one), name(&two)];
        let (one_master, two_master) = (File::from(one.master), File::from(two.master));
        carry(
            one_master.try_clone().expect("a handle"),
            two_master.try_clone().expect("a handle"),
        );
        carry(two_master, one_master);
        Self {
            ends,
            _ports: [one.slave, two.slave],
        }
    }
}

fn raw_pty() -> OpenptyResult {
    let pty = openpty(None, None).expect("a pseudo-terminal");
    let mut terminal = tcgetattr(&pty.slave).expect("a terminal");
    cfmakeraw(&mut terminal);
    tcsetattr(&pty.slave, SetArg::TCSANOW, &terminal).expect("a raw terminal");
    pty
}

fn carry(mut from: File, mut to: File) {
    thread::spawn(move || {
        let mut bytes = [0; 4096];
        while let Ok(n @ 1..) = from.read(&mut bytes) {
            if to.write_all(&bytes[..n]).is_err() {
                return;
            }
        }
    });
}

pub fn free_tcp_port() -> u16 {
    TcpListener::bind("127.0.0.1:0")
        .and_then(|s| s.local_addr())
        .expect("a port")
        .port()
}

pub fn free_udp_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0")
        .and_then(|s| s.local_addr())
        .expect("a port")
        .port()
}

pub fn path_in(dir: &Path, name: &str) -> String {
    dir.join(name).display().to_string()
}

/// Returns why vsock loopback is not available on this machine; `None` if it is.
pub fn no_vsock_loopback() -> Option<String> {
    let opened = socket(
        AddressFamily::Vsock,
        SockType::Stream,
        SockFlag::empty(),
        None,
    );
    let listening = opened.and_then(|socket| {
        bind(
            std::os::fd::AsRawFd::as_raw_fd(&socket),
            &VsockAddr::new(LOCAL_CID, ANY_PORT),
        )?;
        listen(&socket, Backlog::new(1)?)
    });
    listening
        .err()
        .map(|error| format!("the kernel has no vsock loopback ({error}); modprobe vsock_loopback"))
}

const LOCAL_CID: u32 = 1;
const ANY_PORT: u32 = u32::MAX;
