//! A program of a user that serves `grab` and `scan`, for `rect-py/tests/test_killed.py`, which kills it. It appends the value of
//! each request to a file before it works on it.
//!
//!     grabber ROUTER FILE PULSES PULSE_MS
//!
//! `scan` replies with `PULSES` numbers, one after each pulse of that duration; `grab` with its value after one pulse. The
//! program ends with its standard input.
use std::{
    fs::{File, OpenOptions},
    io::{self, Read, Write},
    thread,
    time::Duration,
};

use rect::{blocking::Robot, Request};

/// Appends the value of a request to a file, and returns it.
fn append(mut file: &File, request: &Request) -> Result<String, String> {
    let value = request.payload.text().map_err(|error| error.to_string())?;
    let written = file.write_all(format!("{value}\n").as_bytes());
    written.map_err(|error| error.to_string())?;
    Ok(value.to_owned())
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<_> = std::env::args().skip(1).collect();
    let [router, file, pulses, pulse] = arguments.as_slice() else {
        return Err("usage: grabber ROUTER FILE PULSES PULSE_MS".into());
    };
    let pulses: u32 = pulses.parse()?;
    let pulse = Duration::from_millis(pulse.parse()?);
    let options = rect::Options::new("wombat-1")?.router(router);
    let robot = Robot::connect(options.program("arm")?)?;
    let grabbed = OpenOptions::new().create(true).append(true).open(file)?;
    let scanned = grabbed.try_clone()?;
    let _grab = robot.serve("grab", move |request| {
        let value = append(&grabbed, request)?;
        thread::sleep(pulse);
        Ok::<_, String>(value)
    })?;
    let _scan = robot.serve("scan", move |request| {
        append(&scanned, request)?;
        for n in 1..pulses {
            thread::sleep(pulse);
            let sent = request.reply(n.to_string());
            sent.map_err(|error| error.to_string())?;
        }
        thread::sleep(pulse);
        Ok::<_, String>(pulses.to_string())
    })?;
    println!("serving");
    io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}
