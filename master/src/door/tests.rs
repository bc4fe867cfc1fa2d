//! Peers that no honest program makes, over real connections.

use crate::{Cluster, ClusterConfig, ListenConfig};
use quinn::{
    ClientConfig, Connection, ConnectionError, Endpoint, RecvStream, SendStream, TransportErrorCode, VarInt,
    crypto::rustls::QuicClientConfig,
};
use std::{
    net::{Ipv4Addr, SocketAddr, UdpSocket},
    sync::Arc,
    time::Duration,
};
use tessera_trust::{Identity, OTHER_PROTOCOL_ALERT, WRONG_MASTER_ALERT, joiner_config};
use tessera_wire::{
    Abilities, AbortCode, Hello, JoinString, Refusal, Role, ToMaster, ToWorker, Token, Version,
    codec::{self, PREFIX_BYTES},
    limits,
};
use tokio::{task::JoinHandle, time::timeout};

/// Longer than anything here takes, silence included.
const PATIENCE: Duration = Duration::from_secs(60);

/// A master that lets workers come and go.
struct Master {
    join: JoinString,
    task: JoinHandle<()>,
}

impl Drop for Master {
    fn drop(&mut self) {
        self.task.abort();
    }
}

fn master(token_ttl: Option<Duration>) -> Master {
    let at = ListenConfig { listen: (Ipv4Addr::LOCALHOST, 0).into(), advertise: None, token_ttl };
    let (mut cluster, join) = Cluster::listen(ClusterConfig::default(), at).unwrap();
    Master { join, task: tokio::spawn(async move { cluster.attend(|_| ()).await }) }
}

/// A peer that can do anything.
struct Peer {
    endpoint: Endpoint,
    connection: Connection,
}

impl Master {
    fn address(&self) -> SocketAddr {
        (Ipv4Addr::LOCALHOST, self.join.port).into()
    }

    async fn connect(&self, alpn: &[u8]) -> Result<Peer, ConnectionError> {
        let mut tls = joiner_config(&Identity::new().unwrap(), self.join.fingerprint).unwrap();
        tls.alpn_protocols = vec![alpn.to_vec()];
        let config = ClientConfig::new(Arc::new(QuicClientConfig::try_from(tls).unwrap()));
        let endpoint = Endpoint::client((Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let connecting = endpoint.connect_with(config, self.address(), codec::SERVER_NAME).unwrap();
        Ok(Peer { connection: connecting.await?, endpoint })
    }

    async fn peer(&self) -> Peer {
        self.connect(codec::ALPN).await.unwrap()
    }

    /// An honest worker is let in.
    async fn check_open(&self) {
        let peer = self.peer().await;
        let (mut control, mut answers) = peer.connection.open_bi().await.unwrap();
        let mut bulk = peer.connection.open_uni().await.unwrap();
        bulk.write_all(&codec::BULK_TAG).await.unwrap();
        control.write_all(&codec::encode(&ToMaster::Hello(hello(self.join.token))).unwrap()).await.unwrap();
        let answer = answer(&mut answers).await;
        assert!(matches!(answer, ToWorker::Welcome { .. }), "{answer:?}");
    }
}

impl Peer {
    /// Says `bytes` first; what the master answers before it closes.
    async fn says(&self, bytes: &[u8]) -> Refusal {
        let (mut control, mut answers) = self.connection.open_bi().await.unwrap();
        control.write_all(bytes).await.unwrap();
        match answer(&mut answers).await {
            ToWorker::Refuse(refusal) => refusal,
            other => panic!("{other:?}"),
        }
    }

    /// The code that the master closes with.
    async fn closed(&self) -> AbortCode {
        match timeout(PATIENCE, self.connection.closed()).await.expect("the master closes") {
            ConnectionError::ApplicationClosed(close) => {
                let codes = [AbortCode::Timeout, AbortCode::Refused, AbortCode::Busy, AbortCode::Malformed];
                let of_close = |code: &AbortCode| close.error_code == VarInt::from_u32(code.number());
                codes.into_iter().find(of_close).unwrap_or_else(|| panic!("{close:?}"))
            }
            other => panic!("{other:?}"),
        }
    }
}

async fn answer(pipe: &mut RecvStream) -> ToWorker {
    let read = async {
        let mut prefix = [0; PREFIX_BYTES];
        pipe.read_exact(&mut prefix).await.unwrap();
        let mut body = vec![0; codec::body_length(prefix, limits::CONTROL_BYTES).unwrap()];
        pipe.read_exact(&mut body).await.unwrap();
        codec::decode(&body).unwrap()
    };
    timeout(PATIENCE, read).await.expect("the master answers")
}

fn hello(token: Token) -> Hello {
    let abilities = Abilities {
        memory: 0,
        threads: 1,
        backend: "cpu".into(),
        numeric_class: "cpu-1".into(),
        speed: 0,
        note: String::new(),
    };
    Hello { versions: Version::supported_numbers(), token, name: "w".into(), role: Role::Worker(abilities) }
}

fn frame(body: &[u8]) -> Vec<u8> {
    [&(body.len() as u32).to_le_bytes(), body].concat()
}

fn first(hello: Hello) -> Vec<u8> {
    codec::encode(&ToMaster::Hello(hello)).unwrap()
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whoever_may_not_join_is_told_why() {
    let master = master(None);
    let wrong = Token([7; 16]);
    let version = Refusal::Version { supported: Version::supported_numbers() };
    let v1 = [0, 1, 1, 2, b'w', b'0', 0, 1, 3, b'c', b'p', b'u', 5, b'c', b'p', b'u', b'-', b'1'];
    let other = Hello { versions: vec![2, 9], ..hello(master.join.token) };
    let cases = [
        (first(hello(wrong)), Refusal::Token),
        (first(hello(Token::default())), Refusal::Token),
        (frame(&v1), version.clone()),
        (first(other), version),
    ];
    for (bytes, expected) in cases {
        let peer = master.peer().await;
        assert_eq!(peer.says(&bytes).await, expected);
        drop(peer.endpoint);
    }
    let nonsense = [
        frame(b"GET / HTTP/1.1"),
        frame(&[]),
        frame(&[0xFF; 4096]),
        codec::encode(&ToMaster::Leave).unwrap(),
        // No more than the length of a message that is too long is read.
        (limits::HELLO_BYTES as u32 + 1).to_le_bytes().to_vec(),
        u32::MAX.to_le_bytes().to_vec(),
        first(Hello { name: "\x1b[2J".into(), ..hello(master.join.token) }),
    ];
    for bytes in nonsense {
        let refusal = master.peer().await.says(&bytes).await;
        assert!(matches!(refusal, Refusal::Malformed { .. }), "{bytes:?}: {refusal:?}");
    }
    master.check_open().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_token_s_time_ends() {
    let master = master(Some(Duration::ZERO));
    assert_eq!(master.peer().await.says(&first(hello(master.join.token))).await, Refusal::Expired);
    assert_eq!(master.peer().await.says(&first(hello(Token([7; 16])))).await, Refusal::Token);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn other_protocols_and_other_masters_end_in_the_handshake() {
    let master = master(None);
    let refused = master.connect(b"h3").await.err().expect("another protocol");
    let alert = TransportErrorCode::crypto(OTHER_PROTOCOL_ALERT);
    assert!(matches!(&refused, ConnectionError::ConnectionClosed(c) if c.error_code == alert), "{refused:?}");
    let join = JoinString { fingerprint: Identity::new().unwrap().fingerprint(), ..master.join.clone() };
    let elsewhere = Master { join, task: tokio::spawn(async {}) };
    let refused = elsewhere.connect(codec::ALPN).await.err().expect("another certificate");
    let alert = TransportErrorCode::crypto(WRONG_MASTER_ALERT);
    assert!(matches!(&refused, ConnectionError::TransportError(e) if e.code == alert), "{refused:?}");
    master.check_open().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn silence_ends_and_is_answered_with_silence() {
    let master = master(None);
    let say_nothing = async {
        let peer = master.peer().await;
        assert_eq!(peer.closed().await, AbortCode::Timeout);
        assert!(peer.connection.accept_uni().await.is_err(), "not a byte before a token");
    };
    let say_half = async {
        let peer = master.peer().await;
        let (mut control, mut answers) = peer.connection.open_bi().await.unwrap();
        let bytes = first(hello(master.join.token));
        control.write_all(&bytes[..bytes.len() - 1]).await.unwrap();
        assert_eq!(peer.closed().await, AbortCode::Timeout);
        assert!(answers.read(&mut [0]).await.is_err(), "not a byte before a token");
    };
    let open_no_bulk = async {
        let peer = master.peer().await;
        let (mut control, _answers) = peer.connection.open_bi().await.unwrap();
        control.write_all(&first(hello(master.join.token))).await.unwrap();
        assert_eq!(peer.closed().await, AbortCode::Timeout);
    };
    tokio::join!(say_nothing, say_half, open_no_bulk);
    master.check_open().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_bulk_pipe_of_something_else_is_closed() {
    let master = master(None);
    let peer = master.peer().await;
    let (mut control, _answers) = peer.connection.open_bi().await.unwrap();
    control.write_all(&first(hello(master.join.token))).await.unwrap();
    let mut bulk = peer.connection.open_uni().await.unwrap();
    bulk.write_all(b"nonsense").await.unwrap();
    assert_eq!(peer.closed().await, AbortCode::Malformed);
}

/// Bytes that the master takes of `pipe` before it lets its writer wait; it is given time for `least`.
async fn taken(pipe: &mut SendStream, least: usize) -> usize {
    /// Far longer than a packet takes on loopback; when it is too short, the test sees less than it might, and no test fails.
    const QUIET: Duration = Duration::from_millis(500);
    let (zeros, mut bytes) = ([0; 4096], 0);
    while let Ok(written) = timeout(if bytes < least { PATIENCE } else { QUIET }, pipe.write(&zeros)).await {
        bytes += written.unwrap();
        assert!(bytes <= 1 << 20, "a stranger has no such window");
    }
    bytes
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_stranger_s_bytes_are_few() {
    let master = master(None);
    let peer = master.peer().await;
    let (mut control, _answers) = peer.connection.open_bi().await.unwrap();
    let mut bulk = peer.connection.open_uni().await.unwrap();
    // The longest `Hello`, but for its last bytes: the master waits for them.
    control.write_all(&(limits::HELLO_BYTES as u32).to_le_bytes()).await.unwrap();
    control.write_all(&[0; limits::HELLO_BYTES - 10]).await.unwrap();
    let window = limits::STRANGER_WINDOW_BYTES as usize;
    // What was read of the `Hello` is given back to the window.
    let bytes = taken(&mut bulk, window / 2).await;
    assert!((window / 2..=window).contains(&bytes), "{bytes}");
    let opens = timeout(Duration::from_millis(100), peer.connection.open_uni()).await;
    assert!(opens.is_err(), "one pipe of each kind");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_oldest_of_too_many_silent_peers_go_and_honest_ones_come_in() {
    let master = master(None);
    let mut silent = Vec::new();
    for _ in 0..limits::STRANGERS + 8 {
        silent.push(master.peer().await);
    }
    for (number, peer) in silent.iter().take(8).enumerate() {
        assert_eq!(peer.closed().await, AbortCode::Busy, "{number}");
    }
    let open = |peer: &&Peer| peer.connection.close_reason().is_none();
    assert_eq!(silent.iter().filter(open).count(), limits::STRANGERS, "no more, and no fewer");
    master.check_open().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn datagrams_of_nonsense_are_ignored_and_not_multiplied() {
    let master = master(None);
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket.connect(master.address()).unwrap();
    let mut word = 1_u64;
    let mut random = |length: usize| -> Vec<u8> {
        let next = |_| {
            word = word.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (word >> 56) as u8
        };
        (0..length).map(next).collect()
    };
    let mut sent = 0;
    for round in 0..2000 {
        let mut bytes = random([1, 20, 100, 1200, 1472][round % 5]);
        match round % 3 {
            // A long header of version 1, of an `Initial` packet; and of a version that nobody speaks.
            0 if bytes.len() >= 20 => bytes[..6].copy_from_slice(&[0xC0, 0, 0, 0, 1, 8]),
            1 if bytes.len() >= 20 => bytes[..6].copy_from_slice(&[0xC0, 0x0A, 0x0A, 0x0A, 0x0A, 8]),
            _ => {}
        }
        sent += socket.send(&bytes).unwrap_or(0);
    }
    master.check_open().await;
    socket.set_nonblocking(true).unwrap();
    let mut back = 0;
    while let Ok(length) = socket.recv(&mut [0; 2048]) {
        back += length;
    }
    assert!(back <= sent, "{back} bytes for {sent}");
}
