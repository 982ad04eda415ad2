//! Takes part in the stop of a fleet.
use std::{ffi::c_char, mem::MaybeUninit, sync::Arc};

use rect::Name;
use tokio::sync::Mutex;

use crate::{
    argument::{text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut},
    cancellable::{Cancellable, Waitable},
    failure::{Code, Failure},
    handle::{self, Object},
    robot::RobotHandle,
    text::Text,
};

/// The stop of the fleet. While a program has one, its robot takes part: it remembers stops, passes them on, and confirms them.
/// `rect_drop(&stop.id, ..)` ends that for this program.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct FleetStop {
    /// The handle.
    pub id: u64,
}

/// A stop that nobody has released.
#[repr(C)]
pub struct Stop {
    /// The program that pressed it: `<robot>/<program>`.
    pub by: Text,
    /// Why, in that program's words; empty if it did not say.
    pub reason: Text,
    /// The stop in words: `stopped by laptop/page: smoke`.
    pub in_words: Text,
    /// When, in milliseconds since 1970 by the clock of that robot.
    pub at_ms: u64,
}

/// The stops that nobody has released. Release it with `rect_drop(&stops.id, ..)`.
#[repr(C)]
pub struct Stops {
    /// The handle.
    pub id: u64,
    /// The first stop.
    pub items: *const Stop,
    /// Number of stops.
    pub len: usize,
}

/// How far a robot has followed the stop or its release.
#[repr(C)]
pub enum Confirmation {
    /// None of its programs takes part, or it is not reachable.
    None = 0,
    /// It knows all stops and releases that this program knows.
    Confirmed = 1,
    /// Its program takes part, and has not confirmed.
    Waiting = 2,
    /// The program of the robot that took part has ended.
    Ended = 3,
}

struct Participation {
    stop: rect::FleetStop,
    changes: Mutex<rect::StopChanges>,
    /// They end with the session.
    events: rect::Events,
}

impl Waitable for Participation {
    const KIND: &'static str = "stop of the fleet";
}

impl Participation {
    async fn next(&self) -> Option<()> {
        let mut changes = self.changes.lock().await;
        loop {
            tokio::select! {
                changed = changes.next() => return changed,
                event = self.events.next() => drop(event?),
            }
        }
    }
}

struct OwnedStops {
    _stops: Vec<(rect::Stop, String)>,
    _views: Vec<Stop>,
}

// SAFETY: the views point into the stops stored next to them, which never change.
unsafe impl Send for OwnedStops {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedStops {}

impl Object for OwnedStops {
    const KIND: &'static str = "list of stops";
}

fn resolve(stop: FleetStop) -> Result<Arc<Cancellable<Participation>>, Failure> {
    handle::get(stop.id)
}

/// Takes part in the stop of the fleet, and writes the handle to `stop`: with it, this program stops all robots that take part, learns of
/// a stop, and confirms it.
///
/// A stop holds until somebody releases it. The robots remember it, on their disks as well, and pass it on: one that was out of reach
/// learns of it when it returns, and a program that starts again before this function returns. The motors are up to the program:
/// `rect_robot_deadman` handles stops, and nothing moves at the release.
///
/// May be called on any thread. Several handles of one program are the same stop.
#[no_mangle]
pub extern "C" fn rect_robot_fleet_stop(
    robot: RobotHandle,
    stop: Option<&mut MaybeUninit<FleetStop>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("stop", &stop)?;
        let program = robot.resolve()?;
        let taking_part = program.wait(program.robot.fleet_stop())?;
        let participation = Participation {
            changes: Mutex::new(taking_part.changes()),
            events: program.wait(program.robot.events())?,
            stop: taking_part,
        };
        let id = handle::insert(Cancellable::new(participation, &program));
        write_out("stop", stop, FleetStop { id })
    })
}

/// Stops the fleet, until somebody releases it. `reason`: why, in a few words, for people; may be NULL. Returns when the router of this
/// robot has the stop; `rect_fleet_stop_confirmation` says which robots have it.
///
/// Returns `RECT_CODE_NOT_RETAINED` if no router keeps it: only robots that are reachable now get it. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_fleet_stop_press(
    stop: FleetStop,
    reason: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let reason = unsafe { text_or_none("reason", reason) }?.unwrap_or_default();
        resolve(stop)?.wait(|own| own.stop.press(reason))
    })
}

/// Releases all stops that this robot knows. Nothing moves yet: `rect_robot_deadman` waits for a neutral command. Nothing happens if there
/// is none. Returns the codes of `rect_fleet_stop_press`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_fleet_stop_release(
    stop: FleetStop,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || resolve(stop)?.wait(|own| own.stop.release()))
}

/// Writes to `is_stopped` whether the fleet is stopped. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_fleet_stop_is_stopped(
    stop: FleetStop,
    is_stopped: Option<&mut MaybeUninit<bool>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let known = resolve(stop)?.source().stop.is_stopped();
        write_out("is_stopped", is_stopped, known)
    })
}

/// Writes the stops that nobody has released to `stops`, the latest first. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_fleet_stop_pressed(
    stop: FleetStop,
    stops: Option<&mut MaybeUninit<Stops>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("stops", &stops)?;
        let pressed = resolve(stop)?.source().stop.pressed();
        write_out("stops", stops, into_c(pressed))
    })
}

fn into_c(pressed: Vec<rect::Stop>) -> Stops {
    let with_words = pressed.into_iter().map(|stop| {
        let in_words = stop.in_words();
        (stop, in_words)
    });
    let stops: Vec<_> = with_words.collect();
    let views = stops.iter().map(|(stop, in_words)| Stop {
        by: Text::of(&stop.by),
        reason: Text::of(&stop.reason),
        in_words: Text::of(in_words),
        at_ms: stop.at_ms,
    });
    let views: Vec<_> = views.collect();
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedStops {
        _stops: stops,
        _views: views,
    });
    Stops { id, items, len }
}

/// Writes to `confirmation` whether the robot `name` has confirmed the stop, or its release: a `rect_confirmation`.
///
/// Returns `RECT_CODE_NAME` if the name is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_fleet_stop_confirmation(
    stop: FleetStop,
    name: *const c_char,
    confirmation: Option<&mut MaybeUninit<u32>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let name = Name::new(unsafe { text("name", name) }?)?;
        let confirmed = match resolve(stop)?.source().stop.confirmation(&name) {
            None => Confirmation::None,
            Some(rect::Confirmation::Confirmed) => Confirmation::Confirmed,
            Some(rect::Confirmation::Waiting) => Confirmation::Waiting,
            Some(rect::Confirmation::Ended) => Confirmation::Ended,
        };
        write_out("confirmation", confirmation, confirmed as u32)
    })
}

/// Waits for a stop, a release or a confirmation that was not known when this was called last, or when the handle was created. Several are
/// reported as one.
///
/// Returns `RECT_CODE_TIMED_OUT` if there is none within `timeout_ms` (`RECT_FOREVER` waits without a limit), and `RECT_CODE_CLOSED` if the
/// session was closed or another thread dropped the handle. May be called on any thread; if several threads wait, one of them continues.
#[no_mangle]
pub extern "C" fn rect_fleet_stop_wait_for_change(
    stop: FleetStop,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let waiting = resolve(stop)?;
        waiting.next("change", timeout_ms, Participation::next)
    })
}
