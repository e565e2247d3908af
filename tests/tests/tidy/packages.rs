//! The metadata of the published packages is complete.

use std::{path::Path, process::Command};

use serde_json::Value;

/// The workspace's packages, as cargo describes them.
pub(crate) fn packages(root: &Path) -> Vec<Value> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args([
        "metadata",
        "--no-deps",
        "--format-version",
        "1",
        "--offline",
    ]);
    let output = cargo.current_dir(root).output().expect("cargo runs");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo metadata: {error}");
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = metadata["packages"].as_array().expect("a list of packages");
    packages.clone()
}

/// Whether `publish` allows a registry.
pub(crate) fn is_published(package: &Value) -> bool {
    package["publish"] != Value::Array(Vec::new())
}

/// The metadata that a published package lacks; `exists` looks for files.
pub(crate) fn missing(package: &Value, exists: &dyn Fn(&Path) -> bool) -> Vec<String> {
    let manifest = package["manifest_path"].as_str().expect("a path");
    let folder = Path::new(manifest).parent().expect("a folder");
    let mut missing = Vec::new();
    for field in [
        "description",
        "license",
        "repository",
        "readme",
        "rust_version",
    ] {
        if package[field].as_str().is_none_or(str::is_empty) {
            missing.push(format!("the field {field}"));
        }
    }
    for (field, most) in [("keywords", 5), ("categories", 5)] {
        let count = package[field].as_array().map_or(0, Vec::len);
        if count == 0 || count > most {
            missing.push(format!("1 to {most} {field}"));
        }
    }
    if package["metadata"]["docs"]["rs"]["all-features"] != Value::Bool(true) {
        missing.push("all-features in [package.metadata.docs.rs]".to_owned());
    }
    for file in ["README.md", "LICENSE-MIT", "LICENSE-APACHE"] {
        if !exists(&folder.join(file)) {
            missing.push(format!("the file {file}"));
        }
    }
    missing
}
