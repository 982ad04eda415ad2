//! Owns a program's first words: joining, as whom, saying something, hearing the next message, leaving.
use std::{
    ffi::{c_char, CStr},
    mem::MaybeUninit,
    time::Duration,
};

use rect::core::codec;

use crate::{
    argument::{text, there},
    boundary::{buffer, call, give, wanted, ErrorOut},
    dictionary::{self, Dictionary},
    failure::{Code, Failure},
    handle,
    message::{self, Message},
    options::{self, Options},
    payload::PayloadView,
    program::Program,
    text::{choice, hold_names, Names},
};

/// A program of a robot, joined with the others. `rect_drop(&robot.id, ..)` when it is not needed any more: the session ends
/// with the last handle of it and of what was made by it, or with `rect_robot_close`.
///
/// All functions that take one may be called by several threads at a time.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Robot {
    /// Its handle.
    pub id: u64,
}

/// How urgently a robot speaks; more urgent messages overtake others in every queue and on the Bluetooth link.
#[repr(C)]
pub enum Urgency {
    /// In no hurry.
    Bulk = 0,
    /// As usual.
    Normal = 1,
    /// Before everything else.
    Urgent = 2,
}

/// By C's numbers.
pub const URGENCIES: [(u32, rect::Urgency); 3] = [
    (Urgency::Bulk as u32, rect::Urgency::Bulk),
    (Urgency::Normal as u32, rect::Urgency::Normal),
    (Urgency::Urgent as u32, rect::Urgency::Urgent),
];

/// The longest name of a robot, with the zero byte at its end.
pub const NAME_BYTES: usize = 30;

/// What a program has said and heard, since it joined.
#[repr(C)]
pub struct Counters {
    /// Messages said, answers and requests not counted.
    pub sent: u64,
    /// Their payloads, in bytes, as they were sent.
    pub sent_bytes: u64,
    /// Messages heard, each subscription's.
    pub received: u64,
    /// Their payloads, in bytes, as they came.
    pub received_bytes: u64,
    /// Messages that did not arrive, by their numbers.
    pub missed: u64,
    /// Messages of other Zenoh programs that were dropped because RECT does not allow their topic (control characters, more
    /// than 200 bytes, reserved parts).
    pub rejected: u64,
}

impl Robot {
    /// What the handle is of.
    pub fn live(self) -> Result<std::sync::Arc<Program>, Failure> {
        handle::get(self.id)
    }

    fn of(program: Program) -> Self {
        let id = handle::insert(program);
        Self { id }
    }
}

/// The version of the library, as `0.1.0`.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(version) => version,
            Err(_) => c"",
        };
    VERSION.as_ptr()
}

/// Joins as a program of the robot `name`. `options`: NULL for the router of this computer.
///
/// Thread: any. Waits until the router answers, at most `options.patience_ms`.
#[no_mangle]
pub unsafe extern "C" fn rect_connect(
    name: *const c_char,
    options: Option<&Options>,
    robot: Option<&mut MaybeUninit<Robot>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("robot", &robot)?;
        // SAFETY: as rect.h asks.
        let options = unsafe { options::read(text("name", name)?, options) }?;
        give("robot", robot, Robot::of(Program::join(options)?))
    })
}

/// The same robot, speaking with an urgency (`rect_urgency`): a handle of its own, which shares the session.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_robot_with(
    robot: Robot,
    urgency: u32,
    same: Option<&mut MaybeUninit<Robot>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("same", &same)?;
        let (program, urgency) = (robot.live()?, choice("urgency", &URGENCIES, urgency)?);
        let other = program.of(program.robot.with(urgency));
        give("same", same, Robot::of(other))
    })
}

/// The same robot; what it says goes through a codec: `zstd:9`, `jpeg:60`, `webp:60`, `png`, `quantised:0.01`. A handle of its
/// own, which shares the session.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_encoded(
    robot: Robot,
    codec: *const c_char,
    same: Option<&mut MaybeUninit<Robot>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("same", &same)?;
        // SAFETY: as rect.h asks.
        let codec = unsafe { text("codec", codec) }?;
        let program = robot.live()?;
        let other = program.of(program.robot.encoded(codec::parse(codec)?));
        give("same", same, Robot::of(other))
    })
}

/// The same robot; what it says is packed with that dictionary, which small JSON needs to get much smaller. Whoever hears it
/// fetches the dictionary once. A handle of its own, which shares the session.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_robot_packed_with(
    robot: Robot,
    dictionary: Dictionary,
    same: Option<&mut MaybeUninit<Robot>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("same", &same)?;
        let (program, dictionary) = (robot.live()?, dictionary::live(dictionary)?);
        let other = program.of(program.robot.packed_with(dictionary)?);
        give("same", same, Robot::of(other))
    })
}

/// Writes the robot's name to `name`, which has room for RECT_NAME_BYTES, with a zero byte at its end.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_robot_name(
    robot: Robot,
    name: Option<&mut MaybeUninit<[c_char; NAME_BYTES]>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // There is room: names have at most 29 bytes.
        give("name", name, buffer(robot.live()?.robot.name().as_str()))
    })
}

/// Says it to all.
///
/// Thread: any. Waits for room where a large payload finds none.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_publish(
    robot: Robot,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let (topic, payload) =
            unsafe { (text("topic", topic)?, there("payload", payload)?.read()?) };
        let program = robot.live()?;
        program.complete(program.robot.publish(topic, payload))
    })
}

/// Says it to one robot alone. Nobody is asked whether it is there: `rect_robot_request` does that.
///
/// Thread: any. Waits for room where a large payload finds none.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_send(
    robot: Robot,
    to: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: as rect.h asks.
        let (to, topic, payload) = unsafe {
            (
                text("to", to)?,
                text("topic", topic)?,
                there("payload", payload)?.read()?,
            )
        };
        let program = robot.live()?;
        program.complete(program.robot.send(to, topic, payload))
    })
}

/// The next message of the robot `from` about `topic`, to all or to this one alone, that is sent from now on;
/// RECT_CODE_TIMED_OUT: there was none.
///
/// Thread: any.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_listen(
    robot: Robot,
    from: *const c_char,
    topic: *const c_char,
    timeout_ms: u32,
    message: Option<&mut MaybeUninit<Message>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("message", &message)?;
        // SAFETY: as rect.h asks.
        let (from, topic) = unsafe { (text("from", from)?, text("topic", topic)?) };
        let (program, timeout) = (robot.live()?, Duration::from_millis(timeout_ms.into()));
        let heard = program.wait(program.robot.listen(from, topic, timeout))?;
        give("message", message, message::hold(heard))
    })
}

/// The other robots of the fleet that are there now, by name.
///
/// Thread: any. Waits for the router's answer.
#[no_mangle]
pub extern "C" fn rect_robot_peers(
    robot: Robot,
    names: Option<&mut MaybeUninit<Names>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        wanted("names", &names)?;
        let program = robot.live()?;
        let peers = program.wait(program.robot.peers())?;
        give("names", names, hold_names(peers))
    })
}

/// What this program has said and heard.
///
/// Thread: any.
#[no_mangle]
pub extern "C" fn rect_robot_counters(
    robot: Robot,
    counters: Option<&mut MaybeUninit<Counters>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let counted = robot.live()?.robot.counters();
        let rect::Counters {
            sent,
            sent_bytes,
            received,
            received_bytes,
            missed,
            rejected,
        } = counted;
        let counted = Counters {
            sent,
            sent_bytes,
            received,
            received_bytes,
            missed,
            rejected,
        };
        give("counters", counters, counted)
    })
}

/// Ends the session now, and all that belongs to it, whoever has handles of it. They are dropped as before.
///
/// Thread: any, in callbacks too.
#[no_mangle]
pub extern "C" fn rect_robot_close(
    robot: Robot,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let program = robot.live()?;
        program.wait(program.robot.close())
    })
}
