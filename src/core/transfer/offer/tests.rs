//! Tests of the offer.
use super::*;

#[test]
fn an_offer_comes_back_as_it_was_and_no_part_of_it_does() {
    for size in [0, 1, 34_000, u64::MAX] {
        let offer = sample(size);
        let bytes = offer.encode();
        assert_eq!(Offer::decode(&bytes), Ok(offer));
        for cut in 0..bytes.len() {
            assert!(Offer::decode(&bytes[..cut]).is_err(), "cut to {cut}");
        }
        let longer = [&bytes[..], &[0]].concat();
        assert_eq!(Offer::decode(&longer), Err(OfferError::Malformed("end")));
    }
    assert_eq!(Offer::decode(&[9]), Err(OfferError::Version(9)));
    assert_eq!(
        Offer::decode(&[1; MAX_BYTES + 1]),
        Err(OfferError::Malformed("length"))
    );
}

#[test]
fn the_longest_offer_has_room() {
    let offer = Offer {
        from: Name::new(&"n".repeat(29)).expect("a name"),
        topic: Topic::new(&"t".repeat(topic::MAX_BYTES)).expect("a topic"),
        name: FileName::new(&"f".repeat(MAX_NAME_BYTES)).expect("a file's name"),
        encoding: Encoding::new("e".repeat(encoding::MAX_BYTES)),
        ..sample(u64::MAX)
    };
    assert_eq!(Offer::decode(&offer.encode()), Ok(offer));
}

#[test]
fn a_name_leads_nowhere_else() {
    for good in ["", "a", "map of the kitchen.pcd", "ä.txt", "a..b"] {
        assert_eq!(FileName::new(good).expect(good).as_str(), good);
    }
    for bad in [
        "/etc/passwd",
        "../x",
        "..",
        ".",
        ".bashrc",
        "a/b",
        "a\\b",
        "c:x",
        "a\nb",
        "a\0",
    ] {
        let mut offer = sample(1);
        offer.name = FileName(bad.to_owned());
        let error = Offer::decode(&offer.encode()).expect_err(bad);
        assert!(matches!(error, OfferError::Name(_)), "{error}");
    }
    assert!(FileName::new(&"x".repeat(MAX_NAME_BYTES + 1)).is_err());
}

#[test]
fn a_robots_name_leads_nowhere_else() {
    let from = Name::new(".x").expect("a name, elsewhere");
    let offer = Offer { from, ..sample(1) };
    assert_eq!(
        Offer::decode(&offer.encode()),
        Err(OfferError::Malformed("sender"))
    );
}

#[test]
fn the_id_is_of_the_content_and_the_receiver_and_not_of_the_call() {
    let (a, b) = (
        Name::new("a").expect("a name"),
        Name::new("b").expect("a name"),
    );
    let offer = sample(5);
    let again = Offer {
        call: 8,
        ..offer.clone()
    };
    assert_eq!(offer.id(&a), again.id(&a));
    assert!(offer.is_same(&again) && !offer.is_same(&sample(6)));
    assert_ne!(offer.id(&a), offer.id(&b));
    assert_ne!(offer.id(&a), sample(6).id(&a));
    assert_eq!(offer.id(&a).to_string().len(), 16);
}
