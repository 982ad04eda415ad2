//! Returns what the programs of a robot serve.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::Name;

use crate::{
    argument::text_or_none,
    boundary::{call, require_out, write_out, ErrorOut},
    connection::target_robot,
    failure::Code,
    handle::{self, Object},
    robot::RobotHandle,
    text::Text,
};

/// A service of a robot.
#[repr(C)]
pub struct ServiceEntry {
    /// The topic.
    pub topic: Text,
    /// The name of the program that serves it; empty if the program has none.
    pub program: Text,
    /// Its purpose, in the words of the program; empty if there are none.
    pub about: Text,
    /// Whether other programs of the robot may serve the same topic. Then each of them answers.
    pub several: bool,
}

/// The services of a robot. Release it with `rect_drop(&services.id, ..)`.
#[repr(C)]
pub struct Services {
    /// The handle.
    pub id: u64,
    /// The first service.
    pub items: *const ServiceEntry,
    /// Number of services.
    pub len: usize,
}

struct OwnedServices {
    _programs: Vec<rect::Program>,
    _views: Vec<ServiceEntry>,
}

// SAFETY: the views point into the programs stored next to them, which never change.
unsafe impl Send for OwnedServices {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedServices {}

impl Object for OwnedServices {
    const KIND: &'static str = "list of services";
}

fn into_c(programs: Vec<rect::Program>) -> Services {
    let mut views = Vec::new();
    for program in &programs {
        let name = Text::of_some(program.name.as_ref().map(Name::as_str));
        views.extend(program.requestable().map(|service| ServiceEntry {
            topic: Text::of(service.topic.as_str()),
            program: name,
            about: Text::of(&service.about),
            several: service.several,
        }));
    }
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedServices {
        _programs: programs,
        _views: views,
    });
    Services { id, items, len }
}

/// Writes what the programs of a robot serve to `services`, in the order in which the programs began. `target` is the robot; NULL means
/// this robot.
///
/// An answer is kept until the robot's programs announce a change (at most once a second), so that asking again costs nothing on the air.
///
/// Returns `RECT_CODE_NO_SERVICE` if no router with a catalogue answers. May be called on any thread; blocks until the reply arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_services(
    robot: RobotHandle,
    target: *const c_char,
    services: Option<&mut MaybeUninit<Services>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("services", &services)?;
        // SAFETY: the caller follows the rules of rect.h.
        let target = unsafe { text_or_none("target", target) }?;
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        let programs = program.wait(program.robot.programs(target))?;
        write_out("services", services, into_c(programs))
    })
}
