//! Turns the table of links (in `lib.rs`) into the types and functions by which Zenoh finds a link.
//!
//! Owns the dispatch and nothing else: what a link does is its own crate's business. A row reads
//!
//! ```text
//! #[cfg(feature = "transport_x")]                      // the row exists only when this holds
//! Kind: crate_of_the_link as module, PREFIX, Inspector, Manager
//!     [, config Configurator]                          // the link takes settings from Zenoh's config file
//!     [, only reliable | best_effort, else "feature"]  // it takes only such locators; who takes the others
//!     ;
//! ```
//!
//! and for one prefix the first row that takes the locator wins, so `quic/` can be two links.

macro_rules! link_table {
    ($(
        $(#[$cfg:meta])*
        $kind:ident: $krate:ident as $module:ident, $prefix:ident, $inspector:ident, $manager:ident
        $(, config $configurator:ident)?
        $(, only $reliability:ident, else $other_feature:literal)?
        ;
    )+) => {
        $( $(#[$cfg])* pub use $krate as $module; )+

        /// The links of this build, most wanted first.
        pub const ALL_SUPPORTED_LINKS: &[LinkKind] = &[$( $(#[$cfg])* LinkKind::$kind, )+];

        impl LinkKind {
            /// The links of this build that speak one of `protocols`; a name that no link has is passed over.
            pub fn new_supported_links<'p>(protocols: impl Iterator<Item = &'p str>) -> Vec<LinkKind> {
                let mut kinds = Vec::new();
                for protocol in protocols {
                    $( $(#[$cfg])* if protocol == $krate::$prefix { kinds.push(LinkKind::$kind); } )+
                }
                kinds
            }
        }

        impl TryFrom<&Locator> for LinkKind {
            type Error = Error;

            fn try_from(locator: &Locator) -> ZResult<Self> {
                let protocol = locator.protocol();
                let mut missing_feature = None;
                $( $(#[$cfg])* if protocol.as_str() == $krate::$prefix {
                    match link_table!(@refusal $krate, $inspector, locator $(, $reliability, $other_feature)?) {
                        None => return Ok(LinkKind::$kind),
                        Some(feature) => missing_feature = Some(feature),
                    }
                } )+
                match missing_feature {
                    Some(feature) => bail!("{locator}: a link of this reliability needs a build with the feature {feature}"),
                    None => bail!("Unicast not supported for {protocol} protocol"),
                }
            }
        }

        impl LocatorInspector {
            /// Whether the link that this locator names delivers everything, in order.
            pub fn is_reliable(&self, locator: &Locator) -> ZResult<bool> {
                match LinkKind::try_from(locator)? {
                    $( $(#[$cfg])* LinkKind::$kind => $krate::$inspector.is_reliable(locator), )+
                    #[allow(unreachable_patterns)] // no row is switched off when every feature is on
                    kind => not_in_this_build(kind),
                }
            }

            /// Whether this locator names a group rather than a peer.
            pub async fn is_multicast(&self, locator: &Locator) -> ZResult<bool> {
                match LinkKind::try_from(locator)? {
                    $( $(#[$cfg])* LinkKind::$kind => $krate::$inspector.is_multicast(locator).await, )+
                    #[allow(unreachable_patterns)]
                    kind => not_in_this_build(kind),
                }
            }
        }

        impl LinkConfigurator {
            /// What each link takes out of Zenoh's config, and what is wrong with it there.
            #[allow(unused_mut, unused_variables)] // in a build whose links take nothing
            pub fn configurations(&self, config: &Config) -> (HashMap<LinkKind, String>, HashMap<LinkKind, Error>) {
                let mut read = HashMap::new();
                let mut wrong = HashMap::new();
                $( $(#[$cfg])* { $(
                    match $krate::$configurator.inspect_config(config) {
                        Ok(settings) => drop(read.insert(LinkKind::$kind, settings)),
                        Err(error) => drop(wrong.insert(LinkKind::$kind, error)),
                    }
                )? } )+
                (read, wrong)
            }
        }

        impl LinkManagerBuilderUnicast {
            /// The manager of the link that `endpoint` names; the links that it accepts go to `new_links`.
            pub fn make(new_links: NewLinkChannelSender, endpoint: &EndPoint) -> ZResult<LinkManagerUnicast> {
                let kind = LinkKind::try_from(endpoint)?;
                let new_links = match kind {
                    // The radio bounds its links itself, and they must find a place when all others are taken.
                    LinkKind::Ble | LinkKind::Slot => new_links,
                    _ => crate::admission::gated(new_links),
                };
                match kind {
                    $( $(#[$cfg])* LinkKind::$kind => Ok(Arc::new($krate::$manager::new(new_links))), )+
                    #[allow(unreachable_patterns)]
                    kind => not_in_this_build(kind),
                }
            }
        }
    };

    // Why a row does not take a locator of its prefix: the feature that has the link which would.
    (@refusal $krate:ident, $inspector:ident, $locator:ident) => {
        None::<&str>
    };
    (@refusal $krate:ident, $inspector:ident, $locator:ident, reliable, $other:literal) => {
        (!$krate::$inspector.is_reliable($locator)?).then_some($other)
    };
    (@refusal $krate:ident, $inspector:ident, $locator:ident, best_effort, $other:literal) => {
        $krate::$inspector.is_reliable($locator)?.then_some($other)
    };
}
