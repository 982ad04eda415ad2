//! Dials robots of the fleet that are discovered by Bluetooth, as many as the rule for automatic connections allows.
use std::sync::Arc;

use async_trait::async_trait;
use parking_lot::Mutex;
use rect_connections::{AutoConnect, AutoConnectRule};
use zenoh_link_placeholder::{Dial, Placeholders};
use zenoh_link_table::{EndPoint, LinkUnicast, NewLinkChannelSender};
use zenoh_result::ZResult;

use super::connection::link;

/// Keeps a number of dials to discovered robots of the fleet open.
pub struct FleetConnector {
    placeholders: Arc<Placeholders>,
    any_robot: Arc<AnyFleetRobot>,
    rule: Mutex<AutoConnectRule>,
}

/// Dials any discovered robot of the fleet, by a `ble/*#fleet=` endpoint.
struct AnyFleetRobot(EndPoint);

#[async_trait]
impl Dial for AnyFleetRobot {
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
        link(links, &self.0).await
    }
}

impl FleetConnector {
    /// Creates a connector for the fleet `name` with at most `max_links` dials. It dials no robot until a rule is applied.
    ///
    /// # Errors
    /// Fails if the name cannot be part of a locator.
    pub fn new(name: &str, max_links: usize) -> ZResult<Arc<Self>> {
        let none = AutoConnectRule {
            auto_connect: AutoConnect::None,
            auto_links: max_links,
        };
        Ok(Arc::new(Self {
            placeholders: Placeholders::new(max_links),
            any_robot: Arc::new(AnyFleetRobot(format!("any/*#fleet={name}").parse()?)),
            rule: Mutex::new(none),
        }))
    }

    /// Returns the placeholder endpoints that Zenoh has to dial.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        self.placeholders.endpoints()
    }

    /// Stops dialling; links that are open stay open.
    pub fn close(&self) {
        self.placeholders.close();
    }

    /// Returns the current rule.
    pub fn rule(&self) -> AutoConnectRule {
        *self.rule.lock()
    }

    /// Applies a rule, and returns whether it differs from the previous one. Links that are open stay open.
    pub fn apply_rule(&self, rule: AutoConnectRule) -> bool {
        let mut now = self.rule.lock();
        let (before, after) = (now.dials(), rule.dials());
        for placeholder in 0..self.placeholders.count() {
            if (placeholder < before) != (placeholder < after) {
                let any_robot: Arc<dyn Dial> = self.any_robot.clone();
                self.placeholders
                    .set(placeholder, (placeholder < after).then_some(any_robot));
            }
        }
        std::mem::replace(&mut *now, rule) != rule
    }
}
