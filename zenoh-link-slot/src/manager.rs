//! Owns what Zenoh calls: the link manager of the `slot` protocol.
use async_trait::async_trait;
use zenoh_link_commons::{
    LinkManagerUnicastTrait, LinkUnicast, LocatorInspector, NewLinkChannelSender,
};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::{bail, zerror, ZResult};

use crate::{slots::Slots, SLOT_LOCATOR_PREFIX};

/// Tells Zenoh what kind of link a slot is; the link itself says more once it is there.
#[derive(Clone, Copy, Debug, Default)]
pub struct SlotLocatorInspector;

#[async_trait]
impl LocatorInspector for SlotLocatorInspector {
    fn protocol(&self) -> &str {
        SLOT_LOCATOR_PREFIX
    }

    async fn is_multicast(&self, _locator: &Locator) -> ZResult<bool> {
        Ok(false)
    }

    fn is_reliable(&self, _locator: &Locator) -> ZResult<bool> {
        Ok(true)
    }
}

/// Makes the links of slots. There is nothing to listen on.
#[derive(Debug)]
pub struct LinkManagerUnicastSlot {
    links: NewLinkChannelSender,
}

impl LinkManagerUnicastSlot {
    /// As Zenoh makes it.
    pub fn new(links: NewLinkChannelSender) -> Self {
        Self { links }
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastSlot {
    /// Waits until something is in the slot and dials it.
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        let Some(mut slot) = Slots::of_address(endpoint.address().as_str()) else {
            bail!("there is no {endpoint}");
        };
        let dial = {
            let filled = slot.wait_for(Option::is_some).await;
            filled
                .map_err(|_| zerror!("{endpoint} is no more"))?
                .clone()
        };
        let Some(dial) = dial else {
            bail!("{endpoint} is empty");
        };
        tokio::select! {
            link = dial.dial(&self.links) => link,
            _ = slot.changed() => bail!("{endpoint} was changed"),
        }
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        bail!("{endpoint}: a slot is dialled only, nobody listens on one")
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        bail!("{endpoint}: there is no such listener")
    }

    async fn get_listeners(&self) -> Vec<EndPoint> {
        Vec::new()
    }

    async fn get_locators(&self) -> Vec<Locator> {
        Vec::new()
    }

    async fn get_locators_noloopback(&self) -> Vec<Locator> {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use std::{
        sync::{
            atomic::{AtomicUsize, Ordering},
            Arc,
        },
        time::Duration,
    };

    use super::*;
    use crate::Dial;

    /// Never links; counts who asked.
    #[derive(Default)]
    struct Busy(AtomicUsize);

    #[async_trait]
    impl Dial for Busy {
        async fn dial(&self, _links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
            self.0.fetch_add(1, Ordering::Relaxed);
            std::future::pending().await
        }
    }

    fn dialling(
        endpoint: &str,
    ) -> tokio::task::JoinHandle<Result<ZResult<LinkUnicast>, tokio::time::error::Elapsed>> {
        let endpoint = endpoint.parse().expect("an endpoint");
        tokio::spawn(tokio::time::timeout(Duration::from_secs(10), async move {
            let (links, _) = flume::unbounded();
            LinkManagerUnicastSlot::new(links).new_link(endpoint).await
        }))
    }

    #[tokio::test(start_paused = true)]
    async fn an_empty_slot_is_waited_for_and_a_changed_one_given_up() {
        let slots = Slots::new(2);
        let endpoints: Vec<_> = slots.endpoints().collect();
        let first = dialling(&endpoints[0]);
        tokio::time::sleep(Duration::from_secs(5)).await;
        let busy = Arc::new(Busy::default());
        slots.set(0, Some(busy.clone()));
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(busy.0.load(Ordering::Relaxed), 1);
        slots.set(0, None);
        let error = first.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("changed")));
        // The other one is still empty when Zenoh gives up.
        assert!(dialling(&endpoints[1]).await.expect("no panic").is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn a_slot_that_is_closed_or_not_there_is_an_error() {
        let slots = Slots::new(2);
        let endpoints: Vec<_> = slots.endpoints().collect();
        slots.set(1, Some(Arc::new(Busy::default())));
        let (waiting, busy) = (dialling(&endpoints[0]), dialling(&endpoints[1]));
        tokio::time::sleep(Duration::from_secs(1)).await;
        slots.close();
        let error = waiting.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("no more")));
        let error = busy.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("changed")));
        slots.set(0, Some(Arc::new(Busy::default())));
        let endpoint = endpoints[0].clone();
        for nowhere in [endpoint.as_str(), "slot/x", "slot/0", "slot/0.99"] {
            let answer = dialling(nowhere).await.expect("no panic").expect("in time");
            assert!(answer.is_err_and(|e| e.to_string().contains("there is no")));
        }
    }
}
