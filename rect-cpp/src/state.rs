//! Owns what C is told about who can be reached.
use std::{ffi::c_void, mem::MaybeUninit, sync::Arc};

use rect::Name;

use crate::{
    argument::there,
    boundary::{call, give, wanted, ErrorOut},
    callback::{Callback, Release},
    failure::Code,
    robot::Robot,
    subscription::{self, Source, Subscription},
    text::Text,
};

/// What has changed about who can be reached.
#[repr(C)]
#[derive(Clone, Copy)]
pub enum EventKind {
    /// A robot of the fleet is there.
    PeerUp = 0,
    /// It is gone.
    PeerDown = 1,
    /// A link came up.
    LinkUp = 2,
    /// It ended.
    LinkDown = 3,
    /// This program's router is there.
    RouterUp = 4,
    /// It is gone.
    RouterDown = 5,
}

/// A change of who can be reached. It is there until the callback returns.
#[repr(C)]
pub struct Event {
    /// What.
    pub kind: EventKind,
    /// Which robot; of a link nothing, where that is not known.
    pub robot: Text,
    /// The protocol of a link, as `ble`.
    pub method: Text,
    /// Its other end.
    pub address: Text,
}

/// Called with a change, which is there until it returns.
pub type OnState = Option<extern "C" fn(event: *const Event, context: *mut c_void)>;

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
    };
    match event {
        rect::Event::PeerUp { robot } => of(EventKind::PeerUp, Some(robot), None),
        rect::Event::PeerDown { robot } => of(EventKind::PeerDown, Some(robot), None),
        rect::Event::LinkUp(link) => of(EventKind::LinkUp, link.robot.as_ref(), Some(link)),
        rect::Event::LinkDown(link) => of(EventKind::LinkDown, link.robot.as_ref(), Some(link)),
        rect::Event::RouterUp => of(EventKind::RouterUp, None, None),
        rect::Event::RouterDown => of(EventKind::RouterDown, None, None),
    }
}

/// Calls `callback` for each change of who can be reached, and first of all for who is there already: robots that come and
/// go, links of this robot's router (without a router, of this program) and over which radio, and the router itself. One
/// after another, on a thread of its own, until the subscription is dropped. `release` is called with `context` once, when
/// there will be no more calls, even where this call fails.
///
/// Thread: any. The callback may call any function of RECT, and drop its own subscription.
#[no_mangle]
pub extern "C" fn rect_robot_on_state(
    robot: Robot,
    callback: OnState,
    context: *mut c_void,
    release: Release,
    subscription: Option<&mut MaybeUninit<Subscription>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let called = Arc::new(Callback::new(context, release));
    call(error, || {
        wanted("subscription", &subscription)?;
        let callback = there("callback", callback)?;
        let program = robot.live()?;
        let events = program.wait(program.robot.events())?;
        let started = subscription::start(&program, events, called, move |event, context| {
            callback(&view(event), context);
        })?;
        give("subscription", subscription, started)
    })
}
