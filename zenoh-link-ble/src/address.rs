//! Owns what names a Bluetooth device: its address, the kind of that address, and a PSM.
use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// A Bluetooth device address: six bytes, most significant first, as it is written (`DC:A6:32:01:02:03`).
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Address(pub [u8; 6]);

/// What kind of address a device uses. Dialling with the wrong one times out silently, so it comes from discovery.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum AddressType {
    /// Assigned by the IEEE to the controller.
    Public,
    /// Chosen by the device.
    Random,
}

/// An address together with its kind: all that is needed to dial a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct DeviceAddress {
    /// The six bytes.
    pub address: Address,
    /// Their kind.
    pub kind: AddressType,
}

/// The protocol/service multiplexer of an LE L2CAP channel in the dynamic range, 0x80 to 0xff
/// (Bluetooth Core Specification, Vol 3, Part A, 4.22).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Psm(u8);

impl Psm {
    /// The lowest PSM an unprivileged program may use.
    pub const MIN: u16 = 0x80;
    /// The highest PSM of LE.
    pub const MAX: u16 = 0xff;

    /// The PSM of that number, or `None` outside 0x80 to 0xff.
    pub fn new(number: u16) -> Option<Self> {
        if (Self::MIN..=Self::MAX).contains(&number) {
            u8::try_from(number).ok().map(Self)
        } else {
            None
        }
    }

    /// Its number.
    pub fn number(self) -> u16 {
        u16::from(self.0)
    }
}

impl fmt::Display for Psm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.0)
    }
}

/// The text is not six hexadecimal bytes with colons between.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("not a bluetooth address, which has six hexadecimal bytes: DC:A6:32:01:02:03")]
pub struct AddressError;

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let mut bytes = [0; 6];
        let mut parts = text.split(':');
        for byte in &mut bytes {
            let part = parts.next().ok_or(AddressError)?;
            if part.len() != 2 || !part.bytes().all(|b| b.is_ascii_hexdigit()) {
                return Err(AddressError);
            }
            *byte = u8::from_str_radix(part, 16).map_err(|_| AddressError)?;
        }
        match parts.next() {
            None => Ok(Self(bytes)),
            Some(_) => Err(AddressError),
        }
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [a, b, c, d, e, g] = self.0;
        write!(f, "{a:02X}:{b:02X}:{c:02X}:{d:02X}:{e:02X}:{g:02X}")
    }
}

impl fmt::Debug for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl fmt::Display for DeviceAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.address.fmt(f)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_reads_back_as_it_is_written() {
        let address: Address = "dc:A6:32:01:02:0f".parse().expect("valid");
        assert_eq!(address.to_string(), "DC:A6:32:01:02:0F");
    }

    #[test]
    fn what_is_not_six_bytes_is_no_address() {
        for text in [
            "",
            "wombat-1",
            "DC:A6:32:01:02",
            "DC:A6:32:01:02:03:04",
            "DC:A6:32:01:02:+3",
            "DCA632010203",
        ] {
            assert_eq!(text.parse::<Address>(), Err(AddressError), "{text}");
        }
    }

    #[test]
    fn a_psm_is_in_the_dynamic_range() {
        assert_eq!(Psm::new(0x7f), None);
        assert_eq!(Psm::new(0x80).map(Psm::number), Some(0x80));
        assert_eq!(Psm::new(0xff).map(Psm::number), Some(0xff));
        assert_eq!(Psm::new(0x100), None);
    }
}
