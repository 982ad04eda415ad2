//! Wraps a link manager so that the links that it dials succeed each other.
use async_trait::async_trait;
use zenoh_link_commons::{LinkManagerUnicast, LinkManagerUnicastTrait, LinkUnicast};
use zenoh_protocol::core::{EndPoint, Locator};
use zenoh_result::ZResult;

use super::SucceedingLink;

/// A link manager whose dialled links wait for their predecessors.
pub(super) struct SucceedingManager(pub(super) LinkManagerUnicast);

#[async_trait]
impl LinkManagerUnicastTrait for SucceedingManager {
    async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
        self.0.new_link(endpoint).await.map(SucceedingLink::wrap)
    }

    async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
        self.0.new_listener(endpoint).await
    }

    async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
        self.0.del_listener(endpoint).await
    }

    async fn get_listeners(&self) -> Vec<EndPoint> {
        self.0.get_listeners().await
    }

    async fn get_locators(&self) -> Vec<Locator> {
        self.0.get_locators().await
    }

    async fn get_locators_noloopback(&self) -> Vec<Locator> {
        self.0.get_locators_noloopback().await
    }
}
