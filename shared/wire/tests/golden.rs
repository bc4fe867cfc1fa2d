//! The bytes of every message in version 1. A change here is a change of the protocol: add a `Version`, keep
//! the old lines.

mod samples;

use std::fmt::Write;
use tessera_wire::codec::{self, Message};

#[test]
fn every_message_keeps_its_bytes() {
    let mut text = String::new();
    for (name, message) in samples::to_master() {
        line(&mut text, &format!("to master, {name}"), &message);
    }
    for (name, message) in samples::to_worker() {
        line(&mut text, &format!("to worker, {name}"), &message);
    }
    line(&mut text, "bulk, pack chunk", &samples::chunk());
    line(&mut text, "bulk, batch", &samples::batch());
    line(&mut text, "stdin, ticket", &samples::ticket());
    let golden = include_str!("golden_v1.txt");
    for (now, then) in text.lines().zip(golden.lines()) {
        assert_eq!(now, then);
    }
    assert_eq!(text.lines().count(), golden.lines().count(), "the whole text:\n{text}");
}

/// Appends the frame of `message` in hexadecimal, and checks that it decodes to itself.
fn line<M: Message + PartialEq + std::fmt::Debug>(text: &mut String, name: &str, message: &M) {
    let frame = codec::encode(message).expect("within its limit");
    let (prefix, body) = frame.split_at(codec::PREFIX_BYTES);
    let length =
        codec::body_length(prefix.try_into().expect("four bytes"), M::LIMIT).expect("within its limit");
    assert_eq!(length, body.len());
    assert_eq!(&codec::decode::<M>(body).expect("decodes"), message);
    write!(text, "{name}: ").expect("a string takes it");
    frame.iter().for_each(|byte| write!(text, "{byte:02x}").expect("a string takes it"));
    text.push('\n');
}
