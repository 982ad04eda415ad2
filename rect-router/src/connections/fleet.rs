//! Owns connecting to whoever of the fleet is heard by Bluetooth: by what rule, and to how many.
use std::sync::Arc;

use async_trait::async_trait;
use parking_lot::Mutex;
use zenoh_link::{EndPoint, LinkUnicast, NewLinkChannelSender};
use zenoh_link_slot::{Dial, Slots};
use zenoh_result::ZResult;

use super::connection::link;
use crate::config::{AutoConnect, Rule};

/// As many dials to anyone of the fleet as the rule says.
pub struct Fleet {
    slots: Arc<Slots>,
    anyone: Arc<Anyone>,
    rule: Mutex<Rule>,
}

struct Anyone(EndPoint);

#[async_trait]
impl Dial for Anyone {
    async fn dial(&self, links: &NewLinkChannelSender) -> ZResult<LinkUnicast> {
        link(links, &self.0).await
    }
}

impl Fleet {
    /// Dials nobody yet, and at most so many.
    pub fn new(name: &str, most: usize) -> ZResult<Arc<Self>> {
        let nobody = Rule {
            auto_connect: AutoConnect::None,
            auto_links: most,
        };
        Ok(Arc::new(Self {
            slots: Slots::new(most),
            anyone: Arc::new(Anyone(format!("ble/*#fleet={name}").parse()?)),
            rule: Mutex::new(nobody),
        }))
    }

    /// What Zenoh has to dial for it.
    pub fn endpoints(&self) -> impl Iterator<Item = String> + '_ {
        self.slots.endpoints()
    }

    /// Dials nobody any more; links that are there stay.
    pub fn close(&self) {
        self.slots.close();
    }

    /// The rule that holds.
    pub fn rule(&self) -> Rule {
        *self.rule.lock()
    }

    /// From now on that rule; tells whether it is another. Links that are there stay.
    pub fn follow(&self, rule: Rule) -> bool {
        let mut now = self.rule.lock();
        let (before, after) = (now.dials(), rule.dials());
        for slot in 0..self.slots.count() {
            if (slot < before) != (slot < after) {
                let anyone: Arc<dyn Dial> = self.anyone.clone();
                self.slots.set(slot, (slot < after).then_some(anyone));
            }
        }
        std::mem::replace(&mut *now, rule) != rule
    }
}
