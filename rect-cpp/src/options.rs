//! Owns how C says how to join.
use std::{ffi::c_char, time::Duration};

use serde_json::Value;

use crate::{
    argument::{items, text, text_or_none},
    failure::Failure,
};

/// How to join, where the router of this computer does not do. What is 0 or NULL is left at its default, so that
/// `rect_options options = {0};` changes nothing. It is read during the call only.
#[repr(C)]
pub struct Options {
    /// The team's name; default `rect`.
    pub fleet: *const c_char,
    /// The router, as `tcp/192.168.0.7:7447`; default: what the environment's `RECT_ENDPOINT` says, else
    /// `tcp/127.0.0.1:7447`.
    pub router: *const c_char,
    /// Without a router: connects to these directly, as `ble/wombat-2` or `udp/192.168.0.8:7447`. They are dialled until they
    /// are there; joining does not wait for them.
    pub endpoints: *const *const c_char,
    /// How many endpoints.
    pub endpoints_len: usize,
    /// Without a router: others may connect to this program there, as `tcp/0.0.0.0:7447` or `ble/hci0#name=wombat-1`.
    pub listen: *const *const c_char,
    /// How many places to listen at.
    pub listen_len: usize,
    /// As that user, with `password`; default: the first line of the login file.
    pub user: *const c_char,
    /// The user's password.
    pub password: *const c_char,
    /// The file with the login, `user:password`; default: what the environment's `RECT_LOGIN` says, else `/etc/rect/users`.
    pub login_file: *const c_char,
    /// How long to wait for the router, in ms; default 5000, so that a program may be started together with it.
    pub patience_ms: u32,
    /// Any settings of Zenoh's configuration: paths, as `transport/unicast/max_links`. They go before RECT's.
    pub zenoh_keys: *const *const c_char,
    /// Their values, in JSON: as many as there are keys.
    pub zenoh_values: *const *const c_char,
    /// How many settings.
    pub zenoh_len: usize,
    /// Joins although the router serves another robot: for a program that uses another name on purpose. A router with access
    /// control as `rect-router init` writes it drops what such a program publishes.
    pub allow_name_mismatch: bool,
}

/// As the library has them.
///
/// # Safety
/// They are as rect.h asks.
pub unsafe fn read(robot: &str, given: Option<&Options>) -> Result<rect::Options, Failure> {
    let options = rect::Options::new(robot)?;
    let Some(given) = given else {
        return Ok(options);
    };
    // SAFETY: as this function asks.
    unsafe { with(options, given) }
}

/// # Safety
/// As [`read`].
unsafe fn with(mut options: rect::Options, given: &Options) -> Result<rect::Options, Failure> {
    // SAFETY: as this function asks.
    unsafe {
        if let Some(fleet) = text_or_none("options.fleet", given.fleet)? {
            options = options.fleet(fleet)?;
        }
        if let Some(router) = text_or_none("options.router", given.router)? {
            options = options.router(router);
        }
        for &one in items("options.endpoints", given.endpoints, given.endpoints_len)? {
            options = options.endpoint(text("options.endpoints", one)?);
        }
        for &one in items("options.listen", given.listen, given.listen_len)? {
            options = options.listen(text("options.listen", one)?);
        }
        if let Some(user) = text_or_none("options.user", given.user)? {
            let password = text_or_none("options.password", given.password)?;
            options = options.login(user, password.unwrap_or_default());
        }
        if let Some(file) = text_or_none("options.login_file", given.login_file)? {
            options = options.login_file(file);
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
                        format!("has what is no JSON: {error}"),
                    )
                })?;
            options = options.zenoh(text("options.zenoh_keys", key)?, value);
        }
    }
    Ok(match given.patience_ms {
        0 => options,
        ms => options.patience(Duration::from_millis(ms.into())),
    })
}
