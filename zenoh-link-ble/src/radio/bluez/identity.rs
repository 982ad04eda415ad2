//! Owns which of the system's adapters is meant: the one of the name given, and from then on the one of its address, as
//! the kernel numbers adapters anew when they are reset or plugged in again.
use bluer::{Adapter, Address, Session};
use parking_lot::Mutex;

pub(super) struct Identity {
    /// As the user wrote it.
    given: String,
    now: Mutex<Now>,
}

struct Now {
    name: String,
    /// The address of the first adapter found.
    address: Option<Address>,
    /// Counts how often the adapter was found under another name.
    moves: u64,
}

impl Identity {
    pub(super) fn new(given: &str) -> Self {
        Self {
            given: given.to_owned(),
            now: Mutex::new(Now {
                name: given.to_owned(),
                address: None,
                moves: 0,
            }),
        }
    }

    pub(super) fn given(&self) -> &str {
        &self.given
    }

    /// The name it was last seen under.
    pub(super) fn name(&self) -> String {
        self.now.lock().name.clone()
    }

    pub(super) fn moves(&self) -> u64 {
        self.now.lock().moves
    }

    /// The adapter; an error where it is missing.
    pub(super) async fn find(&self, session: &Session) -> bluer::Result<Adapter> {
        if let Some(adapter) = self.check(session, &self.name()).await {
            return Ok(adapter);
        }
        for name in session.adapter_names().await? {
            if let Some(adapter) = self.check(session, &name).await {
                return Ok(adapter);
            }
        }
        // Another dongle in its place has its name and an address of its own.
        let adapter = session.adapter(&self.given)?;
        self.found(&self.given, adapter.address().await?);
        Ok(adapter)
    }

    /// The adapter of that name, if it is the one meant.
    async fn check(&self, session: &Session, name: &str) -> Option<Adapter> {
        let adapter = session.adapter(name).ok()?;
        let address = adapter.address().await.ok()?;
        let is_it = match self.now.lock().address {
            Some(known) => known == address,
            None => name == self.given,
        };
        is_it.then(|| {
            self.found(name, address);
            adapter
        })
    }

    fn found(&self, name: &str, address: Address) {
        let mut now = self.now.lock();
        now.address.get_or_insert(address);
        if now.name != name {
            tracing::info!("ble: {} is {name} now", now.name);
            name.clone_into(&mut now.name);
            now.moves += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_new_name_counts_and_the_first_address_stays() {
        let identity = Identity::new("hci0");
        let (first, other) = (Address([1; 6]), Address([2; 6]));
        identity.found("hci0", first);
        assert_eq!((identity.name().as_str(), identity.moves()), ("hci0", 0));
        identity.found("hci1", first);
        assert_eq!((identity.name().as_str(), identity.moves()), ("hci1", 1));
        identity.found("hci0", other);
        assert_eq!(identity.now.lock().address, Some(first));
        assert_eq!((identity.given(), identity.moves()), ("hci0", 2));
    }
}
