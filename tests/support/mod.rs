//! Running the built binary: bounded in time, never left behind.

use std::ffi::OsStr;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::mpsc;
use std::time::{Duration, Instant};
use tessera_worker::gpu::{GpuOptions, TestPolicy, probe::GpuProbe};

/// Longest wait for a line of output, or for the end. No run takes a tenth of it on a slow machine; what takes longer hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A run of `tessera` to be.
pub struct Tessera(Command);

impl Tessera {
    /// With these arguments, in a clean environment as far as it matters to the program.
    pub fn new<S: AsRef<OsStr>>(args: impl IntoIterator<Item = S>) -> Self {
        Self::prepared(Command::new(env!("CARGO_BIN_EXE_tessera"))).args(args)
    }

    fn prepared(mut command: Command) -> Self {
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
        for variable in ["RUST_LOG", "TESSERA_SCENES", "TESSERA_JOIN", "NO_COLOR"] {
            command.env_remove(variable);
        }
        Self(command)
    }

    /// The same in a network namespace; the process is the program's own.
    #[cfg(target_os = "linux")]
    pub fn within_network<S: AsRef<OsStr>>(namespace: &str, args: impl IntoIterator<Item = S>) -> Self {
        let mut command = Command::new("ip");
        command.args(["netns", "exec", namespace, env!("CARGO_BIN_EXE_tessera")]);
        Self::prepared(command).args(args)
    }

    /// The same behind a shell's `prelude` (`ulimit -v 100000`), which ends with the program taking the shell's place.
    #[cfg(unix)]
    pub fn behind<S: AsRef<OsStr>>(prelude: &str, args: impl IntoIterator<Item = S>) -> Self {
        let mut command = Command::new("sh");
        command.args(["-c", &format!("{prelude} && exec \"$0\" \"$@\""), env!("CARGO_BIN_EXE_tessera")]);
        Self::prepared(command).args(args)
    }

    /// In this folder.
    pub fn within(mut self, folder: &Path) -> Self {
        self.0.current_dir(folder);
        self
    }

    /// With more arguments.
    pub fn args<S: AsRef<OsStr>>(mut self, args: impl IntoIterator<Item = S>) -> Self {
        self.0.args(args);
        self
    }

    /// With this variable.
    pub fn env(mut self, name: &str, value: impl AsRef<OsStr>) -> Self {
        self.0.env(name, value);
        self
    }

    /// With this file on stdin.
    pub fn stdin(mut self, file: &Path) -> Self {
        self.0.stdin(fs::File::open(file).expect("a file"));
        self
    }

    /// Leading a process group of its own, as a shell starts it.
    #[cfg(unix)]
    pub fn in_own_group(mut self) -> Self {
        std::os::unix::process::CommandExt::process_group(&mut self.0, 0);
        self
    }

    /// Runs it to its end.
    pub fn run(self) -> Outcome {
        self.start().finish()
    }

    /// Starts it.
    pub fn start(mut self) -> Live {
        let mut child = Running(self.0.spawn().expect("the binary starts"));
        let (out, err) = (child.0.stdout.take().expect("piped"), child.0.stderr.take().expect("piped"));
        let what = format!("{:?}", self.0);
        Live { what, child, stdout: lines(out), stderr: lines(err), seen: String::new() }
    }
}

/// A run under way.
pub struct Live {
    what: String,
    child: Running,
    stdout: mpsc::Receiver<String>,
    stderr: mpsc::Receiver<String>,
    /// Of stderr.
    seen: String,
}

impl Live {
    /// Waits until it has written a line with `text` to stderr.
    pub fn wait_for(&mut self, text: &str) {
        while let Some(line) = next(&self.stderr, &self.what) {
            self.seen += &line;
            if line.contains(text) {
                return;
            }
        }
        panic!("{} ended without saying {text:?}: {}", self.what, self.seen);
    }

    /// Waits for the next line that it writes to stdout.
    pub fn line(&mut self) -> String {
        let line = next(&self.stdout, &self.what);
        line.unwrap_or_else(|| panic!("{} ended without a line", self.what)).trim_end().to_owned()
    }

    /// Its process.
    pub fn id(&self) -> u32 {
        self.child.0.id()
    }

    /// Processes that it has started and that have not ended.
    #[cfg(target_os = "linux")]
    pub fn children(&self) -> Vec<u32> {
        let tasks = fs::read_dir(format!("/proc/{}/task", self.id())).expect("it runs");
        tasks
            .filter_map(|task| fs::read_to_string(task.ok()?.path().join("children")).ok())
            .flat_map(|ids| ids.split_whitespace().map(|id| id.parse().expect("an id")).collect::<Vec<_>>())
            .collect()
    }

    /// Waits for its end.
    pub fn finish(mut self) -> Outcome {
        let mut stdout = String::new();
        while let Some(line) = next(&self.stderr, &self.what) {
            self.seen += &line;
        }
        while let Some(line) = next(&self.stdout, &self.what) {
            stdout += &line;
        }
        let status = self.child.0.wait().expect("a child can be waited for");
        Outcome { code: status.code(), stdout, stderr: std::mem::take(&mut self.seen) }
    }
}

/// A child that does not outlive its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        // Both fail when it has ended already, as it should have.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Lines as they come, each with its end. Whatever is written is read at once, so that no full pipe stops the writer.
fn lines(from: impl Read + Send + 'static) -> mpsc::Receiver<String> {
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut from = BufReader::new(from);
        let mut line = Vec::new();
        while matches!(from.read_until(b'\n', &mut line), Ok(1..)) {
            // Nobody listens any more when the test has failed meanwhile.
            let _ = sender.send(String::from_utf8_lossy(&line).into_owned());
            line.clear();
        }
    });
    receiver
}

/// The next line, `None` at the end.
fn next(from: &mpsc::Receiver<String>, what: &str) -> Option<String> {
    match from.recv_timeout(PATIENCE) {
        Ok(line) => Some(line),
        Err(mpsc::RecvTimeoutError::Disconnected) => None,
        Err(mpsc::RecvTimeoutError::Timeout) => panic!("{what} hangs"),
    }
}

/// Sends a signal (`INT`, `KILL`) to a process.
#[cfg(unix)]
pub fn signal(name: &str, process: u32) {
    let status = Command::new("kill").args([format!("-{name}"), process.to_string()]).status();
    assert!(status.expect("kill runs").success(), "process {process} cannot be signalled");
}

/// Sends a signal to every process of the group that `leader` leads, as a terminal does.
#[cfg(unix)]
pub fn signal_group(name: &str, leader: u32) {
    let status = Command::new("kill").args([&format!("-{name}"), "--", &format!("-{leader}")]).status();
    assert!(status.expect("kill runs").success(), "group {leader} cannot be signalled");
}

/// Waits until a process has ended; one that nobody has asked for its status counts.
#[cfg(target_os = "linux")]
pub fn wait_until_ended(process: u32) {
    let deadline = Instant::now() + PATIENCE;
    let runs = || {
        // The state is the first letter behind the name, which is in parentheses.
        let stat = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
        let state = stat.rsplit_once(") ")?.1.chars().next()?;
        (!matches!(state, 'Z' | 'X')).then_some(())
    };
    while runs().is_some() {
        assert!(Instant::now() < deadline, "process {process} is left behind");
        std::thread::yield_now();
    }
}

/// What a run left.
#[derive(Debug)]
pub struct Outcome {
    pub code: Option<i32>,
    pub stdout: String,
    pub stderr: String,
}

impl Outcome {
    /// It succeeded: returns what it printed.
    #[track_caller]
    pub fn ok(self) -> String {
        assert_eq!(self.code, Some(0), "{self:?}");
        self.stdout
    }

    /// It succeeded and printed one JSON object, and nothing else.
    #[track_caller]
    pub fn json(self) -> serde_json::Value {
        assert_eq!(self.stderr, "", "no terminal, no progress");
        let text = self.ok();
        let value: serde_json::Value = serde_json::from_str(&text).expect("one JSON value");
        assert!(value.is_object(), "{text}");
        value
    }

    /// It failed with this exit code and one line that says each of `says`.
    #[track_caller]
    pub fn fails(self, code: i32, says: &[&str]) {
        assert_eq!(self.code, Some(code), "{self:?}");
        assert_eq!(self.stdout, "", "{self:?}");
        assert_eq!(self.stderr.lines().count(), 1, "{self:?}");
        assert!(self.stderr.starts_with("tessera: error: "), "{self:?}");
        for part in says {
            assert!(self.stderr.contains(part), "{part:?} is not in {self:?}");
        }
    }
}

/// A folder of its own for a test.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    pub fn path(&self) -> &Path {
        self.0.path()
    }

    /// The path of a file in it.
    pub fn file(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    /// Writes a file into it.
    pub fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.file(name);
        fs::write(&path, content).expect("a temporary file");
        path
    }

    /// Names of what is in it.
    pub fn names(&self) -> Vec<String> {
        names(self.path())
    }
}

/// Names of what is in a folder, in their order.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).expect("a folder");
    let mut names: Vec<_> =
        entries.map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// The repository's root.
pub fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The folder of real scenes, if there is one: `TESSERA_SCENES`, else `../shared/scenes` beside the repository. Says on stderr when a
/// test skips.
pub fn scene_folder() -> Option<PathBuf> {
    let named = std::env::var_os("TESSERA_SCENES").map(PathBuf::from);
    let folder = named.unwrap_or_else(|| root().join("../shared/scenes"));
    if folder.join("README.md").is_file() {
        return Some(folder);
    }
    skipped(format_args!("no scenes in {}; set TESSERA_SCENES to their folder", folder.display()));
    None
}

/// Says on stderr that something is not tested, and why. Not by `eprintln!`, which the test harness keeps to itself when a test passes.
pub fn skipped(why: impl std::fmt::Display) {
    use std::io::Write;
    // Nothing is lost with a stderr that nobody reads.
    let _ = writeln!(std::io::stderr(), "SKIPPED: {why}");
}

/// A GPU to test with, or a driver that plays one, as `TESSERA_GPU` says; `pretend` is for other tests.
pub fn gpu() -> Option<GpuProbe> {
    let is_pretended = std::env::var("TESSERA_GPU").is_ok_and(|asked| asked == "pretend");
    let policy = if is_pretended { TestPolicy::Off } else { TestPolicy::from_env().expect("TESSERA_GPU") };
    policy.open(GpuOptions::default()).expect("TESSERA_GPU=require, and there is none")
}

/// Two triangles that face +z, one of them higher.
pub const PLY: &str = "\
ply
format ascii 1.0
element vertex 5
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-1 -1 0
1 -1 0
0 1 0.5
1 1 0
0.5 0 1
3 0 1 2
3 0 3 4
";
