//! The asking side of the control socket: one request line, one answer line that begins with `ok` or `error`.

use std::{
    io::{self, BufRead, BufReader, Write},
    os::unix::net::UnixStream,
    path::Path,
    time::Duration,
};

/// Sends one request and prints the answer's text.
pub fn send(control: &Path, request: &str) -> Result<(), io::Error> {
    let describe = |e: io::Error| {
        io::Error::new(
            e.kind(),
            format!("no relay answers at {}: {e}", control.display()),
        )
    };
    let mut socket = UnixStream::connect(control).map_err(describe)?;
    socket.set_read_timeout(Some(Duration::from_secs(10)))?;
    writeln!(socket, "{request}")?;
    let mut answer = String::new();
    BufReader::new(socket)
        .read_line(&mut answer)
        .map_err(describe)?;
    match answer
        .trim_end()
        .split_once(' ')
        .unwrap_or((answer.trim_end(), ""))
    {
        ("ok", "") => Ok(()),
        ("ok", text) => {
            println!("{text}");
            Ok(())
        }
        (_, "") => Err(io::Error::other(
            "the relay closed the connection without an answer",
        )),
        (_, text) => Err(io::Error::other(text.to_owned())),
    }
}
