//! Answers the pairing requests of bluetoothd when the kernel pairs two devices for `sec=medium` or `sec=high`.
//! bluetoothd sends the requests for all adapters to one agent, the one registered last. The passkeys of this process
//! are therefore kept in one place.
use std::collections::BTreeMap;

use bluer::{
    agent::{Agent, AgentHandle, ReqError},
    Session,
};
use parking_lot::Mutex as Lock;
use tokio::sync::Mutex;
use zenoh_link_ble_radio::{ChannelOptions, RadioError, Security};

use super::errors::dbus_error;

/// Passkey of each adapter.
static PASSKEYS: Lock<BTreeMap<String, u32>> = Lock::new(BTreeMap::new());

/// Pairing agent of a radio. BlueZ does not pair without one.
#[derive(Default)]
pub(super) struct Pairing(Mutex<Option<Registered>>);

struct Registered {
    enters_passkey: bool,
    /// Epoch of the radio at the registration. A restarted bluetoothd has lost the agent.
    epoch: u64,
    _handle: AgentHandle,
}

impl Pairing {
    /// Registers an agent if the kernel may pair for these options and no suitable agent is registered. `epoch` is the
    /// radio's current epoch.
    pub(super) async fn prepare(
        &self,
        session: &Session,
        adapter: &str,
        epoch: u64,
        options: &ChannelOptions,
    ) -> Result<(), RadioError> {
        let enters_passkey = match options.security {
            Security::Low => return Ok(()),
            Security::Medium => false,
            Security::High => true,
        };
        if let Some(passkey) = options.passkey {
            PASSKEYS.lock().insert(adapter.to_owned(), passkey);
        }
        let mut registered = self.0.lock().await;
        // An agent that enters passkeys also stays registered for `medium`: it is still needed for `high`.
        let is_sufficient = |registered: &Registered| {
            registered.epoch == epoch && registered.enters_passkey >= enters_passkey
        };
        if registered.as_ref().is_some_and(is_sufficient) {
            return Ok(());
        }
        *registered = None;
        let agent = if enters_passkey {
            passkey_agent()
        } else {
            confirmation_agent()
        };
        let handle = session.register_agent(agent).await;
        *registered = Some(Registered {
            enters_passkey,
            epoch,
            _handle: handle.map_err(dbus_error("register a pairing agent"))?,
        });
        Ok(())
    }
}

/// Returns an agent that confirms every pairing, because nobody can compare the two numbers on a headless robot. Used
/// for `medium`, which protects against eavesdropping, but not against an impostor during pairing.
fn confirmation_agent() -> Agent {
    Agent {
        request_default: true,
        request_confirmation: Some(Box::new(|_| Box::pin(async { Ok(()) }))),
        request_authorization: Some(Box::new(|request| {
            tracing::info!(
                "ble: {} is pairing with {}",
                request.adapter,
                request.device
            );
            Box::pin(async { Ok(()) })
        })),
        ..Default::default()
    }
}

/// Returns an agent that enters the passkey, for `high`. It declares no other capability, so that the kernel uses no
/// other pairing method: if both sides have only a keyboard, both enter the passkey.
fn passkey_agent() -> Agent {
    Agent {
        request_default: true,
        request_passkey: Some(Box::new(|request| {
            tracing::info!(
                "ble: {} is pairing with {}",
                request.adapter,
                request.device
            );
            let passkey = PASSKEYS.lock().get(&request.adapter).copied();
            // An adapter without a passkey is not used by this process, but by another one.
            Box::pin(async move { passkey.ok_or(ReqError::Rejected) })
        })),
        ..Default::default()
    }
}
