//! Tests training, storing and rejecting dictionaries.
use super::*;

fn samples(kind: usize) -> Vec<String> {
    let sample = |n| {
        format!(
            r#"{{"kind":{kind},"seq":{n},"t":{}.{},"ok":true}}"#,
            n * 7,
            n % 13
        )
    };
    (0..1500).map(sample).collect()
}

fn trained(kind: usize) -> Arc<Dictionary> {
    Arc::new(Dictionary::train(&samples(kind), 2048).expect("trained"))
}

#[test]
fn the_same_content_has_the_same_id_everywhere() {
    let dictionary = trained(1);
    assert!((0x8000..0x1_0000).contains(&dictionary.id()));
    let crc = crc32fast::hash(&dictionary.as_bytes()[8..]);
    assert_eq!(dictionary.id(), 0x8000 + crc % 0x8000);
    let mut of_another_program = dictionary.as_bytes().to_vec();
    of_another_program[4..8].copy_from_slice(&77u32.to_le_bytes());
    let same = Dictionary::new(of_another_program).expect("a dictionary");
    assert_eq!(same.as_bytes(), dictionary.as_bytes());
    assert_ne!(trained(2).id(), dictionary.id());
}

#[test]
fn invalid_dictionaries_are_rejected() {
    for wrong in [&b""[..], b"{}", &MAGIC, &[&MAGIC[..], &[0; 100]].concat()] {
        let error = Dictionary::new(wrong).expect_err("wrong");
        assert!(matches!(error, DictionaryError::Damaged(_)), "{error}");
    }
    let large = vec![0; MAX_BYTES + 1];
    assert!(matches!(
        Dictionary::new(large),
        Err(DictionaryError::TooLarge)
    ));
    let good = trained(1);
    for cut in 0..90 {
        assert!(Dictionary::new(&good.as_bytes()[..cut]).is_err(), "{cut}");
    }
    for n in 8..300 {
        let mut wrong = good.as_bytes().to_vec();
        wrong[n] ^= 0xff;
        let _ = Dictionary::new(wrong);
    }
}

#[test]
fn training_on_too_few_samples_is_an_error() {
    let none: [&str; 0] = [];
    let few = ["{}", "{}"];
    for error in [
        Dictionary::train(&none, 4096),
        Dictionary::train(&few, 4096),
        Dictionary::train(&[""; 100], 4096),
        Dictionary::train(&["a"; 8], 4096),
        Dictionary::train(&["a"; 100], 4096),
    ] {
        let error = error.expect_err("too little");
        assert!(matches!(error, DictionaryError::Samples { .. }), "{error}");
    }
    for size in [0, MIN_BYTES - 1, MAX_BYTES + 1] {
        let error = Dictionary::train(&samples(1), size).expect_err("a size");
        assert!(matches!(error, DictionaryError::Size(s) if s == size));
    }
}

#[test]
fn files_round_trip() {
    let folder = std::env::temp_dir().join(format!("rect-dictionary-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("a folder");
    let (file, large) = (folder.join("telemetry.dict"), folder.join("large.dict"));
    let dictionary = trained(3);
    dictionary.write(&file).expect("written");
    let read = Dictionary::read(&file).expect("read");
    assert_eq!(read.as_bytes(), dictionary.as_bytes());
    std::fs::write(&large, vec![0; MAX_BYTES + 9]).expect("written");
    assert!(matches!(
        Dictionary::read(&large),
        Err(DictionaryError::TooLarge)
    ));
    let missing = Dictionary::read(folder.join("none")).expect_err("missing");
    assert!(missing.to_string().contains("none"), "{missing}");
    std::fs::remove_dir_all(&folder).expect("removed");
}

#[test]
fn the_oldest_dictionary_is_removed_and_none_is_replaced() {
    let mut dictionaries = Dictionaries::default();
    let first = trained(0);
    dictionaries.add(first.clone()).expect("room");
    dictionaries.add(first.clone()).expect("already present");
    assert_eq!(dictionaries.iter().count(), 1);
    let forged = Arc::new(Dictionary {
        bytes: b"other".to_vec(),
        id: first.id(),
        prepared: Prepared::new(first.as_bytes()).expect("prepared"),
    });
    let error = dictionaries.add(forged).expect_err("taken");
    assert!(matches!(error, DictionaryError::IdTaken(id) if id == first.id()));
    for kind in 1..=Dictionaries::MAX {
        dictionaries.add(trained(kind)).expect("room is made");
    }
    assert_eq!(dictionaries.iter().count(), Dictionaries::MAX);
    assert!(dictionaries.get(first.id()).is_none());
}

#[test]
fn each_robot_has_dictionaries_of_its_own_and_cannot_displace_others() {
    let name = |text: &str| Name::new(text).expect("valid name");
    let (honest, other) = (name("honest"), name("other"));
    let mut dictionaries = RobotDictionaries::default();
    let first = trained(0);
    dictionaries.add(&honest, first.clone());
    let same_id = Arc::new(Dictionary {
        bytes: b"other".to_vec(),
        id: first.id(),
        prepared: Prepared::new(first.as_bytes()).expect("prepared"),
    });
    dictionaries.add(&other, same_id.clone());
    let found = |dictionaries: &RobotDictionaries, robot: &Name| {
        dictionaries
            .of(robot)
            .get(first.id())
            .map(|dictionary| dictionary.bytes.clone())
    };
    assert_eq!(found(&dictionaries, &honest), Some(first.bytes.clone()));
    assert_eq!(found(&dictionaries, &other), Some(same_id.bytes.clone()));
    assert_eq!(found(&dictionaries, &name("nobody")), None);
    for robot in 0..8 {
        for kind in 1..=Dictionaries::MAX {
            dictionaries.add(&name(&format!("robot-{robot}")), trained(kind));
        }
    }
    assert_eq!(dictionaries.len(), RobotDictionaries::MAX);
    assert_eq!(
        found(&dictionaries, &honest),
        Some(first.bytes.clone()),
        "it has few"
    );
    dictionaries.add(&honest, same_id.clone());
    assert_eq!(
        found(&dictionaries, &honest),
        Some(same_id.bytes.clone()),
        "replaced by the same robot"
    );
}
