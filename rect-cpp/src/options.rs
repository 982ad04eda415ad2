//! Converts the options for connecting from C into those of the library.
use std::{ffi::c_char, time::Duration};

use serde_json::Value;

use crate::{
    argument::{items, text, text_or_none},
    failure::Failure,
};

/// The options of `rect_connect`. The defaults connect to the router of this computer.
///
/// Fields that are 0 or NULL keep their defaults, so `rect_options options = {0};` changes nothing. The struct is only read
/// during the call.
#[repr(C)]
pub struct Options {
    /// The team's name. Default: `rect`.
    pub fleet: *const c_char,
    /// The endpoint of the router, e.g. `tcp/192.168.0.7:7447`. Default: the value of the environment variable
    /// `RECT_ENDPOINT`, or `tcp/127.0.0.1:7447`.
    pub router: *const c_char,
    /// Endpoints to connect to directly instead of a router, e.g. `ble/wombat-2` or `udp/192.168.0.8:7447`. The program
    /// dials them until they accept; `rect_connect` does not wait for that.
    pub endpoints: *const *const c_char,
    /// Number of endpoints.
    pub endpoints_len: usize,
    /// Endpoints to listen on instead of using a router, e.g. `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    pub listen: *const *const c_char,
    /// Number of endpoints to listen on.
    pub listen_len: usize,
    /// The user to log in as, with `password`. Default: the first line of the login file.
    pub user: *const c_char,
    /// The password of the user.
    pub password: *const c_char,
    /// The file with the login as `user:password`. Default: the value of the environment variable `RECT_LOGIN`, or
    /// `/etc/rect/users`.
    pub login_file: *const c_char,
    /// How long to wait for the router, in milliseconds. Default: 5000, so that a program may start together with the
    /// router.
    pub timeout_ms: u32,
    /// Paths of settings of Zenoh, e.g. `transport/unicast/max_links`. They take precedence over RECT's own settings.
    pub zenoh_keys: *const *const c_char,
    /// The values of these settings as JSON, one for each path.
    pub zenoh_values: *const *const c_char,
    /// Number of settings.
    pub zenoh_len: usize,
    /// Whether to connect even if the router belongs to another robot, for programs that deliberately use another name. The
    /// access control that `rect init` sets up drops everything that such a program publishes.
    pub allow_name_mismatch: bool,
    /// The name under which this program is known in the fleet. Default: that of the executable. An empty text leaves the program
    /// without a name.
    pub program: *const c_char,
}

/// Converts the options for the library.
///
/// # Safety
/// The pointers follow the rules of rect.h.
pub unsafe fn read(robot: &str, given: Option<&Options>) -> Result<rect::Options, Failure> {
    let options = rect::Options::new(robot)?;
    let Some(given) = given else {
        return Ok(options);
    };
    // SAFETY: guaranteed by this function's caller.
    unsafe { apply(options, given) }
}

/// # Safety
/// The same as for [`read`].
unsafe fn apply(mut options: rect::Options, given: &Options) -> Result<rect::Options, Failure> {
    // SAFETY: guaranteed by this function's caller.
    unsafe {
        if let Some(fleet) = text_or_none("options.fleet", given.fleet)? {
            options = options.fleet(fleet)?;
        }
        if let Some(router) = text_or_none("options.router", given.router)? {
            options = options.router(router);
        }
        for &endpoint in items("options.endpoints", given.endpoints, given.endpoints_len)? {
            options = options.endpoint(text("options.endpoints", endpoint)?);
        }
        for &endpoint in items("options.listen", given.listen, given.listen_len)? {
            options = options.listen(text("options.listen", endpoint)?);
        }
        if let Some(user) = text_or_none("options.user", given.user)? {
            let password = text_or_none("options.password", given.password)?;
            options = options.login(user, password.unwrap_or_default());
        }
        if let Some(file) = text_or_none("options.login_file", given.login_file)? {
            options = options.login_file(file);
        }
        if let Some(program) = text_or_none("options.program", given.program)? {
            options = match program {
                "" => options.without_program_name(),
                program => options.program(program)?,
            };
        }
        if given.allow_name_mismatch {
            options = options.allow_name_mismatch();
        }
        let values = items("options.zenoh_values", given.zenoh_values, given.zenoh_len)?;
        let keys = items("options.zenoh_keys", given.zenoh_keys, given.zenoh_len)?;
        for (&key, &value) in keys.iter().zip(values) {
            let value: Value =
                serde_json::from_str(text("options.zenoh_values", value)?).map_err(|error| {
                    Failure::argument(
                        "options.zenoh_values",
                        format!("contains a value that is not JSON: {error}"),
                    )
                })?;
            options = options.zenoh(text("options.zenoh_keys", key)?, value);
        }
    }
    Ok(match given.timeout_ms {
        0 => options,
        ms => options.timeout(Duration::from_millis(ms.into())),
    })
}
