//! Parses the options of a locator, with a description of the valid values for each one.
use std::{ops::RangeInclusive, path::PathBuf, time::Duration};

use link_lanes::{hello::MIN_MTU, lanes::scheduler::Bounds};
use zenoh_link_ble_radio::{
    address::{AddressType, Psm},
    Security,
};
use zenoh_protocol::core::EndPoint;

use super::{
    is_adapter, is_name, LocatorError, Queueing, DEFAULT_CONNECT_TIMEOUT, DEFAULT_MAX_LINKS,
    DEFAULT_MTU, MAX_MTU,
};

/// The part of a locator after `#`: keys and values.
pub(super) struct Options<'a>(Vec<(&'a str, &'a str)>);

impl<'a> Options<'a> {
    pub(super) fn parse(
        endpoint: &'a EndPoint,
        side: &'static str,
        known: &[&str],
    ) -> Result<Self, LocatorError> {
        let mut options = Vec::new();
        let text = endpoint.config().as_str();
        for part in text.split(';').filter(|part| !part.is_empty()) {
            let (key, value) = part.split_once('=').unwrap_or((part, ""));
            if !known.contains(&key) {
                return Err(LocatorError::UnknownOption {
                    key: key.to_owned(),
                    side,
                    known: known.join(", "),
                });
            }
            options.push((key, value));
        }
        Ok(Self(options))
    }

    fn read<T>(
        &self,
        key: &'static str,
        expected: &'static str,
        read: impl Fn(&str) -> Option<T>,
    ) -> Result<Option<T>, LocatorError> {
        let Some((_, value)) = self.0.iter().find(|(k, _)| *k == key) else {
            return Ok(None);
        };
        read(value).map(Some).ok_or_else(|| LocatorError::Value {
            key,
            value: (*value).to_owned(),
            expected,
        })
    }

    pub(super) fn adapter(&self) -> Result<Option<String>, LocatorError> {
        self.read(
            "adapter",
            "the value must be the name of an adapter: hci0, hci1, ... or sim-...",
            |v| is_adapter(v).then(|| v.to_owned()),
        )
    }

    pub(super) fn name(&self) -> Result<Option<String>, LocatorError> {
        self.read(
            "name",
            "a name must have 1 to 29 letters, digits, `-`, `_` or `.`, and must not be that of an adapter or an address",
            |v| (is_name(v) && !is_adapter(v)).then(|| v.to_owned()),
        )
    }

    pub(super) fn fleet(&self) -> Result<Option<String>, LocatorError> {
        self.read(
            "fleet",
            "the name of a fleet must have 1 to 29 letters, digits, `-`, `_` or `.`",
            |v| is_name(v).then(|| v.to_owned()),
        )
    }

    pub(super) fn psm(&self) -> Result<Option<Psm>, LocatorError> {
        self.read("psm", "the value must be a number from 128 to 255", |v| {
            v.parse().ok().and_then(Psm::new)
        })
    }

    pub(super) fn address_kind(&self) -> Result<Option<AddressType>, LocatorError> {
        self.read(
            "addr_type",
            "the value must be public or random",
            |v| match v {
                "public" => Some(AddressType::Public),
                "random" => Some(AddressType::Random),
                _ => None,
            },
        )
    }

    pub(super) fn security(&self) -> Result<Security, LocatorError> {
        let level = self.read(
            "sec",
            "the value must be low, medium or high",
            |v| match v {
                "low" => Some(Security::Low),
                "medium" => Some(Security::Medium),
                "high" => Some(Security::High),
                _ => None,
            },
        )?;
        Ok(level.unwrap_or_default())
    }

    pub(super) fn secret(&self) -> Result<Option<PathBuf>, LocatorError> {
        self.read(
            "secret",
            "the value must be the absolute path of a file",
            |v| v.starts_with('/').then(|| PathBuf::from(v)),
        )
    }

    pub(super) fn mtu(&self) -> Result<u16, LocatorError> {
        let mtu = self.read(
            "mtu",
            "the value must be a number of bytes from 128 (what Zenoh's handshake needs) to 8000",
            |v| {
                v.parse()
                    .ok()
                    .filter(|mtu| (MIN_MTU..=MAX_MTU).contains(mtu))
            },
        )?;
        Ok(mtu.unwrap_or(DEFAULT_MTU))
    }

    pub(super) fn queueing(&self) -> Result<Queueing, LocatorError> {
        let defaults = Queueing::default();
        let bytes = self.read(
            "queue",
            "the value must be a number of bytes from 65536 to 67108864, for the whole link",
            |v| v.parse().ok().filter(|n| (1 << 16..=1 << 26).contains(n)),
        )?;
        let backlog = self.milliseconds(
            "backlog",
            "the value must be a number of milliseconds from 50 to 600000",
            50..=600_000,
        )?;
        let droppable = self.milliseconds(
            "droppable",
            "the value must be a number of milliseconds from 20 to 10000",
            20..=10_000,
        )?;
        let linger = self.milliseconds(
            "linger",
            "the value must be a number of milliseconds from 0 to 60000",
            0..=60_000,
        )?;
        Ok(Queueing {
            bounds: Bounds {
                bytes: bytes.unwrap_or(defaults.bounds.bytes),
                backlog: backlog.unwrap_or(defaults.bounds.backlog),
                droppable: droppable.unwrap_or(defaults.bounds.droppable),
            },
            linger: linger.unwrap_or(defaults.linger),
        })
    }

    pub(super) fn timeout(&self) -> Result<Duration, LocatorError> {
        let timeout = self.milliseconds(
            "timeout",
            "the value must be a number of milliseconds from 100 to 60000",
            100..=60_000,
        )?;
        Ok(timeout.unwrap_or(DEFAULT_CONNECT_TIMEOUT))
    }

    fn milliseconds(
        &self,
        key: &'static str,
        expected: &'static str,
        range: RangeInclusive<u64>,
    ) -> Result<Option<Duration>, LocatorError> {
        let in_range = |ms: &u64| range.contains(ms);
        let read = |v: &str| v.parse().ok().filter(in_range).map(Duration::from_millis);
        self.read(key, expected, read)
    }

    pub(super) fn plain(&self) -> Result<Option<bool>, LocatorError> {
        self.boolean("plain")
    }

    pub(super) fn wait(&self) -> Result<bool, LocatorError> {
        Ok(self.boolean("wait")?.unwrap_or(false))
    }

    fn boolean(&self, key: &'static str) -> Result<Option<bool>, LocatorError> {
        self.read(key, "the value must be true or false", |v| v.parse().ok())
    }

    pub(super) fn max_links(&self) -> Result<usize, LocatorError> {
        let links = self.read(
            "max_links",
            "the value must be a number from 1 to 64",
            |v| v.parse().ok().filter(|n| (1..=64).contains(n)),
        )?;
        Ok(links.unwrap_or(DEFAULT_MAX_LINKS))
    }
}
