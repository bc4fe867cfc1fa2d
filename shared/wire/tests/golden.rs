//! The bytes of every message in version 5. A change here is a change of the protocol: add a `Version`, keep
//! the old lines of versions that are still spoken.

mod samples;

use std::fmt::Write;
use tessera_wire::codec::{self, Message};
use tessera_wire::{FromClient, Hello, Refusal, ToClient, ToMaster, ToWorker, Version, limits};

#[test]
fn every_message_keeps_its_bytes() {
    let mut text = String::new();
    for (name, message) in samples::to_master() {
        line(&mut text, &format!("to master, {name}"), &message);
    }
    for (name, message) in samples::to_worker() {
        line(&mut text, &format!("to worker, {name}"), &message);
    }
    for (name, message) in samples::from_client() {
        line(&mut text, &format!("from client, {name}"), &message);
    }
    for (name, message) in samples::to_client() {
        line(&mut text, &format!("to client, {name}"), &message);
    }
    line(&mut text, "bulk, frame summary", &samples::summary());
    line(&mut text, "bulk, pack chunk", &samples::chunk());
    line(&mut text, "bulk, batch", &samples::batch());
    line(&mut text, "stdin, ticket", &samples::ticket());
    let golden = include_str!("golden_v5.txt");
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

/// What a worker of version 1 says first: versions [1], name `w0`, and fields that came before the token.
const HELLO_V1: &str = "000101027730fd00000000020000000803637075056370752d31";

/// And one of version 2: versions [2], a token, name `w0`, and abilities without a speed.
const HELLO_V2: &str =
    "0001025c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c02773000fd00000000020000000803637075056370752d31";

/// And one of version 3, whose `Hello` is that of versions 4 and 5.
const HELLO_V3: &str =
    "0001035c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c02773000fd00000000020000000803637075056370752d31fc404b4c00016e";

const HELLO_V4: &str =
    "0001045c5c5c5c5c5c5c5c5c5c5c5c5c5c5c5c02773000fd00000000020000000803637075056370752d31fc404b4c00016e";

fn bytes(hexadecimal: &str) -> Vec<u8> {
    let pairs = hexadecimal.as_bytes().chunks(2).map(|pair| std::str::from_utf8(pair).expect("ASCII"));
    pairs.map(|pair| u8::from_str_radix(pair, 16).expect("hexadecimal")).collect()
}

fn hello(versions: &[u16]) -> Hello {
    match samples::to_master().swap_remove(0) {
        (_, ToMaster::Hello(hello)) => Hello { versions: versions.to_vec(), ..hello },
        other => panic!("{other:?}"),
    }
}

fn body(message: &impl Message) -> Vec<u8> {
    codec::encode(message).expect("within its limit").split_off(codec::PREFIX_BYTES)
}

#[test]
fn peers_of_other_versions_part_with_a_reason() {
    let refused = Refusal::Version { supported: Version::supported_numbers() };
    for older in [HELLO_V1, HELLO_V2, HELLO_V3, HELLO_V4] {
        assert_eq!(codec::decode_hello(&bytes(older)), Err(refused.clone()), "an older one");
    }
    let own = hello(&[5]);
    assert_eq!(codec::decode_hello(&body(&ToMaster::Hello(own.clone()))), Ok(own));
    let both = hello(&[6, 5]);
    let mut newer = body(&ToMaster::Hello(both.clone()));
    newer.extend(b"a field of version 6");
    assert_eq!(codec::decode_hello(&newer), Ok(both), "a newer one that speaks ours");
    let mut disjoint = body(&ToMaster::Hello(hello(&[6])));
    // Nothing behind the list is read.
    disjoint.truncate(4);
    assert_eq!(codec::decode_hello(&disjoint), Err(refused.clone()), "a newer one that does not");
    // What they are told reads the same in every version.
    assert_eq!(body(&ToWorker::Refuse(Refusal::Version { supported: vec![1] })), [1, 0, 1, 1]);
}

#[test]
fn before_the_answer_a_worker_and_a_client_look_alike() {
    let own = hello(&[5]);
    assert_eq!(body(&ToMaster::Hello(own.clone())), body(&FromClient::Hello(own)));
    for (_, message) in samples::to_worker() {
        if let ToWorker::Refuse(refusal) = message {
            assert_eq!(body(&ToWorker::Refuse(refusal.clone())), body(&ToClient::Refuse(refusal)));
        }
    }
}

#[test]
fn what_is_no_hello_is_refused_with_a_reason() {
    let malformed = |body: &[u8]| match codec::decode_hello(body) {
        Err(Refusal::Malformed { detail }) => detail,
        other => panic!("{other:?}"),
    };
    assert_eq!(malformed(&body(&ToMaster::Leave)), "the first message is not `Hello`");
    malformed(&[]);
    malformed(&[0xff; 40]);
    assert_eq!(malformed(&[0; 5000]), "a message of 5000 bytes: at most 4096 are allowed here");
    let own = body(&ToMaster::Hello(hello(&[5])));
    for end in 0..own.len() {
        malformed(&own[..end]);
    }
    let mut wild = hello(&[5]);
    wild.name = "\x1b[2J".into();
    assert!(malformed(&body(&ToMaster::Hello(wild))).starts_with("name must have"));
    let many = hello(&[5; limits::VERSIONS + 1]);
    assert_eq!(malformed(&body(&ToMaster::Hello(many))), "17 versions, at most 16 are allowed");
}
