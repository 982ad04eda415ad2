//! Declares groups of parameters, which people tune while the program runs.
use std::{
    cell::Cell,
    collections::BTreeMap,
    ffi::{c_char, c_void},
    mem::MaybeUninit,
    sync::{Arc, Mutex, MutexGuard},
};

use rect::{GroupOptions, Parameter, ParameterOrder, ParameterValue as Value};
use rect_core::parameters::Declaration;

use crate::{
    argument::{items, text, text_or_none},
    boundary::{call, require_out, write_out, ErrorOut, ERROR_BYTES},
    callback::{Callback, Release},
    cancellable::timeout,
    failure::{Code, Failure},
    handle::{self, lock, Object},
    parameter_values::{self, ParameterValue, ParameterValues},
    program::Program,
    robot::RobotHandle,
    text::{string_into_c, StringView, Text},
};

/// The declaration of a group of parameters, to which a program adds them. Release it with `rect_drop(&parameters.id, ..)`, also after
/// `rect_robot_parameters`.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct Parameters {
    /// The handle.
    pub id: u64,
}

/// A group of parameters of this program. `rect_drop(&group.id, ..)` stores what has changed, ends the group, and waits for calls in
/// progress. Its last values remain visible, as those of a program that has ended. A callback may drop its own group.
#[repr(C)]
#[derive(Clone, Copy)]
pub struct ParameterGroup {
    /// The handle.
    pub id: u64,
}

/// The options of a group of parameters. `rect_parameter_options options = {0};` are the defaults, and so is NULL.
#[repr(C)]
pub struct ParameterOptions {
    /// The purpose of the group: at most 200 characters. NULL: nothing.
    pub about: *const c_char,
    /// The file in which the values are kept. NULL: `<folder>/<robot>/<group>.json`, in the folder of the environment variable
    /// `RECT_PARAMETERS`, or `~/.local/state/rect/parameters`.
    pub file: *const c_char,
    /// Whether the program begins with the defaults at each start: the values are kept in no file.
    pub without_file: bool,
}

/// A parameter that has another value now.
#[repr(C)]
pub struct ChangedParameter {
    /// The value before.
    pub before: ParameterValue,
    /// The value now.
    pub after: ParameterValue,
}

/// A change of parameters. Those that are changed together are one change. It is valid until the callback returns.
#[repr(C)]
pub struct ParameterChange {
    /// All values of the group, in the order of the declaration.
    pub values: ParameterValues,
    /// The parameters that have another value now.
    pub changed: *const ChangedParameter,
    /// Number of these parameters.
    pub changed_len: usize,
    /// The program that has changed them, `<robot>/<program>` or `<robot>`; empty if it was this program.
    pub by: Text,
}

/// A callback that checks values before they are in force: returns whether the program accepts them. If not, it writes the reason to
/// `reason`, with a terminating zero byte; the program that changes them receives it. It must not change parameters. The values are valid
/// until it returns.
pub type ParameterCheck = Option<
    extern "C" fn(
        values: *const ParameterValues,
        reason: *mut [c_char; ERROR_BYTES],
        context: *mut c_void,
    ) -> bool,
>;

/// A callback for changes. The change is valid until the callback returns.
pub type OnParameterChange =
    Option<extern "C" fn(change: *const ParameterChange, context: *mut c_void)>;

struct Builder {
    group: String,
    parameters: Mutex<Vec<Parameter>>,
}

impl Object for Builder {
    const KIND: &'static str = "declaration of parameters";
}

impl Builder {
    fn parameters(&self) -> MutexGuard<'_, Vec<Parameter>> {
        lock(&self.parameters)
    }
}

struct Group {
    group: Mutex<Option<Arc<rect::ParameterGroup>>>,
    declaration: Arc<Declaration>,
    callback: Arc<Callback>,
    /// Keeps the session open.
    _program: Program,
}

impl Object for Group {
    const KIND: &'static str = "group of parameters";

    fn on_dropped(&self) {
        let group = lock(&self.group).take();
        drop(group);
        self.callback.close();
    }
}

impl Group {
    fn resolve(group: ParameterGroup) -> Result<(Arc<Self>, Arc<rect::ParameterGroup>), Failure> {
        let this: Arc<Self> = handle::get(group.id)?;
        let group = lock(&this.group).clone().ok_or(Failure::Closed)?;
        Ok((this, group))
    }

    /// Returns the value of a parameter as a type, which is `expected` in words.
    ///
    /// # Safety
    /// `name` is NULL, or has a terminating zero byte.
    unsafe fn value<T>(
        group: ParameterGroup,
        name: *const c_char,
        expected: &str,
        as_type: impl FnOnce(&Value) -> Option<T>,
    ) -> Result<T, Failure> {
        // SAFETY: guaranteed by this function's caller.
        let name = unsafe { text("name", name) }?;
        let (this, group) = Self::resolve(group)?;
        let found = this.declaration.find(name);
        found.map_err(|reason| rect::Error::Parameters { reason })?;
        let values = group.get();
        let value = values.get(name);
        let value =
            value.ok_or_else(|| Failure::argument("name", "is not the name of a parameter"))?;
        as_type(value).ok_or_else(|| {
            let found = value.type_name();
            Failure::argument("name", format!("belongs to {found}, not to {expected}"))
        })
    }
}

thread_local! {
    /// Whether this thread runs a check.
    static IS_CHECKING: Cell<bool> = const { Cell::new(false) };
}

/// Returns a limit of a range; C passes NaN for none.
fn limit(limit: f64) -> Option<f64> {
    (!limit.is_nan()).then_some(limit)
}

/// Adds a parameter to a declaration.
///
/// # Safety
/// The texts are NULL, or have a terminating zero byte.
unsafe fn add(
    parameters: Parameters,
    name: *const c_char,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
    parameter: impl FnOnce(&str) -> Result<Parameter, Failure>,
) -> Code {
    call(error, || {
        // SAFETY: guaranteed by this function's caller.
        let (name, about) = unsafe { (text("name", name)?, text_or_none("about", about)?) };
        let builder: Arc<Builder> = handle::get(parameters.id)?;
        let parameter = parameter(name)?.about(about.unwrap_or_default());
        builder.parameters().push(parameter);
        Ok(())
    })
}

/// Begins the declaration of a group of parameters: values of this program that people tune while it runs, such as a gain. `group` is
/// the name of the group. Then add parameters, and call `rect_robot_parameters`, which also checks the declaration.
///
/// ```c
/// must(rect_parameters_new("drive", &parameters, &error));
/// must(rect_parameters_add_number(parameters, "kp", 1.0, 0, 10, "1/s", "gain of the heading", &error));
/// must(rect_robot_parameters(robot, parameters, NULL, NULL, NULL, NULL, NULL, &group, &error));
/// must(rect_parameter_group_number(group, "kp", &kp, &error));
/// ```
///
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_new(
    group: *const c_char,
    parameters: Option<&mut MaybeUninit<Parameters>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("parameters", &parameters)?;
        // SAFETY: the caller follows the rules of rect.h.
        let group = unsafe { text("group", group) }?.to_owned();
        let id = handle::insert(Builder {
            group,
            parameters: Mutex::default(),
        });
        write_out("parameters", parameters, Parameters { id })
    })
}

/// Adds a number, with its default. `min` and `max` are its limits, and NAN for none. `unit`, such as `m/s`, and `about`, its purpose,
/// may be NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_number(
    parameters: Parameters,
    name: *const c_char,
    default_value: f64,
    min: f64,
    max: f64,
    unit: *const c_char,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe {
        add(parameters, name, about, error, |name| {
            let unit = text_or_none("unit", unit)?.unwrap_or_default();
            let parameter = Parameter::new(name, default_value).unit(unit);
            Ok(parameter.range(limit(min), limit(max)))
        })
    }
}

/// Adds an integer between -2^53 and 2^53, with its default. The other arguments are those of `rect_parameters_add_number`. May be
/// called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_integer(
    parameters: Parameters,
    name: *const c_char,
    default_value: i64,
    min: f64,
    max: f64,
    unit: *const c_char,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe {
        add(parameters, name, about, error, |name| {
            let unit = text_or_none("unit", unit)?.unwrap_or_default();
            let parameter = Parameter::new(name, default_value).unit(unit);
            Ok(parameter.range(limit(min), limit(max)))
        })
    }
}

/// Adds a switch, with its default. `about`, its purpose, may be NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_bool(
    parameters: Parameters,
    name: *const c_char,
    default_value: bool,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let parameter = |name: &str| Ok(Parameter::new(name, default_value));
    // SAFETY: the caller follows the rules of rect.h.
    unsafe { add(parameters, name, about, error, parameter) }
}

/// Adds a text of at most 4 kB, with its default. `about`, its purpose, may be NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_text(
    parameters: Parameters,
    name: *const c_char,
    default_value: *const c_char,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe {
        add(parameters, name, about, error, |name| {
            Ok(Parameter::new(name, text("default_value", default_value)?))
        })
    }
}

/// Adds the choice from a list of texts, with its default. `about`, its purpose, may be NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_choice(
    parameters: Parameters,
    name: *const c_char,
    default_value: *const c_char,
    choices: *const *const c_char,
    choices_len: usize,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe {
        add(parameters, name, about, error, |name| {
            let parameter = Parameter::new(name, text("default_value", default_value)?);
            Ok(parameter.choices(texts("choices", choices, choices_len)?))
        })
    }
}

/// Adds a list of at most 256 numbers, with its default. `min` and `max` limit each number, and are NAN for none. `unit` and `about` may
/// be NULL. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_add_numbers(
    parameters: Parameters,
    name: *const c_char,
    default_values: *const f64,
    default_values_len: usize,
    min: f64,
    max: f64,
    unit: *const c_char,
    about: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    // SAFETY: the caller follows the rules of rect.h.
    unsafe {
        add(parameters, name, about, error, |name| {
            let unit = text_or_none("unit", unit)?.unwrap_or_default();
            let default = items("default_values", default_values, default_values_len)?;
            let parameter = Parameter::new(name, default.to_vec()).unit(unit);
            Ok(parameter.range(limit(min), limit(max)))
        })
    }
}

/// Lets only the program itself change a parameter that was added. Returns `RECT_CODE_ARGUMENT` if no parameter of that name was added.
/// May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameters_make_read_only(
    parameters: Parameters,
    name: *const c_char,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let name = unsafe { text("name", name) }?;
        let builder: Arc<Builder> = handle::get(parameters.id)?;
        let mut all = builder.parameters();
        let found = all.iter_mut().find(|parameter| parameter.name == name);
        let parameter = found
            .ok_or_else(|| Failure::argument("name", "is not the name of an added parameter"))?;
        parameter.read_only = true;
        Ok(())
    })
}

/// Declares a group of parameters of this program, and writes the handle to `group`. Other programs change them with
/// `rect_robot_set_parameters`, and people with `rect param` and on the dashboard. They are kept in a file, so that they survive a restart.
/// `options` may be NULL: the defaults.
///
/// `check` is called with the values as they would be before each change, and may refuse it. `on_change` is called after each change, for
/// one change at a time and in order. Both may be NULL. They are called on the thread that changes own parameters with
/// `rect_parameter_group_set`, and on a thread of the session for the changes of others. They may call any function of RECT, and must not
/// take long: the next change waits.
///
/// `release` is called once with `context` when no more calls will follow, even if this function fails.
///
/// Returns `RECT_CODE_PARAMETERS` if the declaration is invalid, and `RECT_CODE_SERVICE_REFUSED` if a program of this robot has a group of
/// that name already. A file that cannot be read or does not fit is a warning on standard error. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_parameters(
    robot: RobotHandle,
    parameters: Parameters,
    options: Option<&ParameterOptions>,
    check: ParameterCheck,
    on_change: OnParameterChange,
    context: *mut c_void,
    release: Release,
    group: Option<&mut MaybeUninit<ParameterGroup>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let callback = Arc::new(Callback::new(context, release));
    call(error, || {
        require_out("group", &group)?;
        let builder: Arc<Builder> = handle::get(parameters.id)?;
        let parameters = builder.parameters().clone();
        let invalid = |reason: String| rect::Error::Parameters { reason };
        let declaration = Declaration::new(parameters.clone());
        let declaration = Arc::new(declaration.map_err(|error| invalid(error.to_string()))?);
        let mut described = GroupOptions::with(&builder.group, parameters);
        if let Some(options) = options {
            // SAFETY: the caller follows the rules of rect.h.
            let (about, file) = unsafe {
                (
                    text_or_none("options.about", options.about)?,
                    text_or_none("options.file", options.file)?,
                )
            };
            described = described.about(about.unwrap_or_default());
            described = match (file, options.without_file) {
                (Some(_), true) => {
                    let problem = "is set, although without_file is, too";
                    return Err(Failure::argument("options.file", problem));
                }
                (Some(file), false) => described.file(file),
                (None, true) => described.without_file(),
                (None, false) => described,
            };
        }
        if let Some(check) = check {
            let (callback, declaration) = (callback.clone(), declaration.clone());
            described =
                described.check(move |values| run_check(check, &callback, &declaration, values));
        }
        if let Some(on_change) = on_change {
            let (callback, declaration) = (callback.clone(), declaration.clone());
            described = described.on_change(move |values, change| {
                run_on_change(on_change, &callback, &declaration, values, change);
            });
        }
        let program = robot.resolve()?;
        let declared = program.wait(program.robot.parameters(described))?;
        let id = handle::insert(Group {
            group: Mutex::new(Some(Arc::new(declared))),
            declaration,
            callback,
            _program: (*program).clone(),
        });
        write_out("group", group, ParameterGroup { id })
    })
}

/// Runs a callback on a thread of the session, which it may block.
fn run(callback: &Callback, function: impl FnOnce(*mut c_void)) -> bool {
    tokio::task::block_in_place(|| callback.run(function))
}

fn run_check(
    check: extern "C" fn(*const ParameterValues, *mut [c_char; ERROR_BYTES], *mut c_void) -> bool,
    callback: &Callback,
    declaration: &Declaration,
    values: &BTreeMap<String, Value>,
) -> Result<(), String> {
    let views = parameter_values::views(declaration, values);
    let mut reason: [c_char; ERROR_BYTES] = [0; ERROR_BYTES];
    let mut is_accepted = false;
    let was_run = run(callback, |context| {
        let before = IS_CHECKING.replace(true);
        is_accepted = check(&ParameterValues::of(&views), &mut reason, context);
        IS_CHECKING.set(before);
    });
    if !was_run {
        return Err("the group is ending".to_owned());
    }
    if is_accepted {
        return Ok(());
    }
    let bytes = reason.iter().map(|&byte| byte as u8);
    let bytes: Vec<u8> = bytes.take_while(|&byte| byte != 0).collect();
    Err(match bytes.is_empty() {
        true => "the program refuses these values".to_owned(),
        false => String::from_utf8_lossy(&bytes).into_owned(),
    })
}

fn run_on_change(
    on_change: extern "C" fn(*const ParameterChange, *mut c_void),
    callback: &Callback,
    declaration: &Declaration,
    values: &BTreeMap<String, Value>,
    change: &rect::Change,
) {
    let views = parameter_values::views(declaration, values);
    let changed = change.changed.iter().map(|changed| ChangedParameter {
        before: ParameterValue::of(&changed.name, &changed.old),
        after: ParameterValue::of(&changed.name, &changed.new),
    });
    let changed: Vec<_> = changed.collect();
    let view = ParameterChange {
        values: ParameterValues::of(&views),
        changed: changed.as_ptr(),
        changed_len: changed.len(),
        by: Text::of(&change.by),
    };
    run(callback, |context| on_change(&view, context));
}

/// Writes the values that are in force to `values`, in the order of the declaration. They belong together: a change is in all of them or
/// in none. They do not change any more. May be called on any thread.
#[no_mangle]
pub extern "C" fn rect_parameter_group_values(
    group: ParameterGroup,
    values: Option<&mut MaybeUninit<ParameterValues>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        require_out("values", &values)?;
        let (this, group) = Group::resolve(group)?;
        let current = parameter_values::into_c(group.get(), Some(&this.declaration));
        write_out("values", values, current)
    })
}

/// Writes the value of a number or an integer to `number`. Returns `RECT_CODE_PARAMETERS` if there is no parameter of that name, and
/// `RECT_CODE_ARGUMENT` if it has another type. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_number(
    group: ParameterGroup,
    name: *const c_char,
    number: Option<&mut MaybeUninit<f64>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let as_number = |value: &Value| match value {
        Value::Number(number) => Some(*number),
        Value::Integer(number) => Some(*number as f64),
        _ => None,
    };
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let value = unsafe { Group::value(group, name, "a number", as_number) }?;
        write_out("number", number, value)
    })
}

/// Writes the value of an integer to `integer`. Returns the codes of `rect_parameter_group_number`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_integer(
    group: ParameterGroup,
    name: *const c_char,
    integer: Option<&mut MaybeUninit<i64>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let as_integer = |value: &Value| match value {
        Value::Integer(number) => Some(*number),
        _ => None,
    };
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let value = unsafe { Group::value(group, name, "an integer", as_integer) }?;
        write_out("integer", integer, value)
    })
}

/// Writes the value of a switch to `boolean`. Returns the codes of `rect_parameter_group_number`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_bool(
    group: ParameterGroup,
    name: *const c_char,
    boolean: Option<&mut MaybeUninit<bool>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let as_bool = |value: &Value| match value {
        Value::Bool(boolean) => Some(*boolean),
        _ => None,
    };
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let value = unsafe { Group::value(group, name, "a bool", as_bool) }?;
        write_out("boolean", boolean, value)
    })
}

/// Writes the value of a text or a choice to `string`. Returns the codes of `rect_parameter_group_number`. May be called on any thread.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_text(
    group: ParameterGroup,
    name: *const c_char,
    string: Option<&mut MaybeUninit<StringView>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    let as_text = |value: &Value| match value {
        Value::Text(text) => Some(text.clone()),
        _ => None,
    };
    call(error, || {
        require_out("string", &string)?;
        // SAFETY: the caller follows the rules of rect.h.
        let value = unsafe { Group::value(group, name, "a text", as_text) }?;
        write_out("string", string, string_into_c(value))
    })
}

/// Changes `len` parameters of this program, also read-only ones: all or none. They are in force when this function returns, and are
/// published and stored in the background.
///
/// ```c
/// const rect_parameter_value values[] = {rect_parameter_number("kp", 2.0), rect_parameter_text("side", "right")};
/// rect_parameter_group_set(group, values, 2, &error);
/// ```
///
/// Returns `RECT_CODE_PARAMETERS` with the reason if a value is refused. May be called on any thread, except in a check.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_set(
    group: ParameterGroup,
    values: *const ParameterValue,
    len: usize,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let values = unsafe { parameter_values::read(values, len) }?;
        change(group, ParameterOrder::set(values))
    })
}

/// Gives parameters of this program their defaults, also read-only ones. `names` are `len` names; with a `len` of 0, all parameters
/// except for read-only ones are reset.
///
/// Returns `RECT_CODE_PARAMETERS` with the reason if there is no such parameter or the check refuses the defaults. May be called on any
/// thread, except in a check.
#[no_mangle]
pub unsafe extern "C" fn rect_parameter_group_reset(
    group: ParameterGroup,
    names: *const *const c_char,
    len: usize,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let names = unsafe { texts("names", names, len) }?;
        change(group, reset(names))
    })
}

fn change(group: ParameterGroup, order: ParameterOrder) -> Result<(), Failure> {
    if IS_CHECKING.get() {
        // The group waits for the check.
        let reason = "a check cannot change parameters".to_owned();
        return Err(rect::Error::Parameters { reason }.into());
    }
    Ok(Group::resolve(group)?.1.set(order)?)
}

fn reset(names: Vec<&str>) -> ParameterOrder {
    match names.is_empty() {
        true => ParameterOrder::reset_all(),
        false => ParameterOrder::reset(names),
    }
}

/// Returns a list of texts.
///
/// # Safety
/// `first` is NULL, or points to `len` texts with terminating zero bytes, which outlive `'a`.
unsafe fn texts<'a>(
    name: &'static str,
    first: *const *const c_char,
    len: usize,
) -> Result<Vec<&'a str>, Failure> {
    // SAFETY: guaranteed by this function's caller.
    let all = unsafe { items(name, first, len) }?;
    // SAFETY: as above.
    all.iter().map(|&one| unsafe { text(name, one) }).collect()
}

/// Changes `len` parameters of a program of the robot `target`: all or none. Writes those parameters with the values that are in force
/// now to `in_force`, which may be NULL.
///
/// `stored` is whether to wait until the program has stored them, which takes up to a second longer; otherwise, a power cut within that
/// second may lose them. Access control may permit the change to some robots only (`@rect/@set/parameters/**`).
///
/// Returns `RECT_CODE_SERVICE` with the reason if the program refuses a value, `RECT_CODE_NO_PARAMETERS` if it has no such group, and
/// `RECT_CODE_NOT_STORED` if it cannot store the values, which are in force. The other codes are those of `rect_robot_request`. May be called
/// on any thread; blocks until the reply arrives, at most `timeout_ms`.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_set_parameters(
    robot: RobotHandle,
    target: *const c_char,
    group: *const c_char,
    values: *const ParameterValue,
    len: usize,
    stored: bool,
    timeout_ms: u32,
    in_force: Option<&mut MaybeUninit<ParameterValues>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (target, group, values) = unsafe {
            (
                text("target", target)?,
                text("group", group)?,
                parameter_values::read(values, len)?,
            )
        };
        let order = ParameterOrder::set(values);
        order_from(robot, target, group, order, stored, timeout_ms, in_force)
    })
}

/// Gives parameters of a program of the robot `target` their defaults. `names` are `len` names; with a `len` of 0, all parameters except
/// for read-only ones are reset. The other arguments, and the codes, are those of `rect_robot_set_parameters`.
#[no_mangle]
pub unsafe extern "C" fn rect_robot_reset_parameters(
    robot: RobotHandle,
    target: *const c_char,
    group: *const c_char,
    names: *const *const c_char,
    len: usize,
    stored: bool,
    timeout_ms: u32,
    in_force: Option<&mut MaybeUninit<ParameterValues>>,
    error: Option<&mut MaybeUninit<ErrorOut>>,
) -> Code {
    call(error, || {
        // SAFETY: the caller follows the rules of rect.h.
        let (target, group, names) = unsafe {
            (
                text("target", target)?,
                text("group", group)?,
                texts("names", names, len)?,
            )
        };
        order_from(
            robot,
            target,
            group,
            reset(names),
            stored,
            timeout_ms,
            in_force,
        )
    })
}

fn order_from(
    robot: RobotHandle,
    target: &str,
    group: &str,
    order: ParameterOrder,
    stored: bool,
    timeout_ms: u32,
    in_force: Option<&mut MaybeUninit<ParameterValues>>,
) -> Result<(), Failure> {
    let order = match stored {
        true => order.stored(),
        false => order,
    };
    let program = robot.resolve()?;
    let asking = program.robot.with_timeout(timeout(timeout_ms));
    let values = program.wait(asking.set_parameters(target, group, order))?;
    if let Some(in_force) = in_force {
        in_force.write(parameter_values::into_c(Arc::new(values), None));
    }
    Ok(())
}
