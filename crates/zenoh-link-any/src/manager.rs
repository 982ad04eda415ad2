//! Implements Zenoh's link manager of the `any` protocol.
use std::{collections::HashMap, sync::Arc};

use async_trait::async_trait;
use tokio::sync::Mutex;
use zenoh_link_ble::locator::is_simulated;
use zenoh_link_commons::{LinkManagerUnicastTrait, LinkUnicast, NewLinkChannelSender};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::ZResult;

use crate::{
    error::AnyError,
    hub::Hub,
    locator::{ConnectLocator, ListenLocator, ANY_LOCATOR_PREFIX},
};

/// Dials and accepts `any` links for one Zenoh runtime.
pub struct LinkManagerUnicastAny {
    hub: Arc<Hub>,
    /// The listeners by their endpoint, with the locator that a peer can dial and the endpoint of their Bluetooth listener.
    listeners: Mutex<HashMap<EndPoint, (Locator, EndPoint)>>,
}

impl LinkManagerUnicastAny {
    /// Creates a manager. Accepted links are sent on `links`. Managers with the same channel belong to one Zenoh runtime.
    pub fn new(links: NewLinkChannelSender) -> Self {
        Self {
            hub: Hub::of(links),
            listeners: Mutex::default(),
        }
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastAny {
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        let locator = ConnectLocator::parse(&endpoint).map_err(AnyError::from)?;
        Ok(self.hub.open(locator).await?)
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        let locator = ListenLocator::parse(&endpoint).map_err(AnyError::from)?;
        let mut listeners = self.listeners.lock().await;
        // Without a secret, nobody could prove that a connection belongs to a link.
        let has_secret = locator.ble.config().get("secret").is_some();
        if has_secret && !self.hub.is_listening() {
            let is_simulated = is_simulated(locator.ble.address().as_str());
            (self.hub).listen(locator.port, locator.interfaces, is_simulated)?;
        }
        self.hub.accept_bluetooth();
        let bluetooth = self.hub.ble.new_listener(locator.ble.clone()).await?;
        let name = bluetooth.address().as_str().to_owned();
        let dialable = Locator::new(ANY_LOCATOR_PREFIX, name, "")?;
        listeners.insert(endpoint, (dialable.clone(), locator.ble));
        Ok(dialable)
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        let mut listeners = self.listeners.lock().await;
        if let Some((_, bluetooth)) = listeners.remove(endpoint) {
            if listeners.is_empty() {
                self.hub.stop_listening();
            }
            return self.hub.ble.del_listener(&bluetooth).await;
        }
        Ok(())
    }

    async fn get_listeners(&self) -> Vec<EndPoint> {
        self.listeners.lock().await.keys().cloned().collect()
    }

    async fn get_locators(&self) -> Vec<Locator> {
        let listeners = self.listeners.lock().await;
        listeners
            .values()
            .map(|(locator, _)| locator.clone())
            .collect()
    }

    async fn get_locators_noloopback(&self) -> Vec<Locator> {
        self.get_locators().await
    }
}
