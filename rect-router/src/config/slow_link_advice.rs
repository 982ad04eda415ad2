//! Recommends settings for links of 34 to 100 kB/s. Zenoh has one value of each setting for all links of a router, and its
//! defaults are meant for fast links. `docs/reference/configuration.md` documents the effects of these settings.

use serde_json::Value;
use zenoh::Config;

/// A recommended value of one setting, and the consequence of another value.
struct Recommendation {
    key: &'static str,
    is_suitable: fn(&Value) -> bool,
    recommended: &'static str,
    consequence: &'static str,
}

const RECOMMENDATIONS: [Recommendation; 4] = [
    Recommendation {
        key: "transport/link/tx/queue/congestion_control/block/wait_before_close",
        is_suitable: |value| value.as_i64() >= Some(30_000_000),
        recommended: "60000000 (microseconds)",
        consequence: "a message that the radio cannot take in time closes the link",
    },
    Recommendation {
        key: "transport/link/tx/queue/size/data",
        is_suitable: |value| value.as_u64() >= Some(8),
        recommended: "8",
        consequence: "a large message delays the urgent messages of the same program",
    },
    Recommendation {
        key: "transport/link/rx/max_message_size",
        is_suitable: |value| value.as_u64() <= Some(64 << 20),
        recommended: "16777216 (bytes)",
        consequence: "a peer can fill the memory of the robot with one message",
    },
    Recommendation {
        key: "transport/unicast/qos/enabled",
        is_suitable: |value| value.as_bool() == Some(true),
        recommended: "true",
        consequence: "urgent messages wait behind all other messages",
    },
];

/// Returns one sentence for each setting whose value is unsuitable for a slow link.
pub fn advice(config: &Config) -> Vec<String> {
    let Ok(settings) = serde_json::to_value(config) else {
        return Vec::new();
    };
    let unsuitable = |recommendation: &Recommendation| {
        let value = settings.pointer(&format!("/{}", recommendation.key))?;
        (!(recommendation.is_suitable)(value)).then(|| {
            let Recommendation {
                key,
                recommended,
                consequence,
                ..
            } = recommendation;
            format!("{key} is {value}: {consequence}; set it to {recommended}")
        })
    };
    RECOMMENDATIONS.iter().filter_map(unsuitable).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_recommendation_names_an_existing_setting() {
        let settings = serde_json::to_value(Config::default()).expect("serializes");
        for recommendation in &RECOMMENDATIONS {
            let value = settings.pointer(&format!("/{}", recommendation.key));
            assert!(value.is_some(), "{}", recommendation.key);
        }
    }

    #[test]
    fn advises_against_zenohs_defaults() {
        let advice = advice(&Config::default()).join("\n");
        for key in ["wait_before_close", "size/data", "max_message_size"] {
            assert!(advice.contains(key), "{advice}");
        }
        assert!(!advice.contains("qos"), "{advice}");
    }

    #[test]
    fn accepts_the_shipped_configurations() {
        for name in ["robot", "base-station", "simulation"] {
            let file = format!("{}/../config/{name}.json5", env!("CARGO_MANIFEST_DIR"));
            let config = Config::from_file(&file).expect(name);
            assert_eq!(advice(&config), Vec::<String>::new(), "{name}");
        }
    }
}
