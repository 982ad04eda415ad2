//! Implements the client side of the control socket: one request line, one reply line that begins with `ok` or `error`.

use std::{
    io::{self, BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

/// Sends one request and prints the text of the reply.
///
/// # Errors
/// Fails if no relay responds or if it reports an error.
pub fn send(control: &Path, request: &str) -> Result<(), io::Error> {
    let describe = |e: io::Error| {
        io::Error::new(
            e.kind(),
            format!("no relay responds at {}: {e}", control.display()),
        )
    };
    let mut socket = UnixStream::connect(control).map_err(describe)?;
    socket.set_read_timeout(Some(Duration::from_secs(10)))?;
    writeln!(socket, "{request}")?;
    let mut reply = String::new();
    BufReader::new(socket)
        .read_line(&mut reply)
        .map_err(describe)?;
    match reply
        .trim_end()
        .split_once(' ')
        .unwrap_or((reply.trim_end(), ""))
    {
        ("ok", "") => Ok(()),
        ("ok", text) => {
            println!("{text}");
            Ok(())
        }
        (_, "") => Err(io::Error::other(
            "the relay closed the connection without a reply",
        )),
        (_, text) => Err(io::Error::other(text.to_owned())),
    }
}
