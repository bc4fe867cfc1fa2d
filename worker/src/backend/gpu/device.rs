//! An opened GPU: its limits, its errors, and how it is lost.

use super::kernel::{Kernel, KernelKey, compile};
use super::{GpuError, KERNEL_VERSION, adapter};
use crate::backend::{Adapter, BackendError};
use pollster::block_on;
use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use wgpu::{
    Device, DeviceDescriptor, ErrorFilter, Features, Limits, PollError, PollType, Queue, SubmissionIndex,
};

/// An opened GPU. Cheap to clone.
#[derive(Clone)]
pub(crate) struct Gpu {
    inner: Arc<Inner>,
}

struct Inner {
    device: Device,
    queue: Queue,
    adapter: Adapter,
    limits: Limits,
    /// Whether kernels compute in `f64` where it matters.
    uses_f64: bool,
    class: String,
    /// The first thing that went wrong.
    fault: Arc<Mutex<Option<String>>>,
    /// Kernels that were compiled, for scenes of every kind.
    kernels: Mutex<HashMap<KernelKey, Arc<Kernel>>>,
}

impl fmt::Debug for Gpu {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Gpu").field(&self.inner.class).finish()
    }
}

impl Gpu {
    /// Opens the adapter that `wanted` names, or the best; `f64` as it can, or not even if it can.
    pub(crate) fn open(wanted: Option<&str>, f64_too: bool) -> Result<Self, BackendError> {
        let (chosen, adapter) = adapter::choose(wanted)?;
        let uses_f64 = f64_too && adapter.has_f64;
        // What this adapter has, not what every one has: bindings of 128 MiB are too small for scenes.
        let limits = chosen.limits();
        let descriptor = DeviceDescriptor {
            label: Some("tessera"),
            required_features: if uses_f64 { Features::SHADER_F64 } else { Features::empty() },
            required_limits: limits.clone(),
            ..DeviceDescriptor::default()
        };
        let (device, queue) = block_on(chosen.request_device(&descriptor))
            .map_err(|e| BackendError::Unusable { name: adapter.name.clone(), reason: one_line(&e) })?;
        let fault: Arc<Mutex<Option<String>>> = Arc::default();
        let note = |fault: &Mutex<Option<String>>, what: String| {
            fault.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(what);
        };
        let seen = fault.clone();
        device.set_device_lost_callback(move |reason, message| {
            // Dropping the device ends it too.
            if reason != wgpu::DeviceLostReason::Destroyed {
                note(&seen, one_line(&message));
            }
        });
        let seen = fault.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| note(&seen, one_line(&error))));
        let precision = if uses_f64 { "f64" } else { "f32" };
        let class = format!("gpu-{KERNEL_VERSION} {} ({}, {precision})", adapter.name, adapter.driver);
        Ok(Self {
            inner: Arc::new(Inner {
                device,
                queue,
                adapter,
                limits,
                uses_f64,
                class,
                fault,
                kernels: Mutex::default(),
            }),
        })
    }

    pub(crate) fn device(&self) -> &Device {
        &self.inner.device
    }

    pub(crate) fn queue(&self) -> &Queue {
        &self.inner.queue
    }

    /// The kernel of `key`, compiled the first time.
    pub(super) fn kernel(&self, key: KernelKey) -> Result<Arc<Kernel>, GpuError> {
        let mut kernels = self.inner.kernels.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(kernel) = kernels.get(&key) {
            return Ok(kernel.clone());
        }
        let begun = Instant::now();
        let kernel = Arc::new(compile(self, &key)?);
        let (name, purpose) = (key.variant.name(), key.purpose);
        tracing::debug!("compiled the kernel {name} ({purpose:?}) in {:.1?}", begun.elapsed());
        kernels.insert(key, kernel.clone());
        Ok(kernel)
    }

    /// What it is.
    pub(crate) fn adapter(&self) -> &Adapter {
        &self.inner.adapter
    }

    pub(crate) fn limits(&self) -> &Limits {
        &self.inner.limits
    }

    pub(crate) fn uses_f64(&self) -> bool {
        self.inner.uses_f64
    }

    /// Names its arithmetic: kernels, adapter, driver.
    pub(crate) fn numeric_class(&self) -> &str {
        &self.inner.class
    }

    /// Whether the adapter is a driver that plays a GPU on the CPU.
    pub(crate) fn is_software(&self) -> bool {
        self.inner.adapter.kind == "software"
    }

    /// The first thing that went wrong, if anything did.
    pub(crate) fn check(&self) -> Result<(), GpuError> {
        let fault = self.inner.fault.lock().unwrap_or_else(PoisonError::into_inner);
        fault.as_ref().map_or(Ok(()), |what| Err(GpuError::Lost(what.clone())))
    }

    /// Waits until a submission is done; after `patience` the GPU is taken for hung.
    pub(crate) fn wait(&self, submission: SubmissionIndex, patience: Duration) -> Result<(), GpuError> {
        let wait = PollType::Wait { submission_index: Some(submission), timeout: Some(patience) };
        match self.inner.device.poll(wait) {
            Ok(_) => self.check(),
            Err(PollError::Timeout) => {
                // Dropping a queue waits for it, for ever: this one is kept.
                std::mem::forget(self.clone());
                self.check()?;
                Err(GpuError::Hung { seconds: patience.as_secs() })
            }
            Err(e) => Err(GpuError::Lost(one_line(&e))),
        }
    }

    /// Does `make`, and says what the driver had against it.
    pub(crate) fn try_make<T>(&self, make: impl FnOnce() -> T) -> Result<T, GpuError> {
        let device = &self.inner.device;
        let memory = device.push_error_scope(ErrorFilter::OutOfMemory);
        let internal = device.push_error_scope(ErrorFilter::Internal);
        let validation = device.push_error_scope(ErrorFilter::Validation);
        let made = make();
        let errors = [block_on(validation.pop()), block_on(internal.pop()), block_on(memory.pop())];
        match errors.into_iter().flatten().next() {
            Some(wgpu::Error::OutOfMemory { .. }) => Err(GpuError::NoMemory),
            Some(error) => Err(GpuError::Refused(one_line(&error))),
            None => self.check().map(|()| made),
        }
    }
}

/// What an error says, on one line and not too long.
fn one_line(error: &impl fmt::Display) -> String {
    let text = error.to_string();
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.chars().take(400).collect()
}
