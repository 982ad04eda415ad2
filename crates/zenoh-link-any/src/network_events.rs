//! Reports that a network interface has come up or gone down, or that its addresses have changed.
use std::{io, time::Duration};

/// How long an event waits for others: a change of the network is reported as several.
const GATHERING: Duration = Duration::from_millis(50);

/// The kernel's notifications.
pub(crate) struct NetworkEvents {
    #[cfg(target_os = "linux")]
    socket: tokio::io::unix::AsyncFd<netlink_sys::Socket>,
}

#[cfg(target_os = "linux")]
impl NetworkEvents {
    /// Opens the socket of the notifications. Must be called in a runtime.
    pub(crate) fn open() -> io::Result<Self> {
        use netlink_sys::{protocols::NETLINK_ROUTE, Socket, SocketAddr};
        use tokio::io::unix::AsyncFd;
        let groups = libc::RTMGRP_LINK | libc::RTMGRP_IPV4_IFADDR | libc::RTMGRP_IPV6_IFADDR;
        let mut socket = Socket::new(NETLINK_ROUTE)?;
        socket.set_non_blocking(true)?;
        socket.bind(&SocketAddr::new(0, groups as u32))?;
        let interest = tokio::io::Interest::READABLE;
        // SAFETY: the socket owns its descriptor and keeps the same one for as long as it lives.
        let socket = unsafe { AsyncFd::register_with_interest(socket, interest) }?;
        Ok(Self { socket })
    }

    /// Waits for the next change. The content of the notifications is not used: their receiver looks at the interfaces.
    pub(crate) async fn next(&self) -> io::Result<()> {
        self.socket.readable().await?.retain_ready();
        tokio::time::sleep(GATHERING).await;
        loop {
            let mut event = self.socket.readable().await?;
            let mut buffer = [0; 4096];
            let read = event.try_io(|socket| socket.get_ref().recv(&mut &mut buffer[..], 0));
            match read {
                Err(_none_left) => return Ok(()),
                // The kernel has dropped notifications, which are not needed.
                Ok(Err(error)) if error.raw_os_error() == Some(libc::ENOBUFS) => {}
                Ok(read) => drop(read?),
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
impl NetworkEvents {
    pub(crate) fn open() -> io::Result<Self> {
        Err(io::ErrorKind::Unsupported.into())
    }

    pub(crate) async fn next(&self) -> io::Result<()> {
        tokio::time::sleep(GATHERING).await;
        Err(io::ErrorKind::Unsupported.into())
    }
}
