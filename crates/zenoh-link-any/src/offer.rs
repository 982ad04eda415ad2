//! The addresses that a side offers for further paths. For the layout see section 5 of `PROTOCOL.md`.
use std::net::{IpAddr, SocketAddr};

/// The largest number of addresses in an offer.
pub const MAX_ADDRESSES: usize = 8;

const IPV4: u8 = 4;
const IPV6: u8 = 6;

/// Why an offer was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum OfferError {
    /// The offer is too short for its addresses, or has bytes after them.
    #[error("an offer of addresses with a wrong length")]
    Length,
    /// There are too many addresses.
    #[error("an offer of more than {MAX_ADDRESSES} addresses")]
    TooMany,
    /// The kind of an address is unknown.
    #[error("an offer with the unknown kind of address {0}")]
    Kind(u8),
}

/// Encodes an offer; only the first [`MAX_ADDRESSES`] addresses count.
pub fn encode(port: u16, addresses: &[IpAddr]) -> Vec<u8> {
    let mut body = port.to_le_bytes().to_vec();
    for address in addresses.iter().take(MAX_ADDRESSES) {
        match address {
            IpAddr::V4(address) => {
                body.push(IPV4);
                body.extend_from_slice(&address.octets());
            }
            IpAddr::V6(address) => {
                body.push(IPV6);
                body.extend_from_slice(&address.octets());
            }
        }
    }
    body
}

/// Decodes an untrusted offer. Returns each address once, and none if the sender does not listen.
///
/// # Errors
/// Fails if the offer does not have the layout of the protocol.
pub fn decode(body: &[u8]) -> Result<Vec<SocketAddr>, OfferError> {
    let (port, mut rest) = body.split_first_chunk().ok_or(OfferError::Length)?;
    let port = u16::from_le_bytes(*port);
    let (mut addresses, mut count) = (Vec::new(), 0);
    while let Some((kind, body)) = rest.split_first() {
        if count == MAX_ADDRESSES {
            return Err(OfferError::TooMany);
        }
        count += 1;
        let address: IpAddr = match *kind {
            IPV4 => {
                let (octets, after) = body.split_first_chunk::<4>().ok_or(OfferError::Length)?;
                rest = after;
                (*octets).into()
            }
            IPV6 => {
                let (octets, after) = body.split_first_chunk::<16>().ok_or(OfferError::Length)?;
                rest = after;
                (*octets).into()
            }
            kind => return Err(OfferError::Kind(kind)),
        };
        let address = SocketAddr::new(address, port);
        if port != 0 && !addresses.contains(&address) {
            addresses.push(address);
        }
    }
    Ok(addresses)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offers_survive_encoding() {
        let addresses: Vec<IpAddr> = ["192.168.7.2", "fe80::1", "10.0.0.1"]
            .map(|text| text.parse().expect("an address"))
            .to_vec();
        for count in 0..=addresses.len() {
            let body = encode(7460, &addresses[..count]);
            let expected: Vec<_> = addresses[..count]
                .iter()
                .map(|address| SocketAddr::new(*address, 7460))
                .collect();
            assert_eq!(decode(&body), Ok(expected));
        }
    }

    #[test]
    fn repeated_address_counts_once_and_port_0_is_none() {
        let address: IpAddr = "192.168.7.2".parse().expect("an address");
        let offered = [address; MAX_ADDRESSES];
        let expected = vec![SocketAddr::new(address, 7460)];
        assert_eq!(decode(&encode(7460, &offered)), Ok(expected));
        assert_eq!(decode(&encode(0, &offered)), Ok(Vec::new()));
    }

    #[test]
    fn malformed_offers_are_rejected() {
        let address = "192.168.7.2".parse().expect("an address");
        let body = encode(1, &[address]);
        for length in (0..2).chain(3..body.len()) {
            assert_eq!(decode(&body[..length]), Err(OfferError::Length));
        }
        assert_eq!(decode(&[0, 0, 5, 1, 1, 1, 1]), Err(OfferError::Kind(5)));
        let mut many = encode(1, &[address; MAX_ADDRESSES]);
        assert!(decode(&many).is_ok());
        many.extend_from_slice(&[4, 1, 1, 1, 1]);
        assert_eq!(decode(&many), Err(OfferError::TooMany));
    }
}
