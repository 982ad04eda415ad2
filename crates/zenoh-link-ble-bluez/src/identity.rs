//! Keeps track of which system adapter is used. The first lookup selects the adapter by the requested name; later
//! lookups select it by its address, because the kernel renumbers adapters when they are reset or plugged in again.
use bluer::{Adapter, Address, Session};
use parking_lot::Mutex;

pub(super) struct Identity {
    /// Name as the user wrote it.
    requested_name: String,
    current: Mutex<Current>,
}

struct Current {
    name: String,
    /// Address of the first adapter found.
    address: Option<Address>,
    /// Number of times the adapter was found under another name.
    renames: u64,
}

impl Identity {
    pub(super) fn new(requested_name: &str) -> Self {
        Self {
            requested_name: requested_name.to_owned(),
            current: Mutex::new(Current {
                name: requested_name.to_owned(),
                address: None,
                renames: 0,
            }),
        }
    }

    pub(super) fn requested_name(&self) -> &str {
        &self.requested_name
    }

    /// Returns the name under which the adapter was last found.
    pub(super) fn name(&self) -> String {
        self.current.lock().name.clone()
    }

    pub(super) fn renames(&self) -> u64 {
        self.current.lock().renames
    }

    /// Returns the adapter.
    ///
    /// # Errors
    /// Fails if the adapter is missing.
    pub(super) async fn find(&self, session: &Session) -> bluer::Result<Adapter> {
        if let Some(adapter) = self.check(session, &self.name()).await {
            return Ok(adapter);
        }
        for name in session.adapter_names().await? {
            if let Some(adapter) = self.check(session, &name).await {
                return Ok(adapter);
            }
        }
        // A different dongle that replaced the adapter has the requested name, but another address.
        let adapter = session.adapter(&self.requested_name)?;
        self.on_found(&self.requested_name, adapter.address().await?);
        Ok(adapter)
    }

    /// Returns the adapter of that name if it is the selected one.
    async fn check(&self, session: &Session, name: &str) -> Option<Adapter> {
        let adapter = session.adapter(name).ok()?;
        let address = adapter.address().await.ok()?;
        let is_same = match self.current.lock().address {
            Some(known) => known == address,
            None => name == self.requested_name,
        };
        is_same.then(|| {
            self.on_found(name, address);
            adapter
        })
    }

    fn on_found(&self, name: &str, address: Address) {
        let mut current = self.current.lock();
        current.address.get_or_insert(address);
        if current.name != name {
            tracing::info!("ble: {} is now {name}", current.name);
            name.clone_into(&mut current.name);
            current.renames += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_renames_and_keeps_the_first_address() {
        let identity = Identity::new("hci0");
        let (first, other) = (Address([1; 6]), Address([2; 6]));
        identity.on_found("hci0", first);
        assert_eq!((identity.name().as_str(), identity.renames()), ("hci0", 0));
        identity.on_found("hci1", first);
        assert_eq!((identity.name().as_str(), identity.renames()), ("hci1", 1));
        identity.on_found("hci0", other);
        assert_eq!(identity.current.lock().address, Some(first));
        assert_eq!((identity.requested_name(), identity.renames()), ("hci0", 2));
    }
}
