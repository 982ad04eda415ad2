//! Implements the link manager of the `placeholder` protocol, which Zenoh calls.
use async_trait::async_trait;
use zenoh_link_commons::{LinkManagerUnicastTrait, LinkUnicast, NewLinkChannelSender};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::{bail, zerror, ZResult};

use crate::placeholders::Placeholders;

/// Opens the links of placeholders. Listening is not supported.
#[derive(Debug)]
pub struct LinkManagerUnicastPlaceholder {
    links: NewLinkChannelSender,
}

impl LinkManagerUnicastPlaceholder {
    /// Creates the manager, as Zenoh does for each dial; `links` is the channel on which the runtime receives new links.
    pub fn new(links: NewLinkChannelSender) -> Self {
        Self { links }
    }
}

#[async_trait]
impl LinkManagerUnicastTrait for LinkManagerUnicastPlaceholder {
    /// Waits until the placeholder is set, then dials its target.
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        let Some(mut placeholder) = Placeholders::of_address(endpoint.address().as_str()) else {
            bail!("{endpoint}: no such placeholder");
        };
        let dial = {
            let filled = placeholder.wait_for(Option::is_some).await;
            filled
                .map_err(|_| zerror!("{endpoint}: the placeholder was closed"))?
                .clone()
        };
        let Some(dial) = dial else {
            bail!("{endpoint}: the placeholder is empty");
        };
        tokio::select! {
            link = dial.dial(&self.links) => link,
            _ = placeholder.changed() => bail!("{endpoint}: the placeholder was changed or closed"),
        }
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        bail!("{endpoint}: a placeholder can only be dialled, not listened on")
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        bail!("{endpoint}: no such listener")
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

    /// Counts its attempts and never completes one.
    #[derive(Default)]
    struct PendingDial(AtomicUsize);

    #[async_trait]
    impl Dial for PendingDial {
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
            LinkManagerUnicastPlaceholder::new(links)
                .new_link(endpoint)
                .await
        }))
    }

    #[tokio::test(start_paused = true)]
    async fn waits_for_an_empty_placeholder_and_abandons_the_dial_when_it_changes() {
        let placeholders = Placeholders::new(2);
        let endpoints: Vec<_> = placeholders.endpoints().collect();
        let first = dialling(&endpoints[0]);
        tokio::time::sleep(Duration::from_secs(5)).await;
        let pending = Arc::new(PendingDial::default());
        placeholders.set(0, Some(pending.clone()));
        tokio::time::sleep(Duration::from_secs(1)).await;
        assert_eq!(pending.0.load(Ordering::Relaxed), 1);
        placeholders.set(0, None);
        let error = first.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("changed")));
        // The other placeholder is still empty when Zenoh abandons the dial.
        assert!(dialling(&endpoints[1]).await.expect("no panic").is_err());
    }

    #[tokio::test(start_paused = true)]
    async fn dialling_a_closed_or_unknown_placeholder_fails() {
        let placeholders = Placeholders::new(2);
        let endpoints: Vec<_> = placeholders.endpoints().collect();
        placeholders.set(1, Some(Arc::new(PendingDial::default())));
        let (waiting, pending) = (dialling(&endpoints[0]), dialling(&endpoints[1]));
        tokio::time::sleep(Duration::from_secs(1)).await;
        placeholders.close();
        let error = waiting.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("was closed")));
        let error = pending.await.expect("no panic").expect("in time").err();
        assert!(error.is_some_and(|e| e.to_string().contains("changed")));
        placeholders.set(0, Some(Arc::new(PendingDial::default())));
        let endpoint = endpoints[0].clone();
        for nowhere in [
            endpoint.as_str(),
            "placeholder/x",
            "placeholder/0",
            "placeholder/0.99",
        ] {
            let answer = dialling(nowhere).await.expect("no panic").expect("in time");
            assert!(answer.is_err_and(|e| e.to_string().contains("no such placeholder")));
        }
    }
}
