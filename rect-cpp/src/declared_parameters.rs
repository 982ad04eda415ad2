//! Returns the parameters that the programs of a robot have declared.
use std::{ffi::c_char, mem::MaybeUninit};

use rect::Name;
use rect_core::parameters::Parameter;

use crate::{
    argument::text_or_none,
    boundary::{call, require_out, write_out, ErrorOut},
    connection::target_robot,
    failure::Code,
    handle::{self, Object},
    parameter_values::ParameterValue,
    robot::RobotHandle,
    text::Text,
};

/// A parameter that a program of a robot has declared.
#[repr(C)]
pub struct DeclaredParameter {
    /// The name of the group.
    pub group: Text,
    /// The name of the program; empty if the program has none.
    pub program: Text,
    /// The name of the parameter, and its default. The values in force are the retained topic `parameters/<group>` of the robot.
    pub default_value: ParameterValue,
    /// The smallest number; NAN: any.
    pub min: f64,
    /// The largest number; NAN: any.
    pub max: f64,
    /// The first choice; NULL if it is not a choice.
    pub choices: *const Text,
    /// Number of choices.
    pub choices_len: usize,
    /// The unit, such as `m/s`; empty if there is none.
    pub unit: Text,
    /// Its purpose, in the words of the program; empty if there are none.
    pub about: Text,
    /// Whether only the program itself changes it.
    pub read_only: bool,
}

/// The parameters of a robot. Release them with `rect_drop(&parameters.id, ..)`.
#[repr(C)]
pub struct DeclaredParameters {
    /// The handle.
    pub id: u64,
    /// The first parameter.
    pub items: *const DeclaredParameter,
    /// Number of parameters.
    pub len: usize,
}

struct OwnedParameters {
    _programs: Vec<rect::Program>,
    _choices: Vec<Vec<Text>>,
    _views: Vec<DeclaredParameter>,
}

// SAFETY: the views point into the programs and the choices stored next to them, which never change.
unsafe impl Send for OwnedParameters {}
// SAFETY: as for `Send`.
unsafe impl Sync for OwnedParameters {}

impl Object for OwnedParameters {
    const KIND: &'static str = "list of parameters";
}

fn into_c(programs: Vec<rect::Program>) -> DeclaredParameters {
    let (mut views, mut all_choices) = (Vec::new(), Vec::new());
    for program in &programs {
        let name = Text::of_some(program.name.as_ref().map(Name::as_str));
        for (group, declaration) in program.parameters() {
            for parameter in declaration.parameters() {
                let choices: Vec<_> = parameter.choices.iter().map(|one| Text::of(one)).collect();
                views.push(view(group, name, parameter, &choices));
                all_choices.push(choices);
            }
        }
    }
    let (items, len) = (views.as_ptr(), views.len());
    let id = handle::insert(OwnedParameters {
        _programs: programs,
        _choices: all_choices,
        _views: views,
    });
    DeclaredParameters { id, items, len }
}

/// Points to a parameter and its choices, which must outlive the result.
fn view(group: &str, program: Text, parameter: &Parameter, choices: &[Text]) -> DeclaredParameter {
    DeclaredParameter {
        group: Text::of(group),
        program,
        default_value: ParameterValue::of(&parameter.name, &parameter.default),
        min: parameter.min.unwrap_or(f64::NAN),
        max: parameter.max.unwrap_or(f64::NAN),
        choices: match choices.is_empty() {
            true => std::ptr::null(),
            false => choices.as_ptr(),
        },
        choices_len: choices.len(),
        unit: Text::of(&parameter.unit),
        about: Text::of(&parameter.about),
        read_only: parameter.read_only,
    }
}

/// Writes the parameters that the programs of a robot have declared to `parameters`, in the order in which the programs began. `target` is
/// the robot; NULL means this robot. `rect_robot_set_parameters` changes them.
///
/// The answer is kept as that of `rect_robot_services`.
///
/// Returns `RECT_CODE_NO_SERVICE` if no router with a catalogue answers. May be called on any thread; blocks until the reply arrives.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_declared_parameters(
    robot: RobotHandle,
    target: *const c_char,
    parameters: Option<&mut MaybeUninit<DeclaredParameters>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("parameters", &parameters)?;
        // SAFETY: the caller follows the rules of rect.h.
        let target = unsafe { text_or_none("target", target) }?;
        let program = robot.resolve()?;
        let target = target_robot(&program, target)?;
        let programs = program.wait(program.robot.programs(target))?;
        write_out("parameters", parameters, into_c(programs))
    })
}
