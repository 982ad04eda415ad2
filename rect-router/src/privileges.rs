//! Uses the capability that systemd grants to the router, and gives it up before the router reads anything.
//!
//! The kernel's Bluetooth management interface requires CAP_NET_ADMIN, which also permits changes of the network. The
//! kernel checks it when the socket is bound, so the router needs it only until then.
use rustix::{
    io,
    process::geteuid,
    thread::{capabilities, set_capabilities, CapabilitySet, CapabilitySets},
};
use zenoh_link_ble_bluez::management;

/// Opens the socket of the management interface if this process has CAP_NET_ADMIN, and gives all capabilities up. Does
/// nothing as root. Call it before any other thread runs, because capabilities belong to threads.
///
/// # Errors
/// Fails if the capabilities cannot be given up.
pub fn use_and_drop() -> io::Result<()> {
    let held = capabilities(None)?;
    if geteuid().is_root() || !held.effective.contains(CapabilitySet::NET_ADMIN) {
        return Ok(());
    }
    // Without Bluetooth in the kernel, the links report that.
    let _ = management::open();
    set_capabilities(
        None,
        CapabilitySets {
            effective: CapabilitySet::empty(),
            permitted: CapabilitySet::empty(),
            inheritable: CapabilitySet::empty(),
        },
    )
}
