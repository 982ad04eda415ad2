//! Keeps the links that a program adds to Zenoh's.
use std::sync::LazyLock;

use parking_lot::RwLock;
use zenoh_link_commons::{LinkManagerUnicast, NewLinkChannelSender};
use zenoh_result::{bail, ZResult};

use crate::{admission, succession};

/// The registered links of this process. A link is never removed, because Zenoh keeps link managers by their prefix.
static LINKS: LazyLock<RwLock<Vec<RegisteredLink>>> = LazyLock::new(|| RwLock::new(built_in()));

/// A link that a program adds to Zenoh's. Its links connect two peers; multicast is not supported.
#[derive(Clone, Copy, Debug)]
pub struct RegisteredLink {
    /// Prefix of its locators, such as `ble`.
    pub prefix: &'static str,
    /// Whether its links are reliable and ordered.
    pub is_reliable: bool,
    /// Whether accepted links pass the gate of [`admission`]. A link that limits its own accepted links does not need it.
    pub is_gated: bool,
    /// Whether its managers open links themselves, to which the rules of [`succession`] apply. A link that is opened by the manager of
    /// another one is subject to them already.
    pub opens_links: bool,
    /// Creates a link manager, which sends accepted links to the channel.
    pub make: fn(NewLinkChannelSender) -> LinkManagerUnicast,
}

impl RegisteredLink {
    /// Creates a link manager, which sends accepted links to `new_links`, through the gate if it applies to this link.
    pub(crate) fn manager(&self, new_links: NewLinkChannelSender) -> LinkManagerUnicast {
        if !self.opens_links {
            return (self.make)(new_links);
        }
        let new_links = succession::accepting(new_links);
        succession::dialling((self.make)(match self.is_gated {
            true => admission::gated(new_links),
            false => new_links,
        }))
    }
}

/// Adds a link, by which Zenoh then opens locators with its prefix. Must be called before `zenoh::open`.
///
/// If a link of that prefix is registered already, the call has no effect. Zenoh's own links take precedence over a registered
/// one of the same prefix.
pub fn register(link: RegisteredLink) {
    let mut links = LINKS.write();
    if !links.iter().any(|other| other.prefix == link.prefix) {
        links.push(link);
    }
}

/// Returns the registered link of that prefix.
pub(crate) fn find(prefix: &str) -> Option<RegisteredLink> {
    let links = LINKS.read();
    links.iter().find(|link| link.prefix == prefix).copied()
}

/// Returns the registered link of that prefix.
///
/// # Errors
/// Fails if there is none.
pub(crate) fn require(prefix: &str) -> ZResult<RegisteredLink> {
    let links = LINKS.read();
    match links.iter().find(|link| link.prefix == prefix) {
        Some(link) => Ok(*link),
        None => bail!("{}", unknown(prefix, links.is_empty())),
    }
}

/// Returns the error of a prefix that no link has: that of the published crate, with advice if the program has registered no
/// links at all.
fn unknown(prefix: &str, is_nothing_registered: bool) -> String {
    let error = format!("Unicast not supported for {prefix} protocol");
    match is_nothing_registered {
        true => format!(
            "{error}: this program has not registered a link for {prefix}/. Call zenoh_link_table::register (for RECT's links, \
             rect_links::register) before Zenoh is opened"
        ),
        false => error,
    }
}

/// Returns the links that are registered from the start.
fn built_in() -> Vec<RegisteredLink> {
    vec![
        #[cfg(feature = "ble")]
        RegisteredLink {
            prefix: zenoh_link_ble::BLE_LOCATOR_PREFIX,
            is_reliable: true,
            // The radio limits its links itself; they must be accepted even if all other sessions are in use.
            is_gated: false,
            opens_links: true,
            make: |new_links| {
                std::sync::Arc::new(zenoh_link_ble::LinkManagerUnicastBle::new(new_links))
            },
        },
    ]
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use async_trait::async_trait;
    use zenoh_link_commons::{LinkManagerUnicastTrait, LinkUnicast};
    use zenoh_protocol::core::{EndPoint, Locator};

    use super::*;
    use crate::{LinkKind, LinkManagerBuilderUnicast, LocatorInspector, ALL_SUPPORTED_LINKS};

    /// A manager that opens no links, and names itself by its listener.
    struct Pigeons(&'static str);

    #[async_trait]
    impl LinkManagerUnicastTrait for Pigeons {
        async fn new_link(&self, endpoint: EndPoint) -> ZResult<LinkUnicast> {
            bail!("{endpoint}: no pigeon")
        }
        async fn new_listener(&self, endpoint: EndPoint) -> ZResult<Locator> {
            bail!("{endpoint}: no pigeon")
        }
        async fn del_listener(&self, endpoint: &EndPoint) -> ZResult<()> {
            bail!("{endpoint}: no pigeon")
        }
        async fn get_listeners(&self) -> Vec<EndPoint> {
            vec![self.0.parse().expect("an endpoint")]
        }
        async fn get_locators(&self) -> Vec<Locator> {
            Vec::new()
        }
        async fn get_locators_noloopback(&self) -> Vec<Locator> {
            Vec::new()
        }
    }

    fn link(prefix: &'static str) -> RegisteredLink {
        RegisteredLink {
            prefix,
            is_reliable: true,
            is_gated: false,
            opens_links: true,
            make: |_| Arc::new(Pigeons("pigeon/first")),
        }
    }

    fn locator(text: &str) -> Locator {
        text.parse().expect("a locator")
    }

    #[test]
    fn unknown_prefix_is_an_error() {
        let error = LinkKind::try_from(&locator("parrot/home")).expect_err("no link");
        let error = error.to_string();
        assert!(
            error.contains("Unicast not supported for parrot protocol"),
            "{error}"
        );
        assert!(LocatorInspector
            .is_reliable(&locator("parrot/home"))
            .is_err());
    }

    #[test]
    fn error_says_what_to_do_if_nothing_is_registered() {
        let error = unknown("ble", true);
        assert!(error.starts_with("Unicast not supported for ble protocol: this program has not registered a link for ble/."));
        assert!(error.contains("rect_links::register"), "{error}");
        assert_eq!(
            unknown("parrot", false),
            "Unicast not supported for parrot protocol"
        );
    }

    #[tokio::test]
    async fn registered_link_is_used_for_its_prefix() {
        register(link("pigeon"));
        register(RegisteredLink {
            is_reliable: false,
            ..link("swift")
        });
        let home = locator("pigeon/home");
        assert_eq!(
            LinkKind::try_from(&home).expect("a link"),
            LinkKind::Registered
        );
        assert!(ALL_SUPPORTED_LINKS.contains(&LinkKind::Registered));
        assert!(LocatorInspector.is_reliable(&home).expect("a link"));
        assert!(!LocatorInspector
            .is_reliable(&locator("swift/home"))
            .expect("a link"));
        assert!(!LocatorInspector.is_multicast(&home).await.expect("a link"));
        let (new_links, _) = flume::unbounded();
        let manager = LinkManagerBuilderUnicast::make(new_links, &home.to_endpoint());
        let listeners = manager.expect("a manager").get_listeners().await;
        assert_eq!(listeners, ["pigeon/first".parse().expect("an endpoint")]);
    }

    #[tokio::test]
    async fn second_registration_of_a_prefix_has_no_effect() {
        register(link("stork"));
        register(RegisteredLink {
            is_reliable: false,
            make: |_| Arc::new(Pigeons("stork/second")),
            ..link("stork")
        });
        let stork = find("stork").expect("registered");
        assert!(stork.is_reliable);
        let (new_links, _) = flume::unbounded();
        let listeners = stork.manager(new_links).get_listeners().await;
        assert_eq!(listeners, ["pigeon/first".parse().expect("an endpoint")]);
    }

    #[test]
    fn setting_of_protocols_permits_registered_links_once() {
        register(link("robin"));
        register(link("wren"));
        let kinds = LinkKind::new_supported_links(["robin", "owl", "wren"].into_iter());
        assert_eq!(kinds, [LinkKind::Registered]);
    }

    #[test]
    fn no_link_of_ours_is_registered_by_default() {
        for prefix in ["ble", "any", "placeholder"] {
            assert_eq!(
                find(prefix).is_some(),
                prefix == "ble" && cfg!(feature = "ble"),
                "{prefix}"
            );
        }
    }
}
