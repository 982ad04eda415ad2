//! Connects to the router as a program of a robot; publishes, sends, and waits for single messages.
use std::{
    ffi::{c_char, CStr},
    mem::MaybeUninit,
    time::Duration,
};

use rect::{Name, Topic};
use rect_core::codec;

use crate::{
    argument::{require, text},
    boundary::{buffer, call, require_out, write_out, ErrorOut},
    cancellable::timeout,
    dictionary::{self, Dictionary},
    failure::{Code, Failure},
    handle,
    message::{self, Message},
    options::{self, Options},
    payload::PayloadView,
    program::Program,
    text::{choice, names_into_c, Names},
    urgency::URGENCIES,
};

/// A handle of a program's session, through which it communicates as one robot of the fleet. Release it with
/// `rect_drop(&robot.id, ..)`.
///
/// The session ends when the last handle of the robot and of everything that was created with it is dropped, or with
/// `rect_robot_close`. Every function that takes a robot may be called by several threads at a time.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct RobotHandle {
    /// The handle.
    pub id: u64,
}

/// Size of the name of a robot or fleet, including the terminating zero byte.
pub const NAME_BYTES: usize = 30;

/// Counts of the messages of a program since it connected.
#[repr(C)]
pub struct Counters {
    /// Number of messages published and sent. Requests and replies are not counted.
    pub sent: u64,
    /// Size of their payloads in bytes, as they were encoded for sending.
    pub sent_bytes: u64,
    /// Number of messages received, counted once for each subscription.
    pub received: u64,
    /// Size of their payloads in bytes, as they arrived.
    pub received_bytes: u64,
    /// Number of messages that did not arrive, according to their sequence numbers.
    pub missed: u64,
    /// Number of messages that had expired on arrival, before the program has read them, or before they could be sent.
    pub expired: u64,
    /// Number of messages from stock Zenoh programs that were dropped because RECT does not permit their topic: it contains
    /// control characters, is longer than 200 bytes, or is reserved.
    pub rejected: u64,
    /// Number of messages and requests whose value does not fit the type that the program states.
    pub problems: u64,
}

impl RobotHandle {
    /// Returns the program behind the handle.
    pub fn resolve(self) -> Result<std::sync::Arc<Program>, Failure> {
        handle::get(self.id)
    }

    /// Returns a handle of the program.
    pub fn of(program: Program) -> Self {
        let id = handle::insert(program);
        Self { id }
    }

    /// Writes a handle of the same program with another robot, which `derive` returns, to `derived`.
    pub fn derive(
        self,
        derived: Option<&mut MaybeUninit<Self>>,
        derive: impl FnOnce(&rect::Robot) -> Result<rect::Robot, Failure>,
    ) -> Result<(), Failure> {
        require_out("derived", &derived)?;
        let program = self.resolve()?;
        let robot = program.derive(derive(&program.robot)?);
        write_out("derived", derived, Self::of(robot))
    }
}

/// Returns the version of the library, e.g. `0.1.0`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_version() -> *const c_char {
    const VERSION: &CStr =
        match CStr::from_bytes_with_nul(concat!(env!("CARGO_PKG_VERSION"), "\0").as_bytes()) {
            Ok(version) => version,
            Err(_) => c"",
        };
    VERSION.as_ptr()
}

/// Lets Zenoh do all its work on one thread in place of five pools, unless the environment variable ZENOH_RUNTIME is set.
///
/// That saves a wake-up for each message. It is only safe for a program without receive queues of RECT_WHEN_FULL_BLOCK, services and
/// dictionaries: a thread that waits for room there would stop all other messages. Call it at the start of main, before
/// other threads run.
#[no_mangle]
pub extern "C" fn rect_use_one_thread() {
    rect::use_one_thread();
}

/// Connects as a program of the robot `name`, and writes the handle to `robot`. `options` may be NULL for the defaults: the
/// program uses the router of this computer.
///
/// ```c
/// rect_error error;
/// rect_robot robot;
/// if (rect_connect("wombat-1", NULL, &robot, &error) != RECT_CODE_OK) {
///     printf("%s\n", error.text);
/// }
/// ```
///
/// Returns `RECT_CODE_NO_ROUTER` if there is no router at the endpoint, `RECT_CODE_LOGIN_REFUSED` if the login is missing or
/// wrong, `RECT_CODE_WRONG_ROBOT` if the router belongs to another robot, `RECT_CODE_NAME` if the name is invalid, and
/// `RECT_CODE_OPTION` if Zenoh rejects an option.
///
/// May be called on any thread. Blocks until the router answers, at most `options.timeout_ms`.
#[no_mangle]
pub unsafe extern "C" fn rect_connect(
    name: *const c_char,
    options: Option<&Options>,
    robot: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("robot", &robot)?;
        // SAFETY: the caller follows the rules of rect.h.
        let options = unsafe { options::read(text("name", name)?, options) }?;
        write_out("robot", robot, RobotHandle::of(Program::connect(options)?))
    })
}

/// Creates a handle of the same robot whose messages and requests have another urgency (a `rect_urgency`), and writes it to
/// `derived`. Both handles share the session, and both must be dropped.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_with_urgency(
    robot: RobotHandle,
    urgency: u32,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| {
            Ok(robot.with_urgency(choice("urgency", &URGENCIES, urgency)?))
        })
    })
}

/// Creates a handle of the same robot whose messages expire, and writes it to `derived`: they are dropped rather than delivered
/// later than `lifetime_ms` milliseconds after they were sent. For commands such as steering. A queue or link without room drops
/// such a message, and receivers drop it if it was on the way for longer, or has waited for longer until the program reads it.
/// Both handles share the session, and both must be dropped.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_expires_after(
    robot: RobotHandle,
    lifetime_ms: u32,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let lifetime = Duration::from_millis(lifetime_ms.into());
        robot.derive(derived, |robot| Ok(robot.expires_after(lifetime)))
    })
}

/// Creates a handle of the same robot whose `rect_robot_request` is repeated while the link or a router is interrupted, and is
/// carried out at most once, and writes it to `derived`. For requests that must not be carried out twice, such as "grab".
///
/// The request names the run of the program that serves the topic. That run carries it out once, and repeats its first reply. A
/// program that was restarted refuses it: `RECT_CODE_INTERRUPTED`, and the request was carried out at most once, before the restart.
/// The timeout of such a request is at most 10 minutes; `RECT_CODE_OPTION` is returned for a longer one. The service keeps its
/// replies to the last 64 such requests of this program, at most 1 MB in all, until 60 s and the longest timeout have passed since
/// the last one. A service of stock Zenoh is asked once. Both handles share the session, and both must be dropped.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_retrying(
    robot: RobotHandle,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| Ok(robot.retrying()))
    })
}

/// Creates a handle of the same robot that encodes the payloads of its messages and requests with a codec, e.g. `zstd:9`,
/// `jpeg:60`, `webp:60`, `png` or `quantised:0.01`, and writes it to `derived`. Receivers decode them automatically. Both
/// handles share the session, and both must be dropped.
///
/// Returns `RECT_CODE_CODEC` if the codec is unknown. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_with_codec(
    robot: RobotHandle,
    codec: *const c_char,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| {
            // SAFETY: the caller follows the rules of rect.h.
            let codec = unsafe { text("codec", codec) }?;
            Ok(robot.with_codec(codec::parse(codec)?))
        })
    })
}

/// Creates a handle of the same robot that compresses the payloads of its messages and requests with a dictionary, and
/// writes it to `derived`. Small JSON messages become much smaller. Receivers fetch the dictionary once, automatically.
/// Both handles share the session, and both must be dropped.
///
/// May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_with_dictionary(
    robot: RobotHandle,
    dictionary: Dictionary,
    derived: Option<&mut MaybeUninit<RobotHandle>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        robot.derive(derived, |robot| {
            Ok(robot.with_dictionary(dictionary::resolve(dictionary)?)?)
        })
    })
}

/// Writes the robot's name to `name`, with a terminating zero byte. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_name(
    robot: RobotHandle,
    name: Option<&mut MaybeUninit<[c_char; NAME_BYTES]>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // A name always fits: it has at most 29 bytes.
        write_out("name", name, buffer(robot.resolve()?.robot.name().as_str()))
    })
}

/// Writes the fleet's name to `fleet`, with a terminating zero byte. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_fleet(
    robot: RobotHandle,
    fleet: Option<&mut MaybeUninit<[c_char; NAME_BYTES]>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // A name always fits: it has at most 29 bytes.
        write_out(
            "fleet",
            fleet,
            buffer(robot.resolve()?.robot.fleet().as_str()),
        )
    })
}

/// Publishes a payload on `topic` to every subscriber.
///
/// ```c
/// const rect_payload angle = rect_payload_json("12.5");
/// rect_robot_publish(robot, "arm/angle", &angle, &error);
/// ```
///
/// Returns `RECT_CODE_TOPIC` if the topic is invalid, and `RECT_CODE_CODEC` if the codec of the robot does not suit the
/// payload. May be called on any thread. Blocks while the send queue has no room for a large payload.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_publish(
    robot: RobotHandle,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (topic, payload) =
            unsafe { (text("topic", topic)?, require("payload", payload)?.read()?) };
        let program = robot.resolve()?;
        program.complete(program.robot.publish(topic, payload))
    })
}

/// Sends a payload on `topic` to one robot only. Nothing confirms that a program of the robot has received it; use
/// `rect_robot_request` if a reply is needed.
///
/// Returns `RECT_CODE_NOT_REACHABLE` if the recipient is not reachable now; a program that has just started waits first
/// (`rect_robot_wait_for_peer`). Returns `RECT_CODE_NAME` or `RECT_CODE_TOPIC` if the recipient or the topic is invalid. May be called
/// on any thread. Blocks while the send queue has no room for a large payload, and for up to half a second for the first message to a
/// recipient that is not reachable.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_send(
    robot: RobotHandle,
    recipient: *const c_char,
    topic: *const c_char,
    payload: Option<&PayloadView>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (recipient, topic, payload) = unsafe {
            (
                text("recipient", recipient)?,
                text("topic", topic)?,
                require("payload", payload)?.read()?,
            )
        };
        let program = robot.resolve()?;
        program.complete(program.robot.send(recipient, topic, payload))
    })
}

/// Waits for the next message that matches `pattern`, published or sent to this robot, and writes it to `message`. Earlier
/// messages are not returned.
///
/// Returns `RECT_CODE_TIMED_OUT` if there is none within `timeout_ms` (`RECT_FOREVER` waits without a limit). May be called
/// on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_wait_for_message(
    robot: RobotHandle,
    pattern: *const c_char,
    timeout_ms: u32,
    message: Option<&mut MaybeUninit<Message>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("message", &message)?;
        // SAFETY: the caller follows the rules of rect.h.
        let pattern = unsafe { text("pattern", pattern)? };
        let (program, timeout) = (robot.resolve()?, timeout(timeout_ms));
        let received = program.wait(
            program
                .robot
                .wait_for_message::<rect::Payload>(pattern, timeout),
        )?;
        write_out("message", message, message::into_c(received))
    })
}

/// Counts a value that does not fit the type that the program expects in `problems` of `rect_counters`, and writes a warning to
/// standard error for the first one of each sender and topic: `battery of wombat-2: ` and the text `problem`. Programs in C++ that
/// state a type need not call it. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_on_problem(
    robot: RobotHandle,
    sender: *const c_char,
    topic: *const c_char,
    problem: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let sender = Name::new(unsafe { text("sender", sender)? })?;
        // SAFETY: as above.
        let topic = Topic::new(unsafe { text("topic", topic)? })?;
        // SAFETY: as above.
        let problem = unsafe { text("problem", problem)? };
        let program = robot.resolve()?;
        program.robot.on_problem(&sender, &topic, &problem);
        Ok(())
    })
}

/// Writes the names of the other robots of the fleet that are reachable now to `names`. May be called on any thread; blocks
/// until the router answers.
#[no_mangle]
pub extern "C" fn rect_robot_peers(
    robot: RobotHandle,
    names: Option<&mut MaybeUninit<Names>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("names", &names)?;
        let program = robot.resolve()?;
        let peers = program.wait(program.robot.peers())?;
        write_out("names", names, names_into_c(peers))
    })
}

/// Waits until the robot `name` is reachable; returns at once if it is. Its programs may start later:
/// `rect_publisher_wait_for_subscriber` waits for one that subscribes.
///
/// Returns `RECT_CODE_TIMED_OUT` if the robot is not reachable within `timeout_ms` (`RECT_FOREVER` waits without a limit), and
/// `RECT_CODE_NAME` if the name is invalid. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_wait_for_peer(
    robot: RobotHandle,
    name: *const c_char,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let name = unsafe { text("name", name) }?;
        let program = robot.resolve()?;
        program.wait(program.robot.wait_for_peer(name, timeout(timeout_ms)))
    })
}

/// Waits until every reachable router knows the subscriptions and services of this program, so that messages and requests that
/// other robots send from now on arrive. Declarations reach the other robots a moment after the calls that made them, later
/// over a slow link. Without a router, the wait is for the directly linked programs.
///
/// Returns `RECT_CODE_TIMED_OUT` if a router does not answer within `timeout_ms` (`RECT_FOREVER` waits without a limit). May
/// be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_wait_until_established(
    robot: RobotHandle,
    timeout_ms: u32,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let program = robot.resolve()?;
        program.wait(program.robot.wait_until_established(timeout(timeout_ms)))
    })
}

/// Writes the counts of this program's messages to `counters`. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_counters(
    robot: RobotHandle,
    counters: Option<&mut MaybeUninit<Counters>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let counted = robot.resolve()?.robot.counters();
        let rect::Counters {
            sent,
            sent_bytes,
            received,
            received_bytes,
            missed,
            expired,
            rejected,
            problems,
        } = counted;
        let counted = Counters {
            sent,
            sent_bytes,
            received,
            received_bytes,
            missed,
            expired,
            rejected,
            problems,
        };
        write_out("counters", counters, counted)
    })
}

/// Writes to `is_closed` whether the session was closed. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_robot_is_closed(
    robot: RobotHandle,
    is_closed: Option<&mut MaybeUninit<bool>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        write_out("is_closed", is_closed, robot.resolve()?.robot.is_closed())
    })
}

/// Closes the session and everything that belongs to it, regardless of other handles. The handles must still be dropped.
///
/// May be called on any thread, also in callbacks.
#[no_mangle]
pub extern "C" fn rect_robot_close(
    robot: RobotHandle,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        let program = robot.resolve()?;
        program.wait(program.robot.close())
    })
}
