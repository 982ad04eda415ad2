//! Reads what others send about parameters and stops, and the file of a group. Values that are in force fit their declaration, whatever was
//! ordered; and a robot is stopped after a stop that it pressed, whatever others claim.
use std::time::Instant;

use rect_core::{
    message::{encoding::Encoding, payload::Payload},
    name::{instance::Instance, Name},
    parameters::{order::Order, Declaration, Group, Parameter},
    stop::FleetStop,
};

/// Runs the target on one input.
pub fn run(input: &[u8]) {
    if let Ok(declaration) = serde_json::from_slice::<Declaration>(input) {
        let _ = Group::new(declaration, None);
    }
    let declaration = Declaration::new(vec![
        Parameter::new("a", 1.0).range(0.0, 10.0),
        Parameter::new("b", 3).range(None, 8.0),
        Parameter::new("c", "x").choices(["x", "y"]),
        Parameter::new("d", vec![0.0]),
    ]);
    let (mut group, _) = Group::new(declaration.expect("a valid declaration"), None);
    let name = |text| Name::new(text).expect("a name");
    let mut stop = FleetStop::new(name("wombat-1"), None, Instance(1));
    for part in input.split(|byte| *byte == 0xFF) {
        for encoding in [Encoding::CBOR, Encoding::JSON] {
            let payload = Payload::new(part.to_vec(), encoding);
            let order = Order::read(&payload);
            if let Ok(proposal) = order.and_then(|order| group.propose(order, false)) {
                let _ = group.commit(&proposal, Some("laptop"), Instant::now());
            }
            for (parameter, value) in group.values().of(group.declaration()) {
                assert_eq!(parameter.accept(value).as_ref(), Ok(value));
            }
            let _ = stop.on_message(&name("wombat-2"), &payload, false);
        }
    }
    stop.press("", 0);
    assert!(stop.is_stopped());
}
