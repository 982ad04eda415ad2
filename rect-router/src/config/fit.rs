//! Owns the advice about settings that do not fit a link of 34 to 100 kB/s. Zenoh has one value for all links of a router,
//! and its defaults are made for quick ones; `config/README.md` has the measured effect of each.

use serde_json::Value;
use zenoh::Config;

/// A setting, what it must be, and what happens else.
struct Rule {
    key: &'static str,
    fits: fn(&Value) -> bool,
    wanted: &'static str,
    otherwise: &'static str,
}

const RULES: [Rule; 4] = [
    Rule {
        key: "transport/link/tx/queue/congestion_control/block/wait_before_close",
        fits: |value| value.as_i64() >= Some(30_000_000),
        wanted: "60000000 (microseconds)",
        otherwise: "a message larger than what waits for the radio closes the link",
    },
    Rule {
        key: "transport/link/tx/queue/size/data",
        fits: |value| value.as_u64() >= Some(8),
        wanted: "8",
        otherwise: "a program's large message holds up its urgent ones",
    },
    Rule {
        key: "transport/link/rx/max_message_size",
        fits: |value| value.as_u64() <= Some(64 << 20),
        wanted: "16777216 (bytes)",
        otherwise: "a peer can fill the memory of a robot",
    },
    Rule {
        key: "transport/unicast/qos/enabled",
        fits: |value| value.as_bool() == Some(true),
        wanted: "true",
        otherwise: "urgent messages wait behind all others",
    },
];

/// One sentence for each setting that does not fit.
pub fn advice(config: &Config) -> Vec<String> {
    let Ok(settings) = serde_json::to_value(config) else {
        return Vec::new();
    };
    let misfit = |rule: &Rule| {
        let value = settings.pointer(&format!("/{}", rule.key))?;
        (!(rule.fits)(value)).then(|| {
            let Rule {
                key,
                wanted,
                otherwise,
                ..
            } = rule;
            format!("{key} is {value}: {otherwise}; better {wanted}")
        })
    };
    RULES.iter().filter_map(misfit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rule_names_a_setting_that_zenoh_has() {
        let settings = serde_json::to_value(Config::default()).expect("serializes");
        for rule in &RULES {
            let value = settings.pointer(&format!("/{}", rule.key));
            assert!(value.is_some(), "{}", rule.key);
        }
    }

    #[test]
    fn zenohs_defaults_do_not_fit_a_slow_link() {
        let advice = advice(&Config::default()).join("\n");
        for key in ["wait_before_close", "size/data", "max_message_size"] {
            assert!(advice.contains(key), "{advice}");
        }
        assert!(!advice.contains("qos"), "{advice}");
    }

    #[test]
    fn the_files_that_come_with_it_fit() {
        for name in ["robot", "base-station", "simulation"] {
            let file = format!("{}/../config/{name}.json5", env!("CARGO_MANIFEST_DIR"));
            let config = Config::from_file(&file).expect(name);
            assert_eq!(advice(&config), Vec::<String>::new(), "{name}");
        }
    }
}
