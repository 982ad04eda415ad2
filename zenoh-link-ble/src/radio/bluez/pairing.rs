//! Owns pairing: what bluetoothd is told when the kernel pairs two devices for `sec=medium` or `high`. bluetoothd asks one
//! agent, the last that came, about all adapters; so the passkeys of this process are in one place.
use std::collections::BTreeMap;

use bluer::{
    agent::{Agent, AgentHandle, ReqError},
    Session,
};
use parking_lot::Mutex as Lock;
use tokio::sync::Mutex;

use super::errors::dbus_error;
use crate::radio::{ChannelOptions, RadioError, Security};

/// What is typed in on each adapter.
static PASSKEYS: Lock<BTreeMap<String, u32>> = Lock::new(BTreeMap::new());

/// A radio's agent, without which BlueZ refuses to pair.
#[derive(Default)]
pub(super) struct Pairing(Mutex<Option<Registered>>);

struct Registered {
    types_in: bool,
    /// bluetoothd forgets it when it is restarted.
    epoch: u64,
    _handle: AgentHandle,
}

impl Pairing {
    /// Makes sure that there is an agent where the kernel may pair for these options; `epoch`: the radio's.
    pub(super) async fn prepare(
        &self,
        session: &Session,
        adapter: &str,
        epoch: u64,
        options: &ChannelOptions,
    ) -> Result<(), RadioError> {
        let types_in = match options.security {
            Security::Low => return Ok(()),
            Security::Medium => false,
            Security::High => true,
        };
        if let Some(passkey) = options.passkey {
            PASSKEYS.lock().insert(adapter.to_owned(), passkey);
        }
        let mut registered = self.0.lock().await;
        // One that types in stays where `medium` is asked for: it is there for `high`.
        let serves = |there: &Registered| there.epoch == epoch && there.types_in >= types_in;
        if registered.as_ref().is_some_and(serves) {
            return Ok(());
        }
        *registered = None;
        let agent = if types_in { typing() } else { confirming() };
        let handle = session.register_agent(agent).await;
        *registered = Some(Registered {
            types_in,
            epoch,
            _handle: handle.map_err(dbus_error("register a pairing agent"))?,
        });
        Ok(())
    }
}

/// Confirms what a headless robot can: the two sides' numbers are not compared by anyone. For `medium`, which keeps
/// listeners out, not impostors at the moment of pairing.
fn confirming() -> Agent {
    Agent {
        request_default: true,
        request_confirmation: Some(Box::new(|_| Box::pin(async { Ok(()) }))),
        request_authorization: Some(Box::new(|asked| {
            tracing::info!("ble: pairs {} with {}", asked.adapter, asked.device);
            Box::pin(async { Ok(()) })
        })),
        ..Default::default()
    }
}

/// Types in the passkey, for `high`. It can do nothing else, so that the kernel takes no other way of pairing: of two that
/// can only type, both do.
fn typing() -> Agent {
    Agent {
        request_default: true,
        request_passkey: Some(Box::new(|asked| {
            tracing::info!("ble: pairs {} with {}", asked.adapter, asked.device);
            let passkey = PASSKEYS.lock().get(&asked.adapter).copied();
            // An adapter that this process does not use is somebody else's.
            Box::pin(async move { passkey.ok_or(ReqError::Rejected) })
        })),
        ..Default::default()
    }
}
