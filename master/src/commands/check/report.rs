//! Runs cases and says what came out.

use super::backend::Renders;
use super::case::{Case, Effort, Outcome, Run, guarded};
use crate::commands::progress::Progress;
use crate::commands::run::cores;
use serde::Serialize;
use std::fmt::Write;
use std::time::Instant;

/// What came out. The keys are for programs.
#[derive(Debug, Serialize)]
pub struct Report {
    version: &'static str,
    machine: Machine,
    backends: Vec<Backend>,
    /// What was not checked, and why.
    left_out: Vec<String>,
    quick: bool,
    seconds: f64,
    ok: bool,
    cases: Vec<CaseLine>,
}

#[derive(Debug, Serialize)]
struct Machine {
    os: &'static str,
    arch: &'static str,
    threads: u32,
}

#[derive(Debug, Serialize)]
struct Backend {
    name: String,
    numeric_class: String,
    /// Whether its hits are those of the CPU in every bit.
    exact: bool,
}

#[derive(Debug, Serialize)]
struct CaseLine {
    id: &'static str,
    input: &'static str,
    expected: String,
    got: String,
    judge: &'static str,
    ok: bool,
    seconds: f64,
    /// Of each backend, where a case asks them one by one.
    backends: Vec<BackendLine>,
}

#[derive(Debug, Serialize)]
struct BackendLine {
    backend: String,
    expected: Option<String>,
    got: String,
    ok: bool,
}

impl Report {
    /// Runs every one of `cases` to its end, whatever the others do.
    pub fn make(
        cases: &[&'static Case],
        backends: &[Box<dyn Renders>],
        left_out: Vec<String>,
        effort: Effort,
        progress: &Progress,
    ) -> Self {
        let begin = Instant::now();
        let bar = progress.parts("checking");
        let lines: Vec<_> = cases
            .iter()
            .zip(0..)
            .map(|(case, done)| {
                bar.set(done, cases.len() as u64);
                CaseLine::make(case, backends, effort)
            })
            .collect();
        Self {
            version: env!("CARGO_PKG_VERSION"),
            machine: Machine { os: std::env::consts::OS, arch: std::env::consts::ARCH, threads: cores() },
            backends: backends
                .iter()
                .map(|b| Backend { name: b.name(), numeric_class: b.numeric_class(), exact: b.is_exact() })
                .collect(),
            left_out,
            quick: effort.quick,
            seconds: begin.elapsed().as_secs_f64(),
            ok: lines.iter().all(|line| line.ok),
            cases: lines,
        }
    }

    /// Cases that fail.
    pub fn failed(&self) -> usize {
        self.cases.iter().filter(|case| !case.ok).count()
    }

    /// Cases.
    pub fn count(&self) -> usize {
        self.cases.len()
    }

    /// For people: a line a case, and more about those that fail.
    pub fn text(&self) -> String {
        let mut text = String::new();
        // Writing to a string cannot fail.
        let _ = self.write_text(&mut text);
        text
    }

    fn write_text(&self, t: &mut String) -> std::fmt::Result {
        let Machine { os, arch, threads } = self.machine;
        writeln!(t, "tessera    {}, {os} {arch}, {threads} threads at a time", self.version)?;
        for Backend { name, numeric_class, .. } in &self.backends {
            writeln!(t, "checked    {name}: numeric class {numeric_class}")?;
        }
        for what in &self.left_out {
            writeln!(t, "left out   {what}")?;
        }
        let width = |of: fn(&CaseLine) -> &str| {
            self.cases.iter().map(|case| of(case).chars().count()).max().unwrap_or(0)
        };
        let (id, input) = (width(|case| case.id), width(|case| case.input));
        for case in &self.cases {
            let verdict = if case.ok { "ok  " } else { "FAIL" };
            let CaseLine { expected, got, .. } = case;
            writeln!(t, "{verdict} {:<id$} {:<input$}  {expected}: {got}", case.id, case.input)?;
            for line in case.backends.iter().filter(|line| !line.ok) {
                let expected = line.expected.as_ref().map(|e| format!("{e}: ")).unwrap_or_default();
                writeln!(t, "     {:<id$} {}: {expected}{}", "", line.backend, line.got)?;
            }
            if !case.ok {
                writeln!(
                    t,
                    "     {:<id$} judged by {}; again: tessera check --case {}",
                    "", case.judge, case.id
                )?;
            }
        }
        let verdict = match self.failed() {
            0 => "all pass".to_owned(),
            failed => format!("{failed} FAIL"),
        };
        writeln!(t, "{} cases, {verdict}, {:.1} s", self.count(), self.seconds)
    }
}

impl CaseLine {
    fn make(case: &Case, backends: &[Box<dyn Renders>], effort: Effort) -> Self {
        let begin = Instant::now();
        let (outcomes, backends): (Vec<_>, Vec<_>) = match case.run {
            Run::Once(run) => (vec![guarded(|| run(effort))], Vec::new()),
            Run::Each(run) => {
                let one = |backend: &dyn Renders| {
                    let outcome = guarded(|| run(backend, effort));
                    (outcome.clone(), BackendLine::new(backend.name(), outcome))
                };
                backends.iter().map(|backend| one(&**backend)).unzip()
            }
        };
        // One text where backends beside each other say the same, else each of them.
        let said = |of: fn(&Outcome) -> String| {
            let mut texts: Vec<_> = outcomes.iter().map(of).collect();
            texts.dedup();
            texts.join(" | ")
        };
        Self {
            id: case.id,
            input: case.input,
            judge: case.judge,
            expected: said(|o| o.as_ref().map_or("an answer".into(), |f| f.expected.clone())),
            got: said(|o| o.as_ref().map_or_else(String::clone, |f| f.got.clone())),
            ok: !outcomes.is_empty() && outcomes.iter().all(|o| o.as_ref().is_ok_and(|f| f.ok)),
            seconds: begin.elapsed().as_secs_f64(),
            backends,
        }
    }
}

impl BackendLine {
    fn new(backend: String, outcome: Outcome) -> Self {
        match outcome {
            Ok(finding) => {
                Self { backend, expected: Some(finding.expected), got: finding.got, ok: finding.ok }
            }
            Err(why) => Self { backend, expected: None, got: why, ok: false },
        }
    }
}
