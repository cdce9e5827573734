//! The directions of dependency that Cargo cannot enforce, read from the sources.

use std::path::{Path, PathBuf};

/// Names that may be used only under the given paths; paths are relative to the workspace.
struct Fence {
    /// Crate name as it stands in a path, e.g. `sled` for `sled::Db`.
    name: &'static str,
    allowed: &'static [&'static str],
}

const FENCES: &[Fence] = &[
    Fence {
        name: "sled",
        allowed: &["server/src/store/", "migrations/"],
    },
    Fence {
        name: "wgpu",
        allowed: &["engine/src/backend/gpu/"],
    },
    Fence {
        name: "tonic",
        allowed: &[
            "server/src/api/",
            "server/src/server.rs",
            // A client of the served API.
            "server/src/server_tests.rs",
            "client/",
            "proto/",
            "tests/",
        ],
    },
    Fence {
        name: "prost",
        allowed: &["server/src/api/", "client/", "proto/", "tests/"],
    },
    Fence {
        name: "backlot_proto",
        allowed: &[
            "server/src/api/",
            // Its cases are written as clients send them.
            "server/src/ingest/validate_tests.rs",
            "server/src/server.rs",
            // A client of the served API.
            "server/src/server_tests.rs",
            "client/",
            "proto/",
            "tests/",
        ],
    },
    Fence {
        name: "tokio",
        allowed: &["server/", "client/", "tests/"],
    },
    Fence {
        name: "arrow_ipc",
        allowed: &["client/src/argoverse/", "client/tests/datasets/"],
    },
    Fence {
        name: "parquet",
        allowed: &[
            "client/src/waymo/",
            "client/src/labels/",
            "client/tests/datasets/",
        ],
    },
    Fence {
        name: "ort",
        allowed: &["server/src/segment/onnxruntime.rs"],
    },
    Fence {
        name: "tract_onnx",
        allowed: &["server/src/segment/tract.rs"],
    },
    Fence {
        name: "object_store",
        allowed: &["server/src/store/"],
    },
];

#[test]
fn every_name_stays_behind_its_fence() {
    let root = workspace();
    let sources = rust_sources(&root);
    assert!(
        sources.len() > 50,
        "only {} sources found under the workspace",
        sources.len()
    );
    let mut breaches = Vec::new();
    let mut uses = vec![0; FENCES.len()];
    for path in &sources {
        let text = std::fs::read_to_string(root.join(path)).unwrap();
        for (fence, uses) in FENCES.iter().zip(&mut uses) {
            for line in lines_that_name(&text, fence.name) {
                *uses += 1;
                if !fence
                    .allowed
                    .iter()
                    .any(|allowed| path.starts_with(allowed))
                {
                    breaches.push(format!("{path}:{line} names `{}`", fence.name));
                }
            }
        }
    }
    for (fence, uses) in FENCES.iter().zip(uses) {
        assert!(
            uses > 0,
            "`{}` is named nowhere: the fence checks nothing",
            fence.name
        );
    }
    assert!(
        breaches.is_empty(),
        "allowed places are in tests/it/tidy.rs:\n{}",
        breaches.join("\n")
    );
}

#[test]
fn a_breach_is_seen_and_a_comment_is_not() {
    let text = "//! sled:: in prose\nuse sled::Db;\nlet x = unsled::y();\nfn f(_: &sled::Tree) {} // sled::z\n";
    assert_eq!(lines_that_name(text, "sled"), [2, 4]);
}

/// Line numbers of code that names a path beginning with `name`; comments do not count.
fn lines_that_name(text: &str, name: &str) -> Vec<usize> {
    let named = |line: &str| {
        let code = line.split("//").next().unwrap_or_default();
        code.match_indices(&format!("{name}::")).any(|(at, _)| {
            let before = code[..at].chars().next_back();
            !before.is_some_and(|c| c.is_alphanumeric() || c == '_' || c == ':')
        })
    };
    (1..)
        .zip(text.lines())
        .filter(|(_, line)| named(line))
        .map(|(number, _)| number)
        .collect()
}

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .parent()
        .expect("the crate is in the workspace")
        .to_owned()
}

/// Every Rust source of the workspace's crates, relative, with forward slashes.
fn rust_sources(root: &Path) -> Vec<String> {
    let crates = [
        "client",
        "engine",
        "migrations",
        "proto",
        "server",
        "shaders",
        "tests",
    ];
    let mut folders: Vec<PathBuf> = crates.iter().map(|name| root.join(name)).collect();
    let mut sources = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the workspace is readable") {
            let path = entry.expect("its entries are readable").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                let relative = path.strip_prefix(root).expect("it lies in the workspace");
                sources.push(relative.to_string_lossy().replace('\\', "/"));
            }
        }
    }
    sources.sort();
    sources
}
