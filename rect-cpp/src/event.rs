//! Passes events about robots, links and the router to C callbacks.
use std::{ffi::c_void, mem::MaybeUninit, sync::Arc};

use rect::Name;

use crate::{
    argument::require,
    boundary::{call, require_out, write_out, ErrorOut},
    callback::{Callback, Release},
    failure::Code,
    robot::RobotHandle,
    subscription::{self, Source, Subscription},
    text::Text,
};

/// The kind of an event.
#[repr(C)]
#[derive(Clone, Copy)]
pub enum EventKind {
    /// A robot of the fleet became reachable.
    PeerUp = 0,
    /// A robot of the fleet became unreachable.
    PeerDown = 1,
    /// A link was established.
    LinkUp = 2,
    /// A link ended.
    LinkDown = 3,
    /// The router of this program became reachable.
    RouterUp = 4,
    /// The router of this program became unreachable.
    RouterDown = 5,
    /// Another path carries the bulk of a link whose method is `any`.
    PathSwitched = 6,
    /// A program that has a name is known at a robot.
    ProgramUp = 7,
    /// A program has ended, or its robot became unreachable.
    ProgramDown = 8,
    /// Nothing has been received over a link for longer than usual. It may end, or resume.
    LinkSilent = 9,
    /// Something has been received over a link that was silent.
    LinkResumed = 10,
}

/// A change of a robot, a link or the router. It is valid until the callback returns.
#[repr(C)]
pub struct Event {
    /// The kind of the event.
    pub kind: EventKind,
    /// The robot concerned. Empty for router events, and for a link whose other end is not known.
    pub robot: Text,
    /// The method of the link, e.g. `ble`; empty if the event does not concern a link.
    pub method: Text,
    /// The address of the link's other end; empty if the event does not concern a link.
    pub address: Text,
    /// The method of the path that carries the bulk now, `ble` or `tcp`; empty unless the path has changed.
    pub path: Text,
    /// Why the path has changed: `ended`, `silent` or `faster`; empty unless it has.
    pub reason: Text,
    /// The name of the program; empty if the event does not concern one.
    pub program: Text,
}

/// A callback for events. The event is valid until the callback returns.
pub type OnEvent = Option<extern "C" fn(event: *const Event, context: *mut c_void)>;

impl Source for rect::Events {
    type Item = rect::Event;

    async fn next(&self) -> Option<rect::Event> {
        Self::next(self).await
    }

    fn close(&self) {
        Self::close(self);
    }
}

fn view(event: &rect::Event) -> Event {
    let of = |kind, robot: Option<&Name>, link: Option<&rect::Link>| Event {
        kind,
        robot: Text::of_some(robot.map(Name::as_str)),
        method: Text::of_some(link.map(|link| link.method.as_str())),
        address: Text::of_some(link.map(|link| link.address.as_str())),
        path: Text::of(""),
        reason: Text::of(""),
        program: Text::of(""),
    };
    let of_program = |kind, robot: &Name, program: &Name| Event {
        program: Text::of(program.as_str()),
        ..of(kind, Some(robot), None)
    };
    match event {
        rect::Event::PeerUp { robot } => of(EventKind::PeerUp, Some(robot), None),
        rect::Event::PeerDown { robot } => of(EventKind::PeerDown, Some(robot), None),
        rect::Event::ProgramUp { robot, program } => {
            of_program(EventKind::ProgramUp, robot, program)
        }
        rect::Event::ProgramDown { robot, program } => {
            of_program(EventKind::ProgramDown, robot, program)
        }
        rect::Event::LinkUp(link) => of(EventKind::LinkUp, link.robot.as_ref(), Some(link)),
        rect::Event::LinkDown(link) => of(EventKind::LinkDown, link.robot.as_ref(), Some(link)),
        rect::Event::LinkSilent(link) => of(EventKind::LinkSilent, link.robot.as_ref(), Some(link)),
        rect::Event::LinkResumed(link) => {
            of(EventKind::LinkResumed, link.robot.as_ref(), Some(link))
        }
        rect::Event::PathSwitched { link, path, reason } => Event {
            path: Text::of(path),
            reason: Text::of(reason.as_str()),
            ..of(EventKind::PathSwitched, link.robot.as_ref(), Some(link))
        },
        rect::Event::RouterUp => of(EventKind::RouterUp, None, None),
        rect::Event::RouterDown => of(EventKind::RouterDown, None, None),
    }
}

/// Calls `callback` for each event, until the subscription is dropped.
///
/// The events are: robots that become reachable or unreachable, programs that begin or end, links of this robot's router (or of this program, if it has
/// no router) with their method and the path that carries their bulk, and the router itself. The first calls report the robots that are already reachable and the
/// links that the router already has. The calls are made one after another, on a thread of the subscription.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// May be called on any thread. The callback may call any function of RECT and may drop its own subscription.
#[no_mangle]
pub extern "C" fn rect_robot_on_event(
    robot: RobotHandle,
    callback: OnEvent,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let wrapper = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("subscription", &subscription)?;
        let callback = require("callback", callback)?;
        let program = robot.resolve()?;
        let events = program.wait(program.robot.events())?;
        let started =
            subscription::start(&program.runtime, events, wrapper, move |event, context| {
                callback(&view(event), context);
            })?;
        write_out("subscription", subscription, started)
    })
}
