//! Every kernel parses, validates, and is what the table says; every WGSL file is used.

use std::collections::BTreeSet;
use std::path::Path;

use backlot_shaders::{Access, Kernel, kernels};
use naga::valid::{Capabilities, ValidationFlags, Validator};

#[test]
fn every_kernel_is_valid_and_as_the_table_says() {
    let mut checked_bindings = 0;
    for kernel in kernels::ALL {
        let module = parse(kernel);
        // What uses subgroups says so.
        let capabilities = if kernel.uses_subgroup {
            Capabilities::SUBGROUP
        } else {
            Capabilities::empty()
        };
        Validator::new(ValidationFlags::all(), capabilities)
            .validate(&module)
            .unwrap_or_else(|error| panic!("{}: {error:?}", kernel.name));
        let entries: Vec<_> = module
            .entry_points
            .iter()
            .map(|e| e.name.as_str())
            .collect();
        assert_eq!(entries, [kernel.entry], "one entry point a kernel");
        let overrides: BTreeSet<_> = module
            .overrides
            .iter()
            .filter_map(|(_, o)| o.name.clone())
            .collect();
        let constants: BTreeSet<_> = kernel
            .constants()
            .iter()
            .map(|(name, _)| *name)
            .chain(kernel.parameters.iter().copied())
            .map(str::to_owned)
            .collect();
        assert_eq!(
            overrides, constants,
            "{}: overrides and constants",
            kernel.name
        );
        checked_bindings += check_bindings(kernel, &module);
    }
    println!(
        "{} kernels and {checked_bindings} bindings checked",
        kernels::ALL.len()
    );
    assert!(
        !kernels::ALL.is_empty() && checked_bindings > 0,
        "nothing was checked"
    );
}

#[test]
fn table_and_folder_name_the_same_files() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("wgsl");
    let on_disk: BTreeSet<String> = std::fs::read_dir(&folder)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    let in_table: BTreeSet<String> = kernels::ALL
        .iter()
        .flat_map(|kernel| kernel.files.iter().map(|file| (*file).to_owned()))
        .collect();
    assert_eq!(on_disk, in_table);
    for kernel in kernels::ALL {
        let joined: String = kernel
            .files
            .iter()
            .map(|file| std::fs::read_to_string(folder.join(file)).unwrap())
            .collect();
        assert_eq!(joined, kernel.source, "{}: files and source", kernel.name);
    }
}

#[test]
fn a_broken_kernel_is_rejected() {
    let broken = kernels::MARCH_DENSITY
        .source
        .replace("-> RaySummary", "-> f32");
    assert_ne!(
        broken,
        kernels::MARCH_DENSITY.source,
        "the kernel was not broken"
    );
    let rejected = match naga::front::wgsl::parse_str(&broken) {
        Err(_) => true,
        Ok(module) => Validator::new(ValidationFlags::all(), Capabilities::empty())
            .validate(&module)
            .is_err(),
    };
    assert!(rejected, "a function that returns the wrong type passed");
}

fn parse(kernel: &Kernel) -> naga::Module {
    naga::front::wgsl::parse_str(kernel.source)
        .unwrap_or_else(|error| panic!("{}: {}", kernel.name, error.emit_to_string(kernel.source)))
}

/// Compares the table's bindings with the module's; returns how many were compared.
fn check_bindings(kernel: &Kernel, module: &naga::Module) -> usize {
    let mut seen = vec![None; kernel.bindings.len()];
    for (_, variable) in module.global_variables.iter() {
        let Some(binding) = variable.binding else {
            continue;
        };
        assert_eq!(binding.group, 0, "{}: one bind group", kernel.name);
        let access = match variable.space {
            naga::AddressSpace::Uniform => Access::Uniform,
            naga::AddressSpace::Storage { access }
                if access.contains(naga::StorageAccess::STORE) =>
            {
                Access::ReadWrite
            }
            naga::AddressSpace::Storage { .. } => Access::Read,
            other => panic!("{}: {other:?}", kernel.name),
        };
        let inner = &module.types[variable.ty].inner;
        let min_bytes = match inner {
            naga::TypeInner::Array {
                stride,
                size: naga::ArraySize::Dynamic,
                ..
            } => u64::from(*stride),
            other => u64::from(other.size(module.to_ctx())),
        };
        let slot = &mut seen[binding.binding as usize];
        assert!(
            slot.is_none(),
            "{}: binding {} twice",
            kernel.name,
            binding.binding
        );
        *slot = Some((variable.name.clone().unwrap_or_default(), access, min_bytes));
    }
    for (number, (declared, found)) in kernel.bindings.iter().zip(&seen).enumerate() {
        let found = found
            .as_ref()
            .unwrap_or_else(|| panic!("{}: binding {number} is not in the WGSL", kernel.name));
        assert_eq!(
            (declared.name, declared.access, declared.min_bytes),
            (found.0.as_str(), found.1, found.2)
        );
    }
    seen.len()
}
