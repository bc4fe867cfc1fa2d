//! What a case is, and what comes out of it.

use super::backend::Renders;
use serde::Serialize;
use std::cell::RefCell;
use std::fmt::Display;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

/// A hard input with what must come out.
pub struct Case {
    /// The number in `tests/HARD_INPUTS.md`, with a word behind it where one number has several.
    pub id: &'static str,
    pub input: &'static str,
    /// What judges it.
    pub judge: &'static str,
    pub run: Run,
}

/// Whom a case is about.
pub enum Run {
    /// What is packed, and what every backend shares.
    Once(fn(Effort) -> Outcome),
    /// Each backend by itself.
    Each(fn(&dyn Renders, Effort) -> Outcome),
}

/// What came out, or why nothing did.
pub type Outcome = Result<Finding, String>;

/// How much is done.
#[derive(Clone, Copy)]
pub struct Effort {
    pub quick: bool,
}

impl Effort {
    /// One of two.
    pub fn pick<T>(self, quick: T, whole: T) -> T {
        if self.quick { quick } else { whole }
    }
}

/// What must have come out, and what did.
#[derive(Clone, Debug, Serialize)]
pub struct Finding {
    pub expected: String,
    pub got: String,
    pub ok: bool,
}

impl Finding {
    /// None of `of` may be a fault.
    pub fn none(faults: usize, of: usize, what: &str) -> Self {
        Self { expected: format!("0 {what} of {of}"), got: faults.to_string(), ok: faults == 0 && of > 0 }
    }

    /// Two things that must be one.
    pub fn equal<T: PartialEq + Display>(what: &str, got: T, wanted: T) -> Self {
        Self { expected: format!("{what} {wanted}"), got: got.to_string(), ok: got == wanted }
    }

    /// A number that a bound is derived for; NaN is beyond it.
    pub fn within(what: &str, got: f64, bound: f64) -> Self {
        Self { expected: format!("{what} <= {bound:.3e}"), got: format!("{got:.3e}"), ok: got <= bound }
    }

    /// Whether enough happened for anything to be tested.
    pub fn at_least(what: &str, got: usize, least: usize) -> Self {
        Self { expected: format!("{what} >= {least}"), got: got.to_string(), ok: got >= least }
    }

    /// Something that holds or does not.
    pub fn holds(expected: impl Into<String>, got: impl Into<String>, ok: bool) -> Self {
        Self { expected: expected.into(), got: got.into(), ok }
    }

    /// All of them.
    pub fn all(parts: impl IntoIterator<Item = Self>) -> Self {
        let parts: Vec<_> = parts.into_iter().collect();
        let join = |of: fn(&Self) -> &str| parts.iter().map(of).collect::<Vec<_>>().join("; ");
        Self {
            expected: join(|part| &part.expected),
            got: join(|part| &part.got),
            ok: !parts.is_empty() && parts.iter().all(|part| part.ok),
        }
    }
}

thread_local! {
    /// What the last panic of this thread said.
    static SAID: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Runs a part of a case; a panic is what came out, not the end.
pub fn guarded(run: impl FnOnce() -> Outcome) -> Outcome {
    static QUIET: Once = Once::new();
    QUIET.call_once(|| {
        std::panic::set_hook(Box::new(|info| {
            let place = info.location().map(|l| format!("{}:{}: ", l.file(), l.line())).unwrap_or_default();
            let said = info.payload_as_str().unwrap_or("a panic");
            SAID.with(|last| *last.borrow_mut() = Some(format!("{place}{said}")));
        }));
    });
    catch_unwind(AssertUnwindSafe(run)).unwrap_or_else(|payload| {
        // Where another thread panicked, only what it said has come here.
        let text = |payload: &Box<dyn std::any::Any + Send>| {
            let said = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
            said.or_else(|| payload.downcast_ref::<String>().cloned())
        };
        let said = SAID.with(|last| last.borrow_mut().take());
        Err(format!("panic: {}", said.or_else(|| text(&payload)).unwrap_or_else(|| "it said nothing".into())))
    })
}
