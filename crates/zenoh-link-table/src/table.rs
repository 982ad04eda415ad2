//! Expands the table of links (in `lib.rs`) into the types and functions by which Zenoh selects a link.
//!
//! It only dispatches; each link is implemented in its own crate. A locator whose prefix has no row belongs to a registered link. A row has the form
//!
//! ```text
//! #[cfg(feature = "transport_x")]                      // the row exists only when this holds
//! Kind: crate_of_the_link as module, PREFIX, Inspector, Manager
//!     [, config Configurator]                          // the link reads settings from Zenoh's config
//!     [, only reliable | best_effort, else "feature"]  // it accepts only such locators; others need this feature
//!     ;
//! ```
//!
//! If several rows have the same prefix, the first one that accepts the locator is used. `quic/` can therefore be two
//! links.

macro_rules! link_table {
    ($(
        $(#[$cfg:meta])*
        $kind:ident: $krate:ident as $module:ident, $prefix:ident, $inspector:ident, $manager:ident
        $(, config $configurator:ident)?
        $(, only $reliability:ident, else $other_feature:literal)?
        ;
    )+) => {
        $( $(#[$cfg])* pub use $krate as $module; )+

        /// Links of this build, in order of preference.
        pub const ALL_SUPPORTED_LINKS: &[LinkKind] = &[$( $(#[$cfg])* LinkKind::$kind, )+ LinkKind::Registered];

        impl LinkKind {
            /// Returns the links of this build for the given protocols. Unknown names are ignored. All registered links are
            /// one kind, so the name of one of them permits all of them.
            pub fn new_supported_links<'p>(protocols: impl Iterator<Item = &'p str>) -> Vec<LinkKind> {
                let mut kinds = Vec::new();
                for protocol in protocols {
                    $( $(#[$cfg])* if protocol == $krate::$prefix { kinds.push(LinkKind::$kind); } )+
                    if $crate::registry::find(protocol).is_some() && !kinds.contains(&LinkKind::Registered) {
                        kinds.push(LinkKind::Registered);
                    }
                }
                kinds
            }
        }

        impl TryFrom<&Locator> for LinkKind {
            type Error = Error;

            fn try_from(locator: &Locator) -> ZResult<Self> {
                let protocol = locator.protocol();
                #[allow(unused_mut)] // in a build without any of Zenoh's links
                let mut missing_feature: Option<&str> = None;
                $( $(#[$cfg])* if protocol.as_str() == $krate::$prefix {
                    match link_table!(@refusal $krate, $inspector, locator $(, $reliability, $other_feature)?) {
                        None => return Ok(LinkKind::$kind),
                        Some(feature) => missing_feature = Some(feature),
                    }
                } )+
                if let Some(feature) = missing_feature {
                    bail!("{locator}: a link of this reliability needs a build with the feature {feature}");
                }
                $crate::registry::require(protocol.as_str()).map(|_| LinkKind::Registered)
            }
        }

        impl LocatorInspector {
            /// Returns whether the link of this locator is reliable and ordered.
            ///
            /// # Errors
            /// Fails if this build has no link for the locator.
            pub fn is_reliable(&self, locator: &Locator) -> ZResult<bool> {
                match LinkKind::try_from(locator)? {
                    $( $(#[$cfg])* LinkKind::$kind => $krate::$inspector.is_reliable(locator), )+
                    LinkKind::Registered => Ok($crate::registry::require(locator.protocol().as_str())?.is_reliable),
                    #[allow(unreachable_patterns)] // unreachable if all features are enabled
                    kind => not_in_this_build(kind),
                }
            }

            /// Returns whether this locator names a multicast group.
            ///
            /// # Errors
            /// Fails if this build has no link for the locator.
            pub async fn is_multicast(&self, locator: &Locator) -> ZResult<bool> {
                match LinkKind::try_from(locator)? {
                    $( $(#[$cfg])* LinkKind::$kind => $krate::$inspector.is_multicast(locator).await, )+
                    LinkKind::Registered => Ok(false),
                    #[allow(unreachable_patterns)]
                    kind => not_in_this_build(kind),
                }
            }
        }

        impl LinkConfigurator {
            /// Returns the settings of each link in Zenoh's config, and the errors of links with invalid settings.
            #[allow(unused_mut, unused_variables)] // in a build whose links have no settings
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
            /// Creates the manager of the link that `endpoint` names. It sends accepted links to `new_links`.
            ///
            /// # Errors
            /// Fails if this build has no link for the endpoint.
            pub fn make(new_links: NewLinkChannelSender, endpoint: &EndPoint) -> ZResult<LinkManagerUnicast> {
                match LinkKind::try_from(endpoint)? {
                    $( $(#[$cfg])* LinkKind::$kind => {
                        let new_links = $crate::admission::gated($crate::succession::accepting(new_links));
                        Ok($crate::succession::dialling(std::sync::Arc::new($krate::$manager::new(new_links))))
                    } )+
                    LinkKind::Registered => {
                        let link = $crate::registry::require(endpoint.protocol().as_str())?;
                        Ok(link.manager(new_links))
                    }
                    #[allow(unreachable_patterns)]
                    kind => not_in_this_build(kind),
                }
            }
        }
    };

    // Returns the feature of the other link if a row does not accept a locator of its prefix.
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
