//! Tests of offers.
use super::*;

#[test]
fn offers_round_trip_and_truncated_ones_are_rejected() {
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
fn the_longest_offer_is_accepted() {
    let offer = Offer {
        sender: Name::new(&"n".repeat(29)).expect("valid name"),
        topic: Topic::new(&"t".repeat(topic::MAX_BYTES)).expect("valid topic"),
        name: FileName::new(&"f".repeat(MAX_NAME_BYTES)).expect("valid file name"),
        encoding: Encoding::new("e".repeat(encoding::MAX_BYTES)),
        ..sample(u64::MAX)
    };
    assert_eq!(Offer::decode(&offer.encode()), Ok(offer));
}

#[test]
fn file_names_cannot_refer_to_other_folders() {
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
        "invoice\u{202e}fdp.exe",
        "a\u{200b}b",
    ] {
        let mut offer = sample(1);
        offer.name = FileName(bad.to_owned());
        let error = Offer::decode(&offer.encode()).expect_err(bad);
        assert!(matches!(error, OfferError::Name(_)), "{error}");
    }
    assert!(FileName::new(&"x".repeat(MAX_NAME_BYTES + 1)).is_err());
}

#[test]
fn sender_names_cannot_refer_to_other_folders() {
    let sender = Name::new(".x").expect("valid as the name of a robot");
    let offer = Offer {
        sender,
        ..sample(1)
    };
    assert_eq!(
        Offer::decode(&offer.encode()),
        Err(OfferError::Malformed("sender"))
    );
}

#[test]
fn the_id_depends_on_content_and_receiver_but_not_on_the_call() {
    let (a, b) = (
        Name::new("a").expect("valid name"),
        Name::new("b").expect("valid name"),
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
