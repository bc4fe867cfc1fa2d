//! A relay in a process of its own, as the one that needs it holds it.

use super::link::LinkProfile;
use super::relay::RelayReport;
use std::io::{self, BufRead, BufReader, Write};
use std::net::SocketAddr;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::{Arc, Mutex, PoisonError};
use tessera_master::Detour;

/// A running `tessera bench relay`; dropping it ends it.
pub struct RelayProcess {
    child: Child,
    input: ChildStdin,
    output: BufReader<ChildStdout>,
    address: SocketAddr,
}

impl RelayProcess {
    /// Starts one for a master at `upstream`.
    pub fn start(profile: &LinkProfile, upstream: SocketAddr) -> io::Result<Self> {
        let text = profile.to_toml().map_err(io::Error::other)?;
        let mut command = Command::new(std::env::current_exe()?);
        command.args(["bench", "relay", "--profile", &text, "--upstream", &upstream.to_string()]);
        command.stdin(Stdio::piped()).stdout(Stdio::piped());
        // A terminal's Ctrl-C is for the process that holds it, with which it ends.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(&mut command, 0);
        let mut child = Started(Some(command.spawn()?));
        let (input, output) = child.pipes().ok_or_else(|| io::Error::other("a relay without pipes"))?;
        let mut output = BufReader::new(output);
        let address = line(&mut output)?.trim().parse().map_err(io::Error::other)?;
        let child = child.0.take().ok_or_else(|| io::Error::other("a relay that is gone"))?;
        Ok(Self { child, input, output, address })
    }

    /// Where workers join.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What became of the packets so far.
    pub fn report(&mut self) -> io::Result<RelayReport> {
        self.input.write_all(b"report\n")?;
        serde_json::from_str(&line(&mut self.output)?).map_err(io::Error::other)
    }
}

impl Drop for RelayProcess {
    fn drop(&mut self) {
        end(&mut self.child);
    }
}

/// A relay that is there once a cluster has asked for the way through it.
pub type Waiting = Arc<Mutex<Option<RelayProcess>>>;

/// The way through a relay for `profile`, for [`LocalWorkers`](tessera_master::LocalWorkers), and where the relay will be; dropping that ends
/// it. `None` for a link that changes nothing.
pub fn through(profile: &LinkProfile) -> (Option<Detour>, Waiting) {
    let waiting = Waiting::default();
    let (place, profile) = (waiting.clone(), profile.clone());
    let detour = (!profile.is_straight()).then(|| {
        Detour::new(move |master| {
            let relay = RelayProcess::start(&profile, master)?;
            let address = relay.address();
            *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(relay);
            Ok(address)
        })
    });
    (detour, waiting)
}

/// A child that is ended if it does not get as far as saying its address.
struct Started(Option<Child>);

impl Started {
    fn pipes(&mut self) -> Option<(ChildStdin, ChildStdout)> {
        let child = self.0.as_mut()?;
        Some((child.stdin.take()?, child.stdout.take()?))
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        if let Some(child) = &mut self.0 {
            end(child);
        }
    }
}

/// It holds nothing that it would have to put in order.
fn end(child: &mut Child) {
    let _ = child.kill();
    let _ = child.wait();
}

/// The next line that it says.
fn line(output: &mut BufReader<ChildStdout>) -> io::Result<String> {
    let mut line = String::new();
    if output.read_line(&mut line)? == 0 {
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, "the relay has ended"));
    }
    Ok(line)
}
