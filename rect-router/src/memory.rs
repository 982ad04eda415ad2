//! Limits the free memory that the allocator keeps.
//!
//! glibc gives the router's 40 threads arenas of their own, up to eight for each processor, and keeps most of what is freed in
//! each. After hours with faults, half of a router's memory was free in that way. It also keeps up to 0.24 MB for each thread, which
//! fill in hours and cannot be returned (docs/performance.md).
use std::{env, time::Duration};

/// The variable with which a user sets the number of arenas.
const VARIABLE: &str = "MALLOC_ARENA_MAX";
/// Two carry as many messages as glibc's default on two processors, and need less memory.
#[cfg(target_env = "gnu")]
const ARENAS: nix::libc::c_int = 2;

/// How often freed memory is returned.
pub const RETURNED_EVERY: Duration = Duration::from_secs(60);

/// Limits the number of arenas unless the user has set it. Call it before any other thread runs.
pub fn limit_arenas() {
    if env::var_os(VARIABLE).is_some() {
        return;
    }
    #[cfg(target_env = "gnu")]
    // SAFETY: `mallopt` may be called at any time; it changes only which arena a new thread uses.
    unsafe {
        nix::libc::mallopt(nix::libc::M_ARENA_MAX, ARENAS);
    }
}

/// Returns freed memory to the system.
pub fn return_freed() {
    #[cfg(target_env = "gnu")]
    // SAFETY: `malloc_trim` may be called at any time; it locks what it needs.
    unsafe {
        nix::libc::malloc_trim(0);
    }
}
