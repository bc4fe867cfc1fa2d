//! What GPUs there are, and which one is meant.

use crate::backend::{Adapter, BackendError};
use pollster::block_on;
use std::sync::OnceLock;
use wgpu::{Backends, DeviceType, Features, Instance, InstanceDescriptor, InstanceFlags};

/// Storage buffers that a kernel needs at least: four of its own, one for slots, one for words, and two for paths that are taken step by
/// step. (Kernels for probes need two more.)
pub(super) const STORAGE_BUFFERS: u32 = 8;

/// The drivers are looked for once in a process.
fn instance() -> &'static Instance {
    static INSTANCE: OnceLock<Instance> = OnceLock::new();
    INSTANCE.get_or_init(|| {
        Instance::new(InstanceDescriptor {
            backends: Backends::VULKAN | Backends::METAL | Backends::DX12,
            // Neither debugging nor validation layers, whatever the build: they are not there on most machines and slow.
            flags: InstanceFlags::empty(),
            ..InstanceDescriptor::new_without_display_handle()
        })
    })
}

/// All adapters in the order of their numbers: real GPUs first, the largest kind first, as far as the driver's order allows.
fn found() -> Vec<(wgpu::Adapter, Adapter)> {
    let mut adapters = block_on(instance().enumerate_adapters(Backends::all()));
    adapters.sort_by_key(|adapter| rank(adapter.get_info().device_type));
    adapters
        .into_iter()
        .enumerate()
        .map(|(index, adapter)| {
            let described = describe(index, &adapter);
            (adapter, described)
        })
        .collect()
}

/// All adapters of this machine, usable or not.
pub(crate) fn list() -> Vec<Adapter> {
    found().into_iter().map(|(_, described)| described).collect()
}

fn rank(kind: DeviceType) -> u32 {
    match kind {
        DeviceType::DiscreteGpu => 0,
        DeviceType::IntegratedGpu => 1,
        DeviceType::VirtualGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    }
}

fn describe(index: usize, adapter: &wgpu::Adapter) -> Adapter {
    let info = adapter.get_info();
    let limits = adapter.limits();
    let unusable = (limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS)
        .then(|| {
            let has = limits.max_storage_buffers_per_shader_stage;
            format!("it has {has} storage buffers a stage, {STORAGE_BUFFERS} are needed")
        })
        .or_else(|| {
            let has = limits.max_compute_invocations_per_workgroup;
            (has < 64).then(|| format!("it has work-groups of {has}, 64 are needed"))
        });
    let driver = [info.driver.as_str(), info.driver_info.as_str()];
    let driver: Vec<_> = driver.into_iter().filter(|part| !part.is_empty()).collect();
    Adapter {
        index,
        name: info.name,
        driver: if driver.is_empty() { "unknown".into() } else { driver.join(" ") },
        api: info.backend.to_str().to_owned(),
        kind: match info.device_type {
            DeviceType::DiscreteGpu => "discrete",
            DeviceType::IntegratedGpu => "integrated",
            DeviceType::VirtualGpu => "virtual",
            DeviceType::Cpu => "software",
            DeviceType::Other => "other",
        },
        memory: memory(adapter),
        limits: vec![
            ("storage_binding_bytes", limits.max_storage_buffer_binding_size),
            ("buffer_bytes", limits.max_buffer_size),
            ("storage_buffers", limits.max_storage_buffers_per_shader_stage.into()),
            ("workgroup_invocations", limits.max_compute_invocations_per_workgroup.into()),
        ],
        has_f64: adapter.features().contains(Features::SHADER_F64),
        unusable,
    }
}

/// Bytes of the largest heap of the device's own memory, where the driver is Vulkan's.
#[expect(
    unsafe_code,
    reason = "wgpu does not tell; the handles are used within this call, while the adapter lives"
)]
fn memory(adapter: &wgpu::Adapter) -> Option<u64> {
    /// `VK_MEMORY_HEAP_DEVICE_LOCAL_BIT`.
    const DEVICE_LOCAL: u32 = 1;
    // SAFETY: nothing is destroyed through the handle, and reading a physical device's properties has no other condition than that
    // it belongs to the instance, which lives as long as the adapter.
    unsafe {
        let adapter = adapter.as_hal::<wgpu::hal::api::Vulkan>()?;
        let instance = adapter.shared_instance().raw_instance();
        let properties = instance.get_physical_device_memory_properties(adapter.raw_physical_device());
        let heaps = properties.memory_heaps.get(..properties.memory_heap_count as usize)?;
        heaps.iter().filter(|heap| heap.flags.as_raw() & DEVICE_LOCAL != 0).map(|heap| heap.size).max()
    }
}

/// Metal does not say.
#[cfg(target_vendor = "apple")]
fn memory(_: &wgpu::Adapter) -> Option<u64> {
    None
}

/// The adapter that `wanted` names (its number, or a part of its name, whatever the case), or the best one that is usable.
pub(crate) fn choose(wanted: Option<&str>) -> Result<(wgpu::Adapter, Adapter), BackendError> {
    let mut found = found();
    if found.is_empty() {
        return Err(BackendError::NoAdapter);
    }
    let described: Vec<_> = found.iter().map(|(_, described)| described.clone()).collect();
    let index = pick(&described, wanted)?;
    Ok(found.swap_remove(index))
}

/// [`choose`] among descriptions.
fn pick(adapters: &[Adapter], wanted: Option<&str>) -> Result<usize, BackendError> {
    let unusable = |adapter: &Adapter, reason: &str| BackendError::Unusable {
        name: adapter.name.clone(),
        reason: reason.to_owned(),
    };
    let Some(wanted) = wanted else {
        return match adapters.iter().position(|adapter| adapter.unusable.is_none()) {
            Some(index) => Ok(index),
            None => Err(match adapters.first() {
                Some(first) => unusable(first, first.unusable.as_deref().unwrap_or_default()),
                None => BackendError::NoAdapter,
            }),
        };
    };
    let lower = wanted.to_lowercase();
    let by_number = wanted.parse().ok().filter(|&index: &usize| index < adapters.len());
    let by_name = || adapters.iter().position(|adapter| adapter.name.to_lowercase().contains(&lower));
    let Some(index) = by_number.or_else(by_name) else {
        let names: Vec<_> = adapters.iter().map(|a| format!("{} ({})", a.index, a.name)).collect();
        return Err(BackendError::NoSuchAdapter { wanted: wanted.to_owned(), found: names.join(", ") });
    };
    match &adapters[index].unusable {
        Some(reason) => Err(unusable(&adapters[index], reason)),
        None => Ok(index),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(index: usize, name: &str, unusable: Option<&str>) -> Adapter {
        Adapter {
            index,
            name: name.into(),
            driver: "d".into(),
            api: "vulkan".into(),
            kind: "discrete",
            memory: None,
            limits: Vec::new(),
            has_f64: true,
            unusable: unusable.map(Into::into),
        }
    }

    #[test]
    fn a_number_a_part_of_a_name_or_the_first_that_is_usable() {
        let adapters = [adapter(0, "Old Thing", Some("small")), adapter(1, "Fast 9000", None)];
        assert_eq!(pick(&adapters, None), Ok(1));
        assert_eq!((pick(&adapters, Some("1")), pick(&adapters, Some("fast"))), (Ok(1), Ok(1)));
        assert_eq!(pick(&adapters, Some("9000")), Ok(1), "a number beyond the list may be a name");
        let error = pick(&adapters, Some("0")).expect_err("unusable").to_string();
        assert!(error.contains("Old Thing") && error.contains("small"), "{error}");
        let error = pick(&adapters, Some("slow")).expect_err("no such").to_string();
        assert!(error.contains("0 (Old Thing), 1 (Fast 9000)"), "{error}");
        assert_eq!(pick(&[], None), Err(BackendError::NoAdapter));
    }
}
