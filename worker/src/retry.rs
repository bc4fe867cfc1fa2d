//! A worker that comes back: joining again after a connection is lost, slower and slower.

use crate::{JoinError, Stop, WorkerConfig, WorkerError, join::serve_master};
use std::{
    fmt::Display,
    hash::{BuildHasher, Hasher, RandomState},
    time::Duration,
};
use tessera_trust::Identity;
use tessera_wire::{JoinString, Refusal};
use tokio::{
    sync::watch,
    time::{Instant, sleep},
};

/// How long a worker tries to join.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RetryConfig {
    /// When no master has taken it yet.
    pub at_first: Duration,
    /// When one has, counted from the connection's loss; `None`: for ever.
    pub again: Option<Duration>,
    /// Whether the join string may be another one next time: then a master that is not the one it names is worth another attempt.
    pub join_may_change: bool,
}

impl RetryConfig {
    /// The longest pause before the second attempt; it doubles with each that follows.
    const FIRST_PAUSE: Duration = Duration::from_millis(500);

    /// The longest pause: a crew of a thousand then makes 70 attempts a second at most, and a master that is back is found in half a
    /// minute.
    const LONGEST_PAUSE: Duration = Duration::from_secs(30);

    /// A session that lasted so long is no reason to be slow.
    const STABLE: Duration = Self::LONGEST_PAUSE;

    /// The pause after `failures` failed attempts, at least one: exponential backoff with full jitter, evenly spread between zero and the
    /// bound by `random`, so that workers that lost their master together do not come back together (Brooker 2015, *Exponential Backoff
    /// and Jitter*).
    fn pause(failures: u32, random: u64) -> Duration {
        let doublings = 1 << failures.saturating_sub(1).min(16);
        let most = Self::FIRST_PAUSE.saturating_mul(doublings).min(Self::LONGEST_PAUSE);
        let micros = (u128::from(random) * (most.as_micros() + 1)) >> 64;
        // At most `LONGEST_PAUSE`.
        Duration::from_micros(micros as u64)
    }

    /// Whether trying again is worth it after `error`.
    fn may_pass(&self, error: &WorkerError) -> bool {
        let is_about_join = matches!(
            error,
            WorkerError::Join(JoinError::OtherMaster { .. })
                | WorkerError::Refused(Refusal::Token | Refusal::Expired)
        );
        error.may_pass() || (self.join_may_change && is_about_join)
    }
}

/// Joins the master of the join string that `find` gives and serves it like [`serve_master`]; joins again when the connection is lost,
/// until a master dismisses the worker, refuses it for good, `retry` says that it is enough, or `stop` asks for an end.
///
/// `find` is called again before each attempt if [`RetryConfig::join_may_change`]; what it finds wrong then is logged, and the last join
/// string is used.
pub async fn stay<E: From<WorkerError> + Display>(
    mut find: impl FnMut() -> Result<JoinString, E>,
    own: &Identity,
    mut config: WorkerConfig,
    retry: RetryConfig,
    mut stop: watch::Receiver<Stop>,
) -> Result<(), E> {
    let mut join = find()?;
    let mut has_served = false;
    let mut failures = 0;
    let mut failing_since = Instant::now();
    loop {
        let begun = Instant::now();
        let error = match serve_master(&join, own, config.clone(), stop.clone()).await {
            Ok(_) => return Ok(()),
            Err(error) => error,
        };
        // Before a master has taken it, these are errors of joining.
        if matches!(error, WorkerError::Lost(_) | WorkerError::Aborted { .. }) {
            has_served = true;
            failing_since = Instant::now();
            if begun.elapsed() >= RetryConfig::STABLE {
                failures = 0;
            }
        }
        let limit = if has_served { retry.again } else { Some(retry.at_first) };
        let left = limit.map_or(Duration::MAX, |limit| limit.saturating_sub(failing_since.elapsed()));
        // A GPU that has failed is no reason to stay away, if the CPU will do.
        let falls_back = config.backend.has_fallback();
        if falls_back {
            config.backend = config.backend.or_fallback();
            tracing::warn!("{}", config.backend.note());
        }
        if !(falls_back || retry.may_pass(&error)) || left.is_zero() {
            return Err(error.into());
        }
        failures += 1;
        // A hasher's seed is random, and that is all that is needed.
        let random = RandomState::new().build_hasher().finish();
        let pause = RetryConfig::pause(failures, random).min(left);
        tracing::warn!("{error}; joining again in {:.1} s", pause.as_secs_f64());
        tokio::select! {
            () = sleep(pause) => {}
            Ok(_) = stop.wait_for(|stop| *stop != Stop::No) => return Ok(()),
        }
        if retry.join_may_change {
            match find() {
                Ok(found) => join = found,
                Err(error) => tracing::warn!("{error}"),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Backend, BackendChoice, BackendConfig};
    use std::{net::Ipv4Addr, sync::Arc};
    use tessera_wire::{AbortCode, Token};
    use tokio::time::timeout;

    /// A master that takes a connection and the first bytes of its control stream, and closes it then with `code`.
    fn evicting(own: &Identity, code: AbortCode) -> (quinn::Endpoint, JoinString) {
        let tls = tessera_trust::master_config(own).unwrap();
        let tls = quinn::crypto::rustls::QuicServerConfig::try_from(tls).unwrap();
        let config = quinn::ServerConfig::with_crypto(Arc::new(tls));
        let endpoint = quinn::Endpoint::server(config, (Ipv4Addr::LOCALHOST, 0).into()).unwrap();
        let port = endpoint.local_addr().unwrap().port();
        let host = Ipv4Addr::LOCALHOST.to_string();
        let join = JoinString { host, port, fingerprint: own.fingerprint(), token: Token::default() };
        let door = endpoint.clone();
        tokio::spawn(async move {
            while let Some(incoming) = door.accept().await {
                let connection = incoming.await.expect("the worker shows a certificate");
                let (_answer, mut control) = connection.accept_bi().await.expect("it says `Hello`");
                control.read(&mut [0; 64]).await.expect("it says `Hello`");
                connection.close(code.number().into(), b"\x1b[2Jgo away");
            }
        });
        (endpoint, join)
    }

    #[tokio::test]
    async fn a_master_that_has_let_nobody_in_is_not_joined_again_for_ever() {
        let retry = RetryConfig { at_first: Duration::ZERO, again: None, join_may_change: false };
        for code in [AbortCode::Busy, AbortCode::Internal] {
            let (master, own) = (Identity::new().unwrap(), Identity::new().unwrap());
            let (_endpoint, join) = evicting(&master, code);
            let cpu = BackendConfig { choice: BackendChoice::Cpu, ..BackendConfig::default() };
            let config = WorkerConfig {
                name: "w".into(),
                threads: 1,
                backend: Backend::open(&cpu).expect("there is a CPU"),
                memory: Some(0),
                cache: None,
            };
            let (_ask, asked) = watch::channel(Stop::No);
            let find = || Ok::<_, WorkerError>(join.clone());
            let ended = timeout(Duration::from_secs(100), stay(find, &own, config, retry, asked)).await;
            let error = ended.expect("it tries once").expect_err("nobody has taken it");
            let address = join.address();
            match (code, error) {
                (AbortCode::Busy, WorkerError::Join(error)) => assert_eq!(error, JoinError::Busy { address }),
                (_, WorkerError::Join(JoinError::Unreachable { reason, .. })) => {
                    assert!(reason.contains("[2Jgo away") && !reason.contains('\x1b'), "{reason}");
                }
                (code, error) => panic!("{code:?}: {error:?}"),
            }
        }
    }

    #[test]
    fn pauses_double_up_to_a_bound_and_are_spread_over_all_of_it() {
        let most = |failures| RetryConfig::pause(failures, u64::MAX);
        assert_eq!([1, 2, 3, 4].map(|n| most(n).as_millis()), [500, 1000, 2000, 4000]);
        assert_eq!([7, 17, u32::MAX].map(most), [RetryConfig::LONGEST_PAUSE; 3]);
        for failures in [1, 5, 100] {
            assert_eq!(RetryConfig::pause(failures, 0), Duration::ZERO);
            let half = RetryConfig::pause(failures, 1 << 63);
            assert!(half.abs_diff(most(failures) / 2) <= Duration::from_micros(1), "{half:?}");
        }
    }

    #[test]
    fn what_cannot_change_is_not_tried_again() {
        let address = || "m:1".to_string();
        let fixed = RetryConfig { at_first: Duration::MAX, again: None, join_may_change: false };
        let file = RetryConfig { join_may_change: true, ..fixed };
        let other = WorkerError::Join(JoinError::OtherMaster { address: address() });
        let stale = WorkerError::Refused(Refusal::Token);
        let expired = WorkerError::Refused(Refusal::Expired);
        for error in [other, stale, expired] {
            assert!(!fixed.may_pass(&error) && file.may_pass(&error), "{error}");
        }
        let lost = WorkerError::Lost("x".into());
        let silent = WorkerError::Join(JoinError::Unreachable { address: address(), reason: "x".into() });
        let full = WorkerError::Refused(Refusal::Full { limit: 1 });
        for error in [lost, silent, full] {
            assert!(fixed.may_pass(&error) && file.may_pass(&error), "{error}");
        }
        let version = WorkerError::Refused(Refusal::Version { supported: vec![9] });
        let wrong = WorkerError::Aborted { code: AbortCode::Malformed, detail: "x".into() };
        let replaced = WorkerError::Aborted { code: AbortCode::Replaced, detail: "x".into() };
        for error in [version, wrong, replaced] {
            assert!(!fixed.may_pass(&error) && !file.may_pass(&error), "{error}");
        }
    }
}
